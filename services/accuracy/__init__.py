"""Error against run time, and stability on extreme cases."""
