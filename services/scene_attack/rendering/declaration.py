"""Declares renderers without loading them: their parameter groups, and the defaults of attacks on these.

These declarations are used to validate requests, to word pages and to measure perceptibility. Reading them needs
neither torch nor OpenGL: a declaration names its class as "module:class", which is imported for the first image.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from typing import TYPE_CHECKING, Any, TypeVar

from scene_attack.plugins import Registry
from scene_attack.strict import Model

if TYPE_CHECKING:
    from torch import Tensor

    from scene_attack.rendering.plan import ImageError, Tolerance
    from scene_attack.rendering.protocol import InactiveCoordinate, Parameters, Renderer
    from scene_attack.scenes.resolve import ResolvedScene

MAX_STEP = 1000
"""Largest suggested step; requests accept no larger learning rate."""
IMAGE_OF = "image of "
"""Prefix of the backend string of an image that another renderer drew; that renderer's own string follows."""
SHORTEST_WAVE = 0.1
"""Shortest wavelength that is offered of groups whose values are on a lattice in each object, in its sizes."""
LOCATION = re.compile(r"[\w.]+:\w+")

Labels = Callable[[tuple[int, ...]], list[str]]
"""A function from the shape of a group's values to a label for each coordinate, in flat order."""


def labelled(*axes: str | tuple[str, ...]) -> Labels:
    """Returns a function that joins a word per axis: an axis is a tuple of words or a format string for the index.

    `labelled("object {}", ("red", "green"))` gives "object 0 red", "object 0 green", "object 1 red", …
    """

    def labels(shape: tuple[int, ...]) -> list[str]:
        words = [
            axis if isinstance(axis, tuple) else [axis.format(i) for i in range(size)]
            for axis, size in zip(axes, shape, strict=True)
        ]
        return [" ".join(label) for label in product(*words)]

    return labels


@dataclass(frozen=True, kw_only=True)
class Group:
    """One parameter group of a renderer.

    Raises ValueError if it declares no shape, an axis of no length, more vector axes than axes, or a suggested step
    that requests would refuse.
    """

    name: str
    shape: tuple[str, ...] = ()
    """A word or a number for each axis of its values: ("H", "W", "2")."""
    unit: str
    words: str
    """Its name on pages: "surface normals"."""
    explanation: str = ""
    """What its values are, in words for somebody who chooses groups: "two free angles for every pixel". Empty: its name
    and its natural range say enough."""
    labels: Labels | None = None
    """Labels of its coordinates; None for image-like groups."""
    vector_axes: int = 1
    """Number of trailing axes that form a vector. Perceptibility p is the root of the mean, over the other axes, of the
    vectors' squared norms (paper, section 3.3)."""
    suggested_step: float | None = None
    """Learning rate of a method that steps by the sign of the gradient, in the group's unit (paper, section 4.1); above
    0, at most 1000."""
    by_default: bool = True
    """Whether the group is attacked if a request names no groups."""
    suggested_limit: float | None = None
    """Largest change of a value from the scene's own, in the group's unit; above 0, at most 1000. It is the default of
    methods that need a limit and, with a natural range, of all: there it is the range's largest value."""
    per_pixel: bool = False
    """Whether its values belong to the pixels of one view of the scene, so that no other view has them."""
    moves: bool = False
    """Whether it moves objects or the camera, so that pixels show other surfaces."""
    of_scene: bool = False
    """Whether the scene itself can be made with the change in it (`Declaration.remade`), so that any renderer draws it.
    """
    waves: bool = False
    """Whether its values are on a lattice in each object, for which a request chooses the shortest wavelength."""
    natural_range: str | None = None
    """The range of its bounds in words, if it is what a thing could really have: then no U is needed. None: the bounds
    are what can be computed."""

    def __post_init__(self) -> None:
        if not self.shape:
            raise ValueError(f"group {self.name!r} declares no shape: name its axes, as in ('H', 'W', '3')")
        if not isinstance(self.shape, tuple) or not all(isinstance(axis, str) and axis for axis in self.shape):
            raise ValueError(f"group {self.name!r} needs a tuple of a word for each axis, not {self.shape!r}")
        if any(axis.isdecimal() and int(axis) == 0 for axis in self.shape):
            raise ValueError(f"group {self.name!r} has an axis of length 0: it has no value to attack")
        if not 0 <= self.vector_axes <= len(self.shape):
            raise ValueError(f"group {self.name!r} has {len(self.shape)} axes, not vectors of {self.vector_axes}")
        for what, value in (("step", self.suggested_step), ("limit", self.suggested_limit)):
            if value is not None and not (isinstance(value, int | float) and 0 < value <= MAX_STEP):
                raise ValueError(
                    f"group {self.name!r} suggests the {what} {value!r}, not a number above 0 and up to {MAX_STEP}"
                )


