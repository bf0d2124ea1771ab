"""Takes jobs from the queue and runs them in warm processes."""
