"""Scenes: descriptions, cameras, meshes, environment maps, and the library of assets that scenes name."""
