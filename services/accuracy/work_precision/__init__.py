"""Error against run time: shading, gradient estimates, whole attacks."""
