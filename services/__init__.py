"""Everything of scene-attack that is neither HTTP nor queue."""
