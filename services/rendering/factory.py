"""Builds a renderer by its name for a resolved scene."""

from collections.abc import Sequence
from pkgutil import resolve_name
from typing import Any

from services.errors import InvalidRequest, JobFailure
from services.rendering.declaration import RENDERERS, BuildRequest, Declaration
from services.rendering.plan import DEFAULT_TOLERANCE, Tolerance
from services.rendering.protocol import Renderer
from services.scenes.resolve import ResolvedScene


def build(
    scene: ResolvedScene,
    renderer: str,
    base_renderer: str | None = None,
    groups: Sequence[str] | None = None,
    tolerance: Tolerance = DEFAULT_TOLERANCE,
) -> Renderer:
    """Builds a registered renderer for attacks on `groups` (None: all) within `tolerance`.

    `base_renderer` names the renderer that makes the image to be attacked, for a renderer that declares a base renderer
    (None: the declared name).

    Raises InvalidRequest("attack.renderer") for an unknown name, JobFailure("internal") for a renderer whose
    groups are not those it declares.
    """
    declaration = RENDERERS.get(renderer)
    if declaration is None:
        raise InvalidRequest("attack.renderer", f"there is no renderer {renderer!r}; there are {', '.join(RENDERERS)}")
    base = None
    if declaration.base_renderer is not None:
        base = build(scene, base_renderer or declaration.base_renderer, tolerance="exact")
    made: Renderer = _class(declaration).build(
        BuildRequest(scene, tuple(groups or declaration.group_names), tolerance, base)
    )
    shapes = {group: value.dim() for group, value in made.initial().items()}
    declared = {group.name: len(group.shape) for group in declaration.groups}
    if shapes != declared:
        raise JobFailure("internal", f"renderer {renderer!r} declares groups of {declared} axes and has {shapes}")
    return made


def _class(declaration: Declaration) -> Any:
    found = declaration.renderer
    return resolve_name(found) if isinstance(found, str) else found
