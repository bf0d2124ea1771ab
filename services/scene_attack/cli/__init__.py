"""The command line `scene-attack`."""
