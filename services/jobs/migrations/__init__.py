"""Revisions of the tables; run by services.jobs.database.migrate."""
