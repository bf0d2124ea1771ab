"""Builds a renderer by its name for a resolved scene."""

from collections.abc import Sequence
from pkgutil import resolve_name
from typing import Any

from scene_attack.errors import InvalidRequest, JobFailure, named
from scene_attack.process import finite
from scene_attack.rendering.declaration import RENDERERS, SHORTEST_WAVE, BuildRequest, Declaration
from scene_attack.rendering.plan import DEFAULT_TOLERANCE, Tolerance
from scene_attack.rendering.protocol import BOUND_SLACK, Renderer
from scene_attack.scenes.resolve import ResolvedScene
from scene_attack.strict import Model


def build(
    scene: ResolvedScene,
    renderer: str,
    base_renderer: str | None = None,
    groups: Sequence[str] | None = None,
    tolerance: Tolerance = DEFAULT_TOLERANCE,
    wavelength: float = SHORTEST_WAVE,
    settings: Model | None = None,
) -> Renderer:
    """Builds a registered renderer for attacks on `groups` (None: its default groups) within `tolerance`, where the
    waves of groups on a lattice are at least `wavelength` long, in sizes of an object. `settings` are the renderer's
    own (None: their defaults).

    `base_renderer` names the renderer that makes the image to be attacked, for a renderer that declares a base renderer
    (None: the declared name).

    Raises InvalidRequest("attack.renderer") for an unknown name, and for a renderer that needs a package which is not
    installed; JobFailure("internal") for a renderer that cannot be
    built, or whose groups are not those it declares.
    """
    declaration = RENDERERS.get(renderer)
    if declaration is None:
        raise InvalidRequest("attack.renderer", f"there is no renderer {renderer!r}; there are {', '.join(RENDERERS)}")
    if declaration.requires is not None:
        declaration.requires("attack.renderer")
    if declaration.settings is not None:
        settings = settings or declaration.settings()
    base = None
    if declaration.base_renderer is not None:
        base = build(scene, base_renderer or declaration.base_renderer, tolerance="exact")
    with named(f"renderer {renderer!r}"):
        built: Renderer = _class(declaration).build(
            BuildRequest(scene, tuple(groups or declaration.default_groups), tolerance, base, wavelength, settings)
        )
        if broken := _broken(declaration, built):
            raise JobFailure("internal", f"renderer {renderer!r} {broken}")
    return built


def _broken(declaration: Declaration, renderer: Renderer) -> str | None:
    """Returns the requirements of an attack that a renderer does not meet, as the rest of a sentence; None if it meets
    all.
    """
    # Asked of the class first: a plan that it makes when it is asked for takes longer than an image.
    owed = ("size", "plan", "backend")
    if missing := [name for name in owed if not hasattr(type(renderer), name) and not hasattr(renderer, name)]:
        return f"has no {' and no '.join(missing)}"
    initial, bounds = renderer.initial(), renderer.bounds()
    shapes = {group: value.dim() for group, value in initial.items()}
    declared = {group.name: len(group.shape) for group in declaration.groups}
    if shapes != declared:
        return f"declares groups of {declared} axes and has {shapes}"
    for group, value in initial.items():
        if not value.is_floating_point() or value.numel() == 0 or not finite(value):
            return f"starts with values of group {group!r} that are no finite floating-point numbers, or with none"
        if group not in bounds:
            return f"gives no bounds of group {group!r}"
        low, high = (bound.expand_as(value) for bound in bounds[group])
        if not bool((low <= high).all()):
            return f"has bounds of group {group!r} that are not a lower and an upper one"
        slack = BOUND_SLACK * (1 + value.abs())
        if not bool(((value >= low - slack) & (value <= high + slack)).all()):
            return f"starts with values of group {group!r} that are outside its bounds"
    return None


def _class(declaration: Declaration) -> Any:
    renderer = declaration.renderer
    return resolve_name(renderer) if isinstance(renderer, str) else renderer
