"""Texts of an export: a page about the job, and the README of its files.

The page needs no other file: it has images, tables, curves and the request, without scripts. The README names the files
and their units, what glTF cannot say, what `replay` needs, the credits, and how to cite.
"""

import json
import re
from base64 import b64encode
from collections.abc import Callable, Mapping, Sequence
from fnmatch import fnmatch
from importlib.metadata import version
from importlib.resources import files

import torch
from jinja2 import Environment, PackageLoader, StrictUndefined
from pydantic import BaseModel

from scene_attack.attacks.trace import TraceRow
from scene_attack.export.parameters import ParameterTable
from scene_attack.export.scene_values import carried
from scene_attack.rendering.pyrender.renderer import EXPOSURE
from scene_attack.rendering.torch.light import illumination
from scene_attack.runs.exported_targets import FOLDER, ExportedTarget
from scene_attack.runs.prepare import lit_by_map
from scene_attack.runs.result import Result
from scene_attack.runs.spec import JobSpec, attack_name, group_words
from scene_attack.runs.task_parts import TASKS
from scene_attack.scenes.resolve import ResolvedScene
from scene_attack.text import signed

Files = Mapping[str, Callable[[], bytes]]
"""The files of a finished job by their names, each read when it is called."""

CONTENTS = {
    "original.png": "the image of the scene as it was",
    "attacked.png": "the image of the scene under attack, rendered afresh and rounded to 8 bits",
    "perturbation.png": "their difference times 5, plus 128",
    "scene_before.glb": "the scene as it was: geometry, materials, camera, lights",
    "scene_after.glb": "the scene under attack",
    "environment_before.exr": "the environment map as it was, as the renderer used it: averaged, turned and exposed",
    "environment_after.exr": "the environment map under attack",
    "normals_*.npy": "the normals that the pixels are shaded by, float32 [H, W, 3]; 0 where nothing is",
    "normals_*.png": "the same as colours: n / 2 + 1/2",
    "parameters.json": "every attacked parameter: name, unit, value before and after",
    "perturbation.safetensors": "the change of each attacked group; names, units and axes are in the metadata",
    "result.json": "the result: answers, measures, tables, provenance",
    "trace.json": "each step of the attack",
    "request.json": "the request with every setting, as `scene-attack run` takes it",
    "render_exported.py": "draws a `.glb` of this folder with trimesh and pyrender alone",
    "mesh.vert": "its vertex shader",
    "mesh.frag": "its fragment shader: the shading model in one file",
    "assets/furniture/*": "a model of the furniture library, as a library of its own; Sweet Home 3D opens it too",
    "assets/environments/*": "the environment map of the request",
    "assets/uploads/*.json": "what was said of an upload: its title, licence and credit, and which way is up",
    "assets/uploads/*": "the files of an upload, as they were sent",
    "targets/*.json": "a network of the job: its card, and the SHA-256 of its weights",
    "targets/*": "the card of a user's own network, and its labels",
    "report.html": "images, tables and curves on one page, which needs no other file",
    "subset-*.png": "the image with only some of the changed groups: the row of that number, from 0, of `subsets` in "
    "`result.json`",
    "dents.png": "the heights of the dents, from pressed in (blue) to raised (red)",
    "shape.png": "how far the surface moved, from 0 (white) to the largest (red)",
    "paint.png": "the base colours of the painted surface, without light",
    "normals-tilt.png": "the angle by which each normal turned, from 0 (violet) to the largest (yellow)",
    "map-before.png": "the intensities of the environment map as it was",
    "map-after.png": "the same under attack, in the same scale",
    "map-ratio.png": "the second divided by the first: red is brighter, blue is darker",
}
"""Descriptions of files by name or pattern; the first pattern that fits counts."""


def escaped(text: str) -> str:
    """A text that people wrote, for Markdown that shows it as it is: no markup, and no HTML."""
    return re.sub(r"([\\`*_{}\[\]<>#|~!&$])", r"\\\1", text)


_readme_templates = Environment(
    loader=PackageLoader(__package__), undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True, autoescape=False
)
_readme_templates.filters["escaped"] = escaped


