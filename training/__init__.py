"""Trains the networks that ship with the project on views of library meshes; see docs/reports/training.md."""
