"""Error against run time: plans of each tolerance, and options of a scene, measured and written as a page and as JSON.

Every error is of displayed values in [0,1]. How often attacks succeed within a tolerance is a campaign
(examples/paper-tolerances.json), and not measured here.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from statistics import median
from time import perf_counter
from typing import Any, NamedTuple

import torch
from pydantic import BaseModel, ConfigDict, Field
from torch import Tensor
from torch.nn.functional import interpolate

from scene_attack.attacks.problem import generator
from scene_attack.rendering.factory import build
from scene_attack.rendering.opengl.gbuffer import rasterise
from scene_attack.rendering.plan import DEFAULT_TOLERANCE, Tolerance, image_error
from scene_attack.rendering.protocol import Parameters, Renderer
from scene_attack.rendering.pyrender.planner import MEASURED_REACH
from scene_attack.rendering.torch.planner import MAX_PERTURBATION
from scene_attack.rendering.torch.renderer import TorchRenderer
from scene_attack.scenes.description import Scene
from scene_attack.scenes.resolve import ResolvedScene, resolve
from scene_attack_accuracy.placing import library, placed
from scene_attack_accuracy.provenance import Provenance
from scene_attack_accuracy.tables import rows_as_json, small, table

REACHES = {"pyrender": MEASURED_REACH, "torch": MAX_PERTURBATION}
"""Distance by which an attack moves a coordinate of each group, by renderer."""
SOME_WAY = {group: 0.1 * reach for group, reach in MAX_PERTURBATION.items()}
"""A tenth of it: some way into an attack."""


@dataclass(frozen=True)
class Extent:
    """The extent of the measurements.

    subjects: mesh, material, size of the image and sizes of maps that are shaded; enough: seconds for each time that
    is taken; scene: size of the image of a CLEVR-style scene.
    """

    subjects: tuple[tuple[str, str, tuple[int, int], tuple[tuple[int, int], ...]], ...]
    enough: float
    scene: tuple[int, int]


FULL = Extent(
    subjects=(
        ("furniture/soccer-ball", "brushed-metal", (224, 224), ((4, 8), (8, 16), (16, 32), (32, 64))),
        ("furniture/grand-piano", "glossy-paint", (448, 448), ((16, 32),)),
    ),
    enough=0.3,
    scene=(240, 320),
)
QUICK = Extent(
    subjects=(("furniture/soccer-ball", "brushed-metal", (64, 64), ((4, 8), (16, 32))),), enough=0.02, scene=(48, 64)
)


class ShadingRow(BaseModel):
    """One plan of the torch renderer for one object. Errors are against the exact renderer."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    mesh: str
    material: str
    size: tuple[int, int] = Field(description="of the image, height and width")
    map: tuple[int, int] = Field(description="rows and columns of the environment map")
    groups: tuple[str, ...] = Field(description="attacked; the others keep their values and have no gradient")
    tolerance: Tolerance
    estimate: float = Field(description="the plan's estimate of the largest error")
    largest: float
    gradient: dict[str, float] = Field(description="relative error (L2) of each group's gradient")
    seconds: float = Field(description="median, of an image and its gradient")
    summed: bool = Field(description="whether a check failed, so that pixels were summed one by one after all")

    @property
    def object(self) -> str:
        """The mesh without its folder, and the material."""
        return f"{self.mesh.removeprefix('furniture/')}, {self.material}"


