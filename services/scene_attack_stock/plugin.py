"""The plug-in: declares the renderer `stock-pyrender`, which has the groups of pyrender. It does not import torch."""

from dataclasses import replace

from scene_attack.plugin import PYRENDER, register_renderer

INTERFACE = 1

register_renderer(
    replace(
        PYRENDER,
        name="stock-pyrender",
        explanation="draws the exported scene by trimesh and pyrender as they are installed: another path to an image, "
        "for second opinions; seconds an image, no gradients",
        renderer="scene_attack_stock.renderer:StockPyrender",
    )
)
