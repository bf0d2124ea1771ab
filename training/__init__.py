"""Trains the networks that ship with the project on views of library meshes; see docs/reports/training.md."""

import services  # noqa: F401 - before torch, which reads the setting of OpenMP made there when it is loaded