class OptionRow(BaseModel):
    """The image of a scene by one renderer with one setting, beside a reference."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    scene: str
    renderer: str
    setting: str
    mean: float = Field(description="mean error over covered pixels")
    share: float = Field(description="share of covered pixels that are off by more than 1/255")
    largest: float
    estimate: float | None = Field(None, description="the plan's: of the largest error (torch), or of the mean")
    seconds: float = Field(description="median, of an image")

    @classmethod
    def of(cls, image: Tensor, reference: Tensor, ground: Tensor, **known: str | float) -> "OptionRow":
        """The errors of an image [H, W, 3] with a ground of this colour [3]; `known` are the other fields."""
        image, reference = image.double(), reference.double()
        error, _ = image_error(image, reference, ground.to(reference))
        largest = float((image - reference).abs().max())
        return cls.model_validate(known | {"mean": error.mean, "share": error.share, "largest": largest})


class Report(BaseModel):
    """The contents of `work-precision.json`: the rows of each part, and how they were measured."""

    model_config = ConfigDict(extra="forbid")

    measured: Provenance
    shading: list[ShadingRow]
    maps: list[OptionRow]
    shadows: list[OptionRow]
    scenes: list[OptionRow]


def measure(extent: Extent, command: str, on_part: Callable[[str], None] = lambda _: None) -> Report:
    """Measures every part. `command` is what was asked; `on_part` is called with the name of each part that starts."""
    parts: dict[str, Callable[[], Iterable[BaseModel]]] = {
        "shading": lambda: shading_rows(extent),
        "maps": lambda: map_rows(extent.subjects[0][0], extent.subjects[0][2], extent.enough),
        "shadows": lambda: shadow_rows(extent.scene, extent.enough),
        "scenes": lambda: option_rows(extent.scene, extent.enough),
    }
    rows: dict[str, Any] = {}
    for name, part in parts.items():
        on_part(name)
        rows[name] = list(part())
    return Report(measured=Provenance.now(command), **rows)


# Plans for one object

GROUPS = ("normals", "illumination", "material")
TOLERANCES: tuple[Tolerance, ...] = (1e-2, 1e-3, 1e-4, "exact")
COARSE = 14
"""Squares a side of the random numbers that an image's weights are smoothed from."""


class Shaded(NamedTuple):
    """An image [H, W, 3] and the gradient of its weighted sum for each attacked group, as float64."""

    image: Tensor
    gradients: Parameters


def subject(mesh: str, material: str, size: tuple[int, int], texels: tuple[int, int]) -> ResolvedScene:
    """A furniture model of one material under the studio map of so many texels. Raises as `resolve` does."""
    lights = {"environment": {"map": "studio", "size": texels}}
    return placed(mesh, size=size, thing={"material": material}, lights=lights)


def shading_rows(extent: Extent) -> Iterator[ShadingRow]:
    """The plans of each subject and map for all groups, and for each alone, some way into an attack."""
    for mesh, material, size, maps in extent.subjects:
        weights = smooth_weights(size)
        for texels in maps:
            scene = subject(mesh, material, size, texels)
            gbuffer = rasterise(scene)
            for groups in (GROUPS, *((group,) for group in GROUPS)):
                exact = TorchRenderer(scene, gbuffer, groups, "exact")
                values = moved(exact, SOME_WAY)
                reference = shaded(exact, values, weights)
                for tolerance in TOLERANCES:
                    renderer = TorchRenderer(scene, gbuffer, groups, tolerance)
                    image, gradients = shaded(renderer, values, weights)
                    yield ShadingRow(
                        mesh=mesh,
                        material=material,
                        size=size,
                        map=texels,
                        groups=groups,
                        tolerance=tolerance,
                        estimate=renderer.plan.error,
                        largest=float((image - reference.image).abs().max()),
                        gradient={
                            group: float((gradients[group] - true).norm() / true.norm())
                            for group, true in reference.gradients.items()
                        },
                        seconds=repeated(partial(shaded, renderer, values, weights), extent.enough),
                        summed=renderer.failed_checks > 0,
                    )


def shaded(renderer: Renderer, values: Parameters, weights: Tensor) -> Shaded:
    """The image of `values`, {group: [1, ...]}, and the gradients of ⟨weights [H, W, 3], image⟩."""
    dtypes = {group: value.dtype for group, value in renderer.initial().items()}
    leaves = {group: value.to(dtypes[group]).detach().requires_grad_() for group, value in values.items()}
    image = renderer.render(leaves)[0].double()
    gradients = torch.autograd.grad((image * weights).sum(), list(leaves.values()))
    return Shaded(image.detach(), {group: of.double() for group, of in zip(leaves, gradients, strict=True)})


