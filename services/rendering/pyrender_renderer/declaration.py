"""The pyrender renderer's groups: point lights, colours and poses.

With one object and one light they are the paper's 14 numbers.
"""

from services.rendering.declaration import Declaration, Group, labelled, register


def _lights(shape: tuple[int, ...]) -> list[str]:
    """Labels of [1 + 4 points] values."""
    return ["ambient", *labelled("point {}", ("energy", "x", "y", "z"))((shape[0] // 4, 4))]


PYRENDER = Declaration(
    name="pyrender",
    groups=(
        Group(
            name="illumination",
            shape=("1 + 4 points",),
            unit="ambient radiance; then per point light its energy / 30 and its position in scene units",
            words="illumination",
            labels=_lights,
        ),
        Group(
            name="color",
            shape=("objects", "3"),
            unit="linear factor on the mesh's own colours, in [0,1]",
            words="colour",
            labels=labelled("object {} color", ("red", "green", "blue")),
        ),
        Group(
            name="translation",
            shape=("objects", "3"),
            unit="scene units",
            words="position",
            labels=labelled("object {} translation", ("x", "y", "z")),
        ),
        Group(
            name="rotation",
            shape=("objects", "3"),
            unit="radians: a rotation vector",
            words="rotation",
            labels=labelled("object {} rotation", ("x", "y", "z")),
        ),
    ),
    differentiable=False,
    method="zoo",
    renderer="services.rendering.pyrender_renderer.renderer:PyrenderRenderer",
)

register(PYRENDER)