TRANSLATION = Group(
    name="translation",
    shape=("objects", "3"),
    unit="scene units",
    words="position",
    explanation="where each object is",
    labels=labelled("object {} translation", ("x", "y", "z")),
    suggested_step=0.0005,
    suggested_limit=0.02,
    moves=True,
)
"""A renderer that moves objects has this group and the next."""
ROTATION = Group(
    name="rotation",
    shape=("objects", "3"),
    unit="radians: a rotation vector",
    words="rotation",
    explanation="how each object is turned",
    labels=labelled("object {} rotation", ("x", "y", "z")),
    suggested_step=0.001,
    suggested_limit=0.1,
    moves=True,
)
CAMERA = Group(
    name="camera",
    shape=("4",),
    unit="azimuth and elevation in radians, distance in scene units, and roll in radians",
    words="camera",
    explanation="where the camera is, and how it is rolled",
    labels=labelled(("camera azimuth", "camera elevation", "camera distance", "camera roll")),
    suggested_step=0.001,
    suggested_limit=0.1,
    by_default=False,
    moves=True,
)
"""That of one that moves the camera."""


@dataclass(frozen=True, kw_only=True)
class Declaration:
    """Metadata of a renderer.

    Raises ValueError if there is no group or none by default, a group's name is repeated, or the location is not
    "module:class".
    """

    name: str
    groups: tuple[Group, ...]
    """The groups, in the order in which tables list them."""
    differentiable: bool
    method: str
    """Default attack method."""
    explanation: str = ""
    """What it does, in words for somebody who chooses a renderer."""
    base_renderer: str | None = None
    """Default base renderer, for a renderer that attacks another renderer's image."""
    renderer: "str | type[Any] | None" = None
    """The class, or its location "module:class"."""
    worded: str | None = None
    """The location "module:function" of a function (scene, exact renderer, perturbation) that returns the perturbation
    as a list of `Worded`: for each thing in the scene a sentence, its numbers before and after, and the sizes of its
    changes in degrees, centimetres and percent. None: the groups' units are all there is."""
    drawn: str | None = None
    """The location "module:function" of a function (exact renderer, perturbation) that returns images of the change,
    uint8 [h, w, 3], by file name. None: it has none."""
    remade: str | None = None
    """The location "module:function" of a function (resolved scene, perturbation of groups `of_scene`) that returns the
    scene with the changes in it. None: there is no such group."""
    varies: Mapping[str, str] = field(default_factory=dict)
    """The kinds of variation (`scene_attack.rendering.variation`) that it can draw, each with the group it moves."""
    varied: str | None = None
    """The location "module:function" of a function (renderer, values by group, variation) that returns the values with
    those groups moved. None: it can draw none."""
    settings: type[Model] | None = None
    """What a request may set of the renderer's own, as `attack.renderer_settings`; every field has a default. None:
    nothing."""
    requires: Callable[[str], None] | None = None
    """Raises MissingExtra with the field that it is given where a package that the renderer needs is not installed.
    None: a plain installation has all."""

    def __post_init__(self) -> None:
        if not self.groups:
            raise ValueError(f"renderer {self.name!r} declares no parameter group")
        if not self.default_groups:
            raise ValueError(f"renderer {self.name!r} declares no group that is attacked by default")
        if len(set(self.group_names)) != len(self.groups):
            raise ValueError(f"renderer {self.name!r} declares a group twice")
        if isinstance(self.renderer, str) and not LOCATION.fullmatch(self.renderer):
            raise ValueError(f"renderer {self.name!r} is at {self.renderer!r}, which is not module:class")

    @property
    def group_names(self) -> tuple[str, ...]:
        """The names of the groups."""
        return tuple(group.name for group in self.groups)

    @property
    def default_groups(self) -> tuple[str, ...]:
        """The names of the groups that are attacked if a request names none."""
        return tuple(group.name for group in self.groups if group.by_default)

    @property
    def natural_groups(self) -> tuple[str, ...]:
        """The names of the groups with a natural range."""
        return tuple(group.name for group in self.groups if group.natural_range is not None)

    @property
    def moving_groups(self) -> tuple[str, ...]:
        """The names of the groups that move objects or the camera."""
        return tuple(group.name for group in self.groups if group.moves)

    def draws(self, group: Group) -> bool:
        """Whether it has the quantity of another renderer's group, and so draws its changes."""
        return (group.name, group.shape, group.unit) in [(own.name, own.shape, own.unit) for own in self.groups]

    def group(self, name: str) -> Group:
        """Returns a group by its name. Raises KeyError for an unknown name."""
        return {group.name: group for group in self.groups}[name]