def smooth_weights(size: tuple[int, int]) -> Tensor:
    """Weights [H, W, 3] float64 of an image's values: random, smooth over an image's COARSEth, mean square 1.

    A network's gradient is of that kind; white noise would make every derivative a matter of single pixels.
    """
    random = torch.randn(1, 3, COARSE, COARSE, generator=generator(0, "work-precision", "weights"), dtype=torch.float64)
    smooth = interpolate(random, size, mode="bicubic")[0].permute(1, 2, 0)
    return smooth / smooth.square().mean().sqrt()


def moved(renderer: Renderer, reach: Mapping[str, float]) -> Parameters:
    """The values of the groups that are attacked by default, each coordinate moved at random by up to its `reach`,
    {group: [1, ...]}: float64 rounded to float32, so that every tolerance renders the same ones."""
    parameters = {}
    for group in renderer.plan.groups:
        value = renderer.initial()[group].double()
        random = torch.rand(value.shape, generator=generator(0, "scene options", group), dtype=torch.float64)
        low, high = (bound.double() for bound in renderer.bounds()[group])
        parameters[group] = torch.clamp(value + reach[group] * (2 * random - 1), low, high).float().double()[None]
    return parameters


# Options of a scene

SCENE = "CLEVR, 5 objects"
MATERIALS = ("matte", "plastic", "glossy-paint", "brushed-metal")
MAP_SIZES = ((64, 128), (4, 8), (8, 16), (16, 32), (32, 64))
"""Sizes of the environment map, the largest first."""
SHADOWS: dict[str, list[dict[str, int]]] = {
    "pyrender": [
        {"resolution": resolution, "samples": samples}
        for resolution, samples in ((3072, 64), (256, 16), (512, 16), (1024, 4), (1024, 16), (1024, 64), (2048, 16))
    ],
    "torch": [{"texel_samples": side} for side in (8, 1, 2, 4)],
}
"""Fields of a scene's shadows that make them finer, by renderer, the finest first."""
OPTION_TOLERANCES: tuple[Tolerance, ...] = (1e-2, 1e-3, "exact")


def map_rows(mesh: str, size: tuple[int, int], enough: float) -> Iterator[OptionRow]:
    """Every material under every size of the studio map, by the torch renderer."""
    for material in MATERIALS:
        scenes = {f"{_grid(texels)} texels": subject(mesh, material, size, texels) for texels in MAP_SIZES}
        yield from _beside_the_first(material, "torch", scenes, enough)


def _grid(texels: tuple[int, int]) -> str:
    return f"{texels[0]}×{texels[1]}"


def shadow_rows(size: tuple[int, int], enough: float) -> Iterator[OptionRow]:
    """Every fineness of shadows by both renderers, under three point lights, or their spots on a map."""
    scene = described(size)
    assert scene.shadows is not None
    for renderer, settings in SHADOWS.items():
        scenes = {}
        for fields in settings:
            shadows = scene.shadows.model_copy(update=fields)
            words = ", ".join(f"{name} {value}" for name, value in fields.items())
            scenes[words] = resolve(scene.model_copy(update={"shadows": shadows}), library())
        yield from _beside_the_first(SCENE, renderer, scenes, enough)


def _beside_the_first(
    name: str, renderer: str, scenes: Mapping[str, ResolvedScene], enough: float
) -> Iterator[OptionRow]:
    """The exact images of scenes, by their setting, beside that of the first, at their own values.

    Seconds are of an image and of making its renderer, because the torch renderer finds there what is visible.
    """
    (_, finest), *others = scenes.items()
    reference, ground = _exact_image(finest, renderer), torch.tensor(finest.description.ground)
    for setting, scene in others:
        image, seconds = _exact_image(scene, renderer), repeated(partial(_exact_image, scene, renderer), enough)
        yield OptionRow.of(image, reference, ground, scene=name, renderer=renderer, setting=setting, seconds=seconds)


def _exact_image(scene: ResolvedScene, renderer: str) -> Tensor:
    return build(scene, renderer, tolerance="exact").render({})[0]


