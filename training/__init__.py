"""Trains the networks that ship with the project on views of library meshes; see docs/reports/training.md."""

import scene_attack  # noqa: F401 - before torch, which reads the setting of OpenMP made there when it is loaded
