"""The infrastructure of jobs: the record in the database, the queue, the artifact store, and child processes."""