def option_rows(size: tuple[int, int], enough: float) -> Iterator[OptionRow]:
    """A scene with one option more at a time, some way into an attack, by both renderers at each tolerance."""
    for name, description in scenes(size):
        scene, ground = resolve(description, library()), torch.tensor(description.ground)
        for kind, reach in REACHES.items():
            exact = build(scene, kind, tolerance="exact")
            values = moved(exact, reach)
            reference = exact.render(values)[0]
            for tolerance in OPTION_TOLERANCES:
                renderer = build(scene, kind, tolerance=tolerance)
                start = renderer.initial()
                parameters = {group: value.to(start[group].dtype) for group, value in values.items()}
                yield OptionRow.of(
                    renderer.render(parameters)[0],
                    reference,
                    ground,
                    scene=name,
                    renderer=kind,
                    setting=str(tolerance),
                    estimate=renderer.plan.error,
                    seconds=repeated(partial(renderer.render, parameters), enough),
                )


def described(size: tuple[int, int]) -> Scene:
    """A CLEVR-style scene with a floor, metal and shadows. `size`: height and width in pixels.

    It is the first of seed 0 as `scene_attack_questions` makes and describes it.
    """
    scene = Scene.model_validate_json(Path(__file__).with_name("clevr.json").read_bytes())
    return scene.model_copy(update={"camera": scene.camera.model_copy(update={"size": size})})


def scenes(size: tuple[int, int]) -> Iterator[tuple[str, Scene]]:
    """The scene without its options, and with one more of them at a time."""
    whole = described(size)
    plain = [
        solid.model_copy(update={"material": "matte", "metallic": None, "roughness": None}) for solid in whole.objects
    ]
    yield "matte objects", whole.model_copy(update={"objects": tuple(plain), "floor": None, "shadows": None})
    yield "rubber and metal", whole.model_copy(update={"floor": None, "shadows": None})
    yield "floor", whole.model_copy(update={"shadows": None})
    yield "shadows", whole


# Times

LEAST, MOST = 5, 15
"""Repeats of what is timed. Work that takes longer than LONG seconds is repeated three times."""
LONG = 1.0


def repeated(work: Callable[[], object], enough: float) -> float:
    """Median seconds of LEAST to MOST repeats, as many as fit into `enough` seconds. Warm up before."""
    seconds = [_time_of(work)]
    least = LEAST if seconds[0] < LONG else 3
    while len(seconds) < least or (len(seconds) < MOST and sum(seconds) < enough):
        seconds.append(_time_of(work))
    return median(seconds)


def _time_of(work: Callable[[], object]) -> float:
    began = perf_counter()
    work()
    return perf_counter() - began


# The page

NAME = "work-precision"
DEFAULT_MAP = (16, 32)
EXACTLY = 1e-12
"""Largest error of a plan that estimates none: its sum is the reference's."""

TOLERANCE = f"""The default, {DEFAULT_TOLERANCE:g}, is a quarter of a step of 8 bits. The verdict is on the exact image
at every tolerance: an error may cost an attack steps, but nothing is verified because of it.
[The study](../study/classification.md#which-tolerance) says how many attacks succeed at each. `exact` is for studies
of gradients and comparisons with other programs."""

PLANS = """*Largest* and *estimate* are errors of a displayed value, against the exact image; *gradient* is the largest
relative error (L2) of the attacked groups' gradients. Seconds are of an image and its gradient. The scene is some
way into an attack. Where a table was tried and its check failed, the note says so: that image cost more."""

MAPS = f"""A scene's light is its map averaged down to a grid of `size`; every other error on this page is for the grid
as it is given. Differences of displayed values between exact images, from the image under one of
{_grid(MAP_SIZES[0])}:"""

SHADOWS_TEXT = """Exact images beside those with the finest shadows; differences of displayed values over covered
pixels. Settings are fields of `scene.shadows`. Seconds are of an image and of what its renderer prepares for it, which
a job does once: visibility (torch)."""

SCENES = f"""{SCENE}: first without options, then with one more of them at a time, some way into an attack on the
renderer's default groups. Differences are from the exact image, over covered pixels. *Share* is of those that are off
by more than 1/255. *Estimate* is the plan's: of the largest error (torch), or of the mean (pyrender)."""

