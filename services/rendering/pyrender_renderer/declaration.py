"""The pyrender renderer's groups: lights, colours and poses, and on request the camera.

With one object and one point light, those that are attacked by default are the paper's 14 numbers.
"""

from services.rendering.declaration import Declaration, Group, labelled, register

PYRENDER = Declaration(
    name="pyrender",
    groups=(
        Group(
            name="illumination",
            shape=("1 + 4 points + 4 directional + 7 spots",),
            unit="ambient radiance; then per point light its energy / 30 and its position in scene units; per "
            "directional light its energy / 3 and its direction; per spot light its energy / 30, its position and its "
            "direction",
            words="illumination",
            # The labels depend on the kinds of the lights, not on their number alone: see `PyrenderRenderer.names`.
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
        Group(
            name="camera",
            shape=("4",),
            unit="azimuth and elevation in radians, distance in scene units, and roll in radians",
            words="camera",
            labels=labelled(("camera azimuth", "camera elevation", "camera distance", "camera roll")),
            by_default=False,
        ),
    ),
    differentiable=False,
    method="zoo",
    renderer="services.rendering.pyrender_renderer.renderer:PyrenderRenderer",
)

register(PYRENDER)
