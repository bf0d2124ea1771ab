"""Revisions of the tables; run by scene_attack_service.jobs.database.migrate."""