OMISSIONS = """
- Shading is measured for one object of one material at a time, on a processor, not on a GPU.
- Seconds of shading leave out the network, the rasterised geometry and making the plan, which a job does once.
- The viewer is far away, as is the default. One at the camera (`viewer: perspective`) is summed pixel by pixel.
- The function whose gradient shading is judged by is a weighted sum of the image with smooth random weights.
- Mitsuba has no material of this model; [Benchmarks](../reports/benchmarks.md) compares its speed on a problem of that
  size."""


def write(report: Report, folder: Path) -> None:
    """Writes `work-precision.json` and `.md` into the folder, which is created if necessary."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{NAME}.json").write_text(rows_as_json(report.model_dump(mode="json")), "utf-8")
    (folder / f"{NAME}.md").write_text(markdown(report), "utf-8")


def markdown(report: Report) -> str:
    """The page: the choice of a tolerance, then error against seconds, option by option."""
    plans = report.shading
    # All groups on every subject, and single groups on the first one under the default map.
    shown = [row for row in plans if row.groups == GROUPS or (row.mesh, row.map) == (plans[0].mesh, DEFAULT_MAP)]
    sections = [
        "# Error against run time",
        f"Every row is in [{NAME}.json]({NAME}.json). [How it works](../how-it-works.md) says what a plan leaves out.",
        *("## Which tolerance", TOLERANCE, _tolerances(report)),
        *("## Plans", PLANS, table(PLAN_COLUMNS, shown)),
        *("## Resolution of the environment map", MAPS, table(OPTION_COLUMNS, report.maps)),
        *("## Resolution of shadows", SHADOWS_TEXT, table(OPTION_COLUMNS, report.shadows)),
        *("## Surfaces, floor and shadows", SCENES, table(OPTION_COLUMNS, report.scenes)),
        *("## What is left out", OMISSIONS.strip()),
        "## How to make this page again",
        "Seconds are medians of several runs after one that warms up; they mean something only on a machine that does\n"
        f"nothing else. {report.measured.words()}.",
    ]
    return "\n\n".join(sections) + "\n"


def _tolerances(report: Report) -> str:
    """Advice on the choice of a tolerance, from the rows."""
    plans = report.shading
    held = sum(row.largest <= max(row.estimate, EXACTLY) for row in plans)
    setting = f"{_grid(DEFAULT_MAP)} texels"
    of_map = max(row.largest for row in report.maps if row.setting == setting)
    return (
        f"- The largest error of an image was within the plan's estimate in {held} of {len(plans)} plans.\n"
        f"- A map of {setting} is off by up to {of_map:.2g}: enlarge it before you lower the tolerance."
    )


def _seconds(row: ShadingRow | OptionRow) -> str:
    return f"{row.seconds:.2g}"


def _groups(groups: Sequence[str]) -> str:
    return "all three" if groups == GROUPS else ", ".join(groups)


PLAN_COLUMNS: dict[str, Callable[[ShadingRow], str]] = {
    "object": lambda row: row.object,
    "map": lambda row: _grid(row.map),
    "attacked": lambda row: _groups(row.groups),
    "tolerance>": lambda row: f"{row.tolerance:g}" if isinstance(row.tolerance, float) else row.tolerance,
    "largest>": lambda row: small(row.largest),
    "estimate>": lambda row: small(row.estimate),
    "gradient>": lambda row: small(max(row.gradient.values())),
    "seconds>": _seconds,
    "note": lambda row: "checked, and summed pixel by pixel after all" if row.summed else "",
}
OPTION_COLUMNS: dict[str, Callable[[OptionRow], str]] = {
    "scene": lambda row: row.scene,
    "renderer": lambda row: row.renderer,
    "setting": lambda row: row.setting,
    "mean>": lambda row: small(row.mean),
    "share>": lambda row: f"{row.share:.2%}",
    "largest>": lambda row: small(row.largest),
    "estimate>": lambda row: small(row.estimate),
    "seconds>": _seconds,
}
