"""Mixed jobs, small enough to run many: attacks with and without gradients, on the image and through both renderers."""

from typing import Any


def _scene(mesh: str, size: int = 64) -> dict[str, Any]:
    return {"camera": {"size": [size, size]}, "objects": [{"mesh": mesh}]}


def _held(steps: int, **attack: Any) -> dict[str, Any]:
    """An attack that takes all its steps: towards a label that it cannot reach with steps so small."""
    return {"goal": {"reach": "tench"}, "attack": {"steps": steps, **attack}}


def mixed(steps: int) -> list[dict[str, Any]]:
    """The requests of one job of each kind; the longest ones take `steps` steps."""
    image = {"renderer": "image", "base_renderer": "pyrender"}
    tiny = {"learning_rate": {"image": 1e-6}}
    sphere, cube = _scene("primitive/sphere"), _scene("primitive/cube")
    return [
        {"scene": sphere, "attack": image | {"steps": 3}},
        {"scene": sphere, **_held(steps, **image, **tiny)},
        {"scene": cube, **_held(steps // 2, **image, method="mi-fgsm", **tiny)},
        {"scene": cube, **_held(steps // 4, renderer="torch", groups=["normals"])},
        {"scene": sphere, **_held(steps // 4, renderer="pyrender", groups=["illumination"], method="zoo")},
        {"scene": sphere, **_held(steps // 4, **image, method="square")},
    ]


def requests(count: int, steps: int) -> list[dict[str, Any]]:
    """`count` requests, of each kind in turn."""
    kinds = mixed(steps)
    return [kinds[number % len(kinds)] for number in range(count)]
