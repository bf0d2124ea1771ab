"""Side-by-side measurements. Each benchmark writes a result file, from which the pages of docs/ are made."""

import scene_attack  # noqa: F401 - before torch, which reads the setting of OpenMP made there when it is loaded
