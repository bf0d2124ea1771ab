"""The workers: they take jobs from the queue and run them in warm processes."""
