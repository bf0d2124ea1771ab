"""The renderer `blender`: the pyrender renderer's scene, path-traced by Blender's Cycles in a process of its own."""
