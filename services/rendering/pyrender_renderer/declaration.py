"""The pyrender renderer's groups: lights, colours and poses.

With one object and one point light they are the paper's 14 numbers.
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
            suggested_limit=0.1,
            # The labels depend on the kinds of the lights, not on their number alone: see `PyrenderRenderer.names`.
        ),
        Group(
            name="color",
            shape=("objects", "3"),
            unit="linear factor on the mesh's own colours, in [0,1]",
            words="colour",
            suggested_limit=0.1,
            labels=labelled("object {} color", ("red", "green", "blue")),
        ),
        Group(
            name="translation",
            shape=("objects", "3"),
            unit="scene units",
            words="position",
            suggested_limit=0.02,
            labels=labelled("object {} translation", ("x", "y", "z")),
        ),
        Group(
            name="rotation",
            shape=("objects", "3"),
            unit="radians: a rotation vector",
            words="rotation",
            suggested_limit=0.1,
            labels=labelled("object {} rotation", ("x", "y", "z")),
        ),
    ),
    differentiable=False,
    method="zoo",
    renderer="services.rendering.pyrender_renderer.renderer:PyrenderRenderer",
    changes="services.rendering.pyrender_renderer.physical:changes",
)

register(PYRENDER)
