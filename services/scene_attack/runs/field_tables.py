"""Writes docs/reference/fields.md: every field of a job's and of a campaign's request, and the groups of the renderers.

All of it follows from the models of requests and from the registries. `python -m scene_attack.runs.field_tables`
writes it again.
"""

import json
import typing
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from scene_attack.attacks.attack import ATTACKS
from scene_attack.attacks.request import Expectation
from scene_attack.rendering.declaration import RENDERERS
from scene_attack.runs.campaign_spec import CampaignSpec
from scene_attack.runs.environment import options_to_run
from scene_attack.runs.spec import JobSpec
from scene_attack.runs.task_parts import TASKS
from scene_attack.scenes.source import SOURCES
from scene_attack.strict import Model

PAGE = Path(__file__).parents[3] / "docs" / "reference" / "fields.md"
HEAD = """# Fields of requests

A command writes this page from the models of requests; `openapi.yaml` has the same fields with their types and limits.
Angles are in radians and lengths in scene units; +y is up; colours are in [0,1]. A field that is not listed is refused.
[Your scene](../scene.md), [attacks](../attacks.md), [results](../results.md) and [campaigns](../campaigns.md) explain
what is listed here."""
GROUPS = """If a request leaves `method` out, it is the method that this table gives for the renderer. *limit* is the
`epsilon` of methods that need one, where the request gives none and nothing else limits them. *natural range* is what
a thing could have, which a group keeps to by itself; the values of groups without one are free within what can be
computed."""


def page() -> str:
    """The page as Markdown."""
    lines = [HEAD, "", "## Job", ""]
    shown: set[type[BaseModel]] = set()
    sections = dict(_sections(JobSpec, "", shown))
    for path, model in sections.items():
        lines += [*([f"## `{path}`", ""] if path else []), *_section(model)]
        if path == "scene":
            lines += _of_plugins("scene.source", "of the format", SOURCES, shown)
        if path == "target":
            asks = {name: task.ask for name, task in TASKS.items() if task.ask is not None}
            lines += _of_plugins("target.ask", "of a network whose task is", asks, shown)
        if path == "goal":
            lines += _attacks()
            has = [(name, renderer.settings) for name, renderer in RENDERERS.items() if renderer.settings is not None]
            own = {"` and `".join(name for name, one in has if one is model): model for _, model in has}
            lines += _of_plugins("attack.renderer_settings", "of the renderer", own, shown)
    lines += ["## Renderers and their parameter groups", "", GROUPS, ""]
    columns = ("renderer", "method", "group", "shape", "unit", "step of fgsm", "limit", "natural range")
    lines += _table(columns, _groups())
    lines += ["## Campaign", ""]
    for path, model in _sections(CampaignSpec, "", shown):
        lines += [*([f"## `{path}`", ""] if path else []), *_section(model)]
        if path == "grids[]":
            cases = {name: task.cases for name, task in TASKS.items() if task.cases is not None}
            lines += _of_plugins("grids[].generate", "of networks whose task is", cases, shown)
    return "\n".join(lines).rstrip() + "\n"


def _sections(model: type[BaseModel], path: str, shown: set[type[BaseModel]]) -> Iterator[tuple[str, type[BaseModel]]]:
    """A model and those of its fields, each once, with the path of the field."""
    if model in shown:
        return
    shown.add(model)
    yield path, model
    for name, field in model.model_fields.items():
        for several, inner in _models(field.annotation):
            yield from _sections(inner, f"{path}.{name}".lstrip(".") + "[]" * several, shown)


def _models(annotation: Any, several: bool = False) -> Iterator[tuple[bool, type[BaseModel]]]:
    """The models in an annotation, and whether the field is a list of them."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield several, annotation
    for argument in typing.get_args(annotation):
        yield from _models(argument, several or typing.get_origin(annotation) is tuple)


def _section(model: type[BaseModel]) -> list[str]:
    return [" ".join((model.__doc__ or "").split()), "", *_fields(model)]


def _of_plugins(
    path: str, of: str, models: Mapping[str, type[BaseModel]], shown: set[type[BaseModel]]
) -> Iterator[str]:
    """The fields that each plug-in has for a field of the request."""
    for name, model in models.items():
        (_, _), *parts = _sections(model, path, shown)
        yield from (f"## `{path}` {of} `{name}`", "", *_section(model))
        for part, inner in parts:
            if issubclass(inner, Model):  # the others are another program's own format
                yield from (f"## `{part}`", "", *_section(inner))


def _attacks() -> Iterator[str]:
    """The fields of `attack`: first those that mean the same for every method, then those of each."""
    settings = list(ATTACKS.values())
    rows = [{row[0]: row for row in _rows(model)} for model in settings]
    common = [row for name, row in rows[0].items() if all(other.get(name) == row for other in rows)]
    yield from ("## `attack`", "", "The fields that every method has with the same default.", "")
    yield from _table(("field", "default", "meaning"), common)
    for name, model, own in zip(ATTACKS, settings, rows, strict=True):
        yield from (f"## `attack` with `method: {name}`", "", " ".join((model.__doc__ or "").split()), "")
        yield from _table(("field", "default", "meaning"), [row for row in own.values() if row not in common])
    yield from ("## `attack.expectation`", "", *_section(Expectation))


def _fields(model: type[BaseModel]) -> Iterator[str]:
    return _table(("field", "default", "meaning"), _rows(model))


def _rows(model: type[BaseModel]) -> Iterator[list[str]]:
    for name, field in model.model_fields.items():
        yield [f"`{field.alias or name}`", _default(field), field.description or ""]


def _groups() -> Iterator[list[str]]:
    for name, renderer in RENDERERS.items():
        for group in renderer.groups:
            step = "" if group.suggested_step is None else f"{group.suggested_step:g}"
            limit = "" if group.suggested_limit is None else f"{group.suggested_limit:.2g}"
            shape = "×".join(group.shape)
            of = [f"`{name}`", f"`{renderer.method}`", f"`{group.name}`"]
            yield [*of, shape, group.unit, step, limit, group.natural_range or ""]


def _table(columns: Iterable[str], rows: Iterable[list[str]]) -> Iterator[str]:
    yield f"| {' | '.join(columns)} |"
    yield "|" + "---|" * len(list(columns))
    for row in rows:
        yield f"| {' | '.join(row)} |"
    yield ""


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return "required"
    default: Any = field.default
    if field.default_factory is not None or isinstance(default, BaseModel) or _holds_models(default):
        return "see meaning" if field.description else "see below"
    return json.dumps(_rounded(default))


def _rounded(default: Any) -> Any:
    """The default with floats of four digits; those that are integers without a point."""
    if isinstance(default, tuple):
        return [_rounded(member) for member in default]
    if isinstance(default, float):
        return int(default) if default.is_integer() else float(f"{default:.4g}")
    return default


def _holds_models(value: object) -> bool:
    return isinstance(value, tuple) and any(isinstance(member, BaseModel) for member in value)


if __name__ == "__main__":
    options_to_run()  # loads the plug-ins, whose fields are on the page
    PAGE.write_text(page(), "utf-8")