@dataclass(frozen=True)
class BuildRequest:
    """The arguments for building a renderer."""

    scene: "ResolvedScene"
    groups: tuple[str, ...]
    """The attacked groups: only these change while the attack runs."""
    tolerance: "Tolerance"
    """Largest error of a displayed value that images inside the attack may have; "exact" allows no shortcut."""
    base: "Renderer | None"
    """The exact renderer of the attacked image, for a renderer with a `base_renderer`; None for others."""
    wavelength: float = SHORTEST_WAVE
    """The shortest of groups with `waves`, in sizes of an object."""
    settings: Any = None
    """The renderer's own settings, of the model that it declares; None for a renderer that declares none."""

    def base_image(self) -> "Tensor":
        """Renders the base renderer's image, rounded to 8 bits: float32 [H, W, 3], multiples of 1/255."""
        from scene_attack.rendering.color import as_saved

        assert self.base is not None, "the renderer declares no base renderer"
        base = self.base

        def render() -> "Tensor":
            start = {group: value[None] for group, value in base.initial().items()}
            return as_saved(base.render(start))[0]

        return self.scene.once(("base image", base.name), render)


class DeclaredRenderer:
    """Base class of renderers: implements the part of the protocol that follows from the declaration.

    A subclass sets `declaration` itself if the declaration names the class's location; else `@register(declaration)`
    sets it.
    """

    declaration: Declaration
    name: str
    """The renderer's name in a request."""
    groups: tuple[str, ...]
    """Names of the parameter groups, in the order in which tables list them."""
    differentiable: bool
    """Whether images are differentiable with respect to the parameters."""

    def __init_subclass__(cls) -> None:
        if "declaration" in cls.__dict__:
            cls.declare(cls.declaration)

    @classmethod
    def declare(cls, declaration: Declaration) -> None:
        """Sets name, groups and differentiability from a declaration."""
        cls.declaration = declaration
        cls.name, cls.groups = declaration.name, declaration.group_names
        cls.differentiable = declaration.differentiable

    def initial(self) -> "Parameters":
        """Returns the scene's own values. Subclasses implement it."""
        raise NotImplementedError

    def names(self, group: str) -> list[str] | None:
        """Returns a label for each coordinate of a group, in flat order; None for image-like groups."""
        labels = self.declaration.group(group).labels
        return None if labels is None else labels(tuple(self.initial()[group].shape))

    def inactive(
        self,
        parameters: "Mapping[str, Tensor]",  # noqa: ARG002 - the protocol's
        reach: Mapping[str, float],  # noqa: ARG002
    ) -> "Sequence[InactiveCoordinate]":
        """Returns no coordinate: nothing is proved."""
        return ()

    def reseeded(self, number: int) -> "Renderer | None":  # noqa: ARG002 - the protocol's
        """Returns None: the images have no noise."""
        return None

    @property
    def sampled_error(self) -> "ImageError | None":
        """The largest error of those of the images rendered so far that were also rendered exactly; None for a renderer
        that renders none of them twice."""
        return None


RENDERERS: Registry[Declaration] = Registry(
    "renderer",
    [
        f"scene_attack.rendering.{name}"
        for name in ("image", "pyrender.declaration", "sensor.renderer", "torch.declaration")
    ],
)

Class = TypeVar("Class", bound=type[DeclaredRenderer])


def register(declaration: Declaration) -> Callable[[Class], Class]:
    """Registers a renderer: a decorator of its class, or a plain call if the declaration names the class's location.

    The class derives from `DeclaredRenderer`, implements `scene_attack.rendering.protocol.Renderer` and has a class
    method `build(request: BuildRequest)`. Raises ValueError for a name that is taken.
    """
    if declaration.renderer is not None:
        RENDERERS.add(declaration.name, declaration)

    def decorate(renderer: Class) -> Class:
        parts = ("build", "initial", "bounds", "render", "exact")
        missing = [
            name for name in parts if getattr(renderer, name, None) in (None, getattr(DeclaredRenderer, name, None))
        ]
        if missing:
            raise ValueError(f"{renderer.__name__} has no {' and no '.join(missing)}")
        declared = replace(declaration, renderer=renderer)
        RENDERERS.add(declaration.name, declared)
        renderer.declare(declared)
        return renderer

    return decorate
