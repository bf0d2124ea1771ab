"""The renderer `mitsuba`: the pyrender renderer's scene, path-traced by Mitsuba 3 in this process."""
