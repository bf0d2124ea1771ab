"""Writes the part of docs/scene.md that follows from the registries: settings of attacks, and groups of renderers.

`python -m services.pipeline.field_tables` writes it again.
"""

import json
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from services.attacks.attack import ATTACKS
from services.attacks.expectation import Expectation
from services.rendering.declaration import RENDERERS

PAGE = Path(__file__).parents[2] / "docs" / "scene.md"
BEGIN = "<!-- written by python -m services.pipeline.field_tables -->"
END = "<!-- end -->"


def tables() -> str:
    """The part as Markdown: a section for each attack, and one for the renderers."""
    lines: list[str] = []
    for name, attack in ATTACKS.items():
        lines += [f"## `attack` with `method: {name}`", "", " ".join((attack.settings.__doc__ or "").split()), ""]
        lines += _fields(attack.settings)
    lines += ["## `attack.expectation`", "", " ".join((Expectation.__doc__ or "").split()), "", *_fields(Expectation)]
    lines += ["## Renderers and their parameter groups", ""]
    lines += ["If a request leaves `method` out, it is the method that this table gives for the renderer. *limit* is"]
    lines += ["the `epsilon` of methods that need one, where the request gives none and nothing else limits them.", ""]
    columns = ("renderer", "method", "group", "shape", "unit", "step of fgsm", "limit")
    return "\n".join(lines + list(_table(columns, _groups()))).rstrip()


def _fields(model: type[BaseModel]) -> Iterator[str]:
    rows = ([f"`{name}`", _default(field), field.description or ""] for name, field in model.model_fields.items())
    return _table(("field", "default", "meaning"), rows)


def page(text: str) -> str:
    """The Markdown page `text` with the part between `BEGIN` and `END` replaced by `tables()`."""
    before, rest = text.split(BEGIN)
    return f"{before}{BEGIN}\n\n{tables()}\n\n{END}{rest.split(END)[1]}"


def _groups() -> Iterator[list[str]]:
    for name, renderer in RENDERERS.items():
        for group in renderer.groups:
            step = "" if group.suggested_step is None else f"{group.suggested_step:g}"
            limit = "" if group.suggested_limit is None else f"{group.suggested_limit:.2g}"
            shape = "×".join(group.shape)
            yield [f"`{name}`", f"`{renderer.method}`", f"`{group.name}`", shape, group.unit, step, limit]


def _table(columns: Iterable[str], rows: Iterable[list[str]]) -> Iterator[str]:
    yield f"| {' | '.join(columns)} |"
    yield "|" + "---|" * len(list(columns))
    for row in rows:
        yield f"| {' | '.join(row)} |"
    yield ""


def _default(field: FieldInfo) -> str:
    if field.default_factory is not None:
        return "see meaning"
    default: Any = field.default
    return "required" if field.is_required() else json.dumps(list(default) if isinstance(default, tuple) else default)


if __name__ == "__main__":
    PAGE.write_text(page(PAGE.read_text("utf-8")), "utf-8")