def readme(
    result: Result,
    name: str,
    spec: JobSpec,
    scene: ResolvedScene,
    paths: Sequence[str],
    targets: Sequence[ExportedTarget],
    job: str | None,
) -> str:
    """The text, in Markdown. `name` is that of the scene or question, `paths` are those of the other files, and
    `targets` are the job's networks."""
    mapped = lit_by_map(spec)
    return _readme_templates.get_template("README.md").render(
        name=name,
        attack=attack_name(result.spec),
        target=spec.target.name,
        job=job,
        sentence=sentence(result),
        findings=result.findings,
        files=[(path, content(path)) for path in dict.fromkeys(map(_listed, paths))],
        missing=[missing for target in targets if (missing := target.missing(FOLDER)) is not None],
        written_by=result.provenance.versions.get("scene-attack", version("scene-attack")),
        lengths=_lengths(scene),
        same_scene=not set(spec.attack.groups) & set(carried(spec.attack.renderer)),
        why_same="see below" if mapped else "the attack changes pixels",
        lit_by_map=mapped,
        exposure=illumination(torch.as_tensor(scene.environment)).exposure if mapped else EXPOSURE,
        viewer="a distant viewer, the same for all pixels"
        if scene.description.camera.viewer == "distant"
        else "each pixel's own viewer direction",
        shadows=scene.description.shadows is not None,
        credits=result.provenance.credits,
        bibtex=bibtex(),
    )


def sentence(result: Result) -> str:
    """The outcome of the attack in a sentence."""
    before, after = result.original, result.attacked
    answers = f"The network said “{before.label}” ({before.confidence:.1%}) of the scene as it was, and says "
    answers += f"“{after.label}” ({after.confidence:.1%}) of the scene under attack"
    return f"{answers}: {result.outcome}{', verified' if result.verified else ', not verified'}."


def _listed(path: str) -> str:
    """The path of a file, or of the folder of an upload or a network, whose files may have any names."""
    folder = re.match(r"(assets/uploads|targets)/[^/]+/", path)
    return path if folder is None else folder[0]


def content(name: str) -> str:
    """The description of a file of the bundle."""
    tasks = [task.result.contents for task in TASKS.values() if task.result is not None]
    known = ((pattern, words) for contents in (CONTENTS, *tasks) for pattern, words in contents.items())
    return next((words for pattern, words in known if fnmatch(name, pattern)), "a file of the job")


def bibtex() -> str:
    """The paper and the software, as BibTeX."""
    text = files("scene_attack.export").joinpath("citation.bib").read_text("utf-8")
    return text.replace("VERSION", version("scene-attack")).strip()


def _lengths(scene: ResolvedScene) -> list[str]:
    return [
        f"A scene unit on object {index} is {mesh.centimetres / placed.scale:.4g} cm of the real `{placed.mesh}`."
        for index, (mesh, placed) in enumerate(zip(scene.meshes, scene.description.objects, strict=True))
        if mesh.centimetres is not None
    ]


WIDTH, HEIGHT = 420, 160
"""Size of a curve's box, SVG units."""
IMAGES = (
    ("original.png", "Original"),
    ("attacked.png", "Attacked"),
    ("perturbation.png", "Difference × 5, plus 128"),
)

_templates = Environment(
    loader=PackageLoader(__package__), undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True, autoescape=True
)
_templates.filters["zip"] = zip
_templates.globals["signed"] = signed


class Curve(BaseModel):
    """A curve over the steps: its points in SVG units, and the values at its ends."""

    title: str
    points: str
    first: float
    last: float
    lowest: float
    highest: float


def report(result: Result, name: str, table: ParameterTable, files: Files, job: str | None) -> str:
    """The page as HTML. `name` is the scene's or question's; `files` has the images, which become a part of it."""
    return _templates.get_template("report.html").render(
        name=name,
        attack=attack_name(result.spec),
        job=job,
        result=result,
        sentence=sentence(result),
        images=[(title, _inline(files[name]())) for name, title in IMAGES if name in files],
        curves=curves(result.trace),
        groups=[[group_words(result.spec, group) for group in subset.groups] for subset in result.subsets],
        parts=[group_words(result.spec, part) for part in result.attribution.parts],
        table=table,
        request=json.dumps(result.spec, indent=2, ensure_ascii=False),
        bibtex=bibtex(),
    )


def curves(trace: Sequence[TraceRow]) -> list[Curve]:
    """The curves of a trace of two rows or more."""
    if len(trace) < 2:
        return []
    return [
        _curve("Loss: probability of the labels to leave, or 1 − that to reach", trace, [row.loss for row in trace]),
        _curve("Perceptibility p", trace, [row.perceptibility for row in trace]),
    ]


def _curve(title: str, trace: Sequence[TraceRow], values: Sequence[float]) -> Curve:
    low, high = min(values), max(values)
    first, span = trace[0].step, max(1, trace[-1].step - trace[0].step)
    tall = (high - low) or 1.0
    points = [
        f"{WIDTH * (row.step - first) / span:.2f},{HEIGHT * (1 - (value - low) / tall):.2f}"
        for row, value in zip(trace, values, strict=True)
    ]
    ends = {"first": values[0], "last": values[-1], "lowest": low, "highest": high}
    return Curve(title=title, points=" ".join(points), **ends)


def _inline(png: bytes) -> str:
    return f"data:image/png;base64,{b64encode(png).decode()}"
