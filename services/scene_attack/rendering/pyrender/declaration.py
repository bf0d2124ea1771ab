"""The pyrender renderer's groups: lights, colours and poses, and on request the camera.

With one object and one point light, those that are attacked by default are the paper's 14 numbers.

The suggested steps are 0.005 of a light or a colour, 0.0005 scene units and 0.001 radians. A step of all coordinates
of a group at random signs changes an image of 224² by a perceptibility p of about 1e-3 (illumination), 2e-4 (color) and
6e-3 to 1e-2 (translation, rotation, camera). Light and colour change an image smoothly and may take
longer steps than what moves silhouettes, whose p grows with the root of the step.
"""

from scene_attack.rendering.declaration import (
    CAMERA,
    RENDERERS,
    ROTATION,
    TRANSLATION,
    Declaration,
    Group,
    labelled,
    register,
)

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
            explanation="the ambient light, and the energy, place and direction of each lamp",
            suggested_limit=0.1,
            # The labels depend on the kinds of the lights, not on their number alone: see `PyrenderRenderer.names`.
            suggested_step=0.005,
        ),
        Group(
            name="color",
            shape=("objects", "3"),
            unit="linear factor on the mesh's own colours, in [0,1]",
            words="colour",
            explanation="a factor on each object's own colours",
            suggested_limit=0.1,
            of_scene=True,
            labels=labelled("object {} color", ("red", "green", "blue")),
            suggested_step=0.005,
        ),
        TRANSLATION,
        ROTATION,
        CAMERA,
    ),
    differentiable=False,
    method="zoo",
    explanation="draws with OpenGL, and moves lamps, objects and camera; no gradients",
    renderer="scene_attack.rendering.pyrender.renderer:PyrenderRenderer",
    worded="scene_attack.rendering.pyrender.words:worded",
    remade="scene_attack.rendering.pyrender.parameters:recolored",
    varies=dict.fromkeys(("azimuth", "elevation", "roll", "distance"), "camera") | {"intensity": "illumination"},
    varied="scene_attack.rendering.pyrender.renderer:varied",
)

register(PYRENDER)


def has_groups_of_pyrender(renderer: str) -> bool:
    """Whether a renderer has the very groups of pyrender: its values are then the scene's own lights, colours, poses
    and camera, and mean the same to every renderer that has them.
    """
    return renderer in RENDERERS and RENDERERS[renderer].groups == PYRENDER.groups
