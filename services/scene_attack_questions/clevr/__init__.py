"""Scenes after CLEVR (Johnson et al. 2017): simple solids on a plane, their records, their layout, their description.

Coordinates in this room are CLEVR's: +z is up, the plane is z = 0, lengths are Blender's units. `description` converts
them to the world of `scene_attack.scenes.description`, where +y is up.
"""
