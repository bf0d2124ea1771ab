"""The process that draws: `python -m scene_attack_stock.draw <folder> <number>` draws <folder>/0.glb and so on by
trimesh and pyrender as they are installed, each to a .npy file: uint8 [H, W, 3].

Only the scene's light and camera, which trimesh does not keep, are read as the export's own script reads them.
"""

import sys
from pathlib import Path

import numpy as np
import pyrender
import trimesh
from numpy.typing import NDArray

from scene_attack.confinement import die_with_parent
from scene_attack.export.stock.render_exported import ground_of, light_and_camera, read_glb


def drawn(path: Path) -> NDArray[np.uint8]:
    """The image of a scene's file, over its ground."""
    head, _ = read_glb(path)
    extras = head["scenes"][0]["extras"]
    ambient = np.full(3, extras["ambient"])
    scene = pyrender.Scene.from_trimesh_scene(trimesh.load_scene(path), bg_color=(0, 0, 0, 0), ambient_light=ambient)
    for thing, pose in light_and_camera(head):
        scene.add(thing, pose=pose)
    height, width = extras["size"]
    renderer = pyrender.OffscreenRenderer(width, height)
    color, _ = renderer.render(scene, flags=pyrender.RenderFlags.RGBA)
    renderer.delete()
    coverage = color[..., 3:] / 255
    levels = np.rint(color[..., :3] + 255 * ground_of(extras) * (1 - coverage))
    return np.asarray(levels.clip(0, 255), np.uint8)


if __name__ == "__main__":
    die_with_parent()
    for number in range(int(sys.argv[2])):
        np.save(Path(sys.argv[1], f"{number}.npy"), drawn(Path(sys.argv[1], f"{number}.glb")))
