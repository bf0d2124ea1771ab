"""Renders the dashboard's pages from its templates, with headers that let them load nothing from other sites."""

from collections.abc import Iterator
from datetime import UTC, datetime
from hashlib import sha256
from importlib.resources import files
from importlib.resources.abc import Traversable
from typing import Any

from fastapi import Request, Response
from fastapi.responses import HTMLResponse
from jinja2 import ChoiceLoader, Environment, FunctionLoader, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

from scene_attack.runs.spec import group_words
from scene_attack.runs.task_parts import TASKS
from scene_attack.text import signed
from scene_attack_api.dashboard import words
from scene_attack_api.dashboard.charts import around, polar
from scene_attack_api.dashboard.views import OF_TASKS
from scene_attack_service.access.caller import Caller
from scene_attack_service.jobs.models import CampaignState, State

HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; img-src 'self'; style-src 'self'; script-src 'self'; connect-src 'self'; "
        "form-action 'self'; base-uri 'none'; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "same-origin",
    "Cache-Control": "no-store",
}


def _static(folder: Traversable, before: str = "") -> Iterator[tuple[str, bytes]]:
    for entry in folder.iterdir():
        if entry.is_dir():
            yield from _static(entry, f"{before}{entry.name}/")
        else:
            yield before + entry.name, entry.read_bytes()


AREAS = (
    ("jobs", "/", "Jobs"),
    ("new", "/new", "New job"),
    ("campaigns", "/campaigns", "Campaigns"),
    ("assets", "/assets", "Assets"),
    ("targets", "/targets", "Targets"),
    ("reference", "/docs", "API reference"),
)
"""The areas of the dashboard: name, address and title. A template sets `area` to the name of its own."""


STATIC = dict(_static(files(__package__).joinpath("static")))
"""The style sheets, scripts and images of pages, by path."""
VERSION = sha256(b"".join(name.encode() + STATIC[name] for name in sorted(STATIC))).hexdigest()[:12]


def static(name: str) -> str:
    """The address of a file of `STATIC`. It contains the version as a folder, so that what a module imports by a
    relative address has it too. Raises KeyError if there is no such file.
    """
    STATIC[name]
    return f"/static/{VERSION}/{name}"


def prose(text: str) -> Markup:
    """Text of the API's description as HTML: what stands between backticks is code."""
    parts = text.split("`")
    return Markup("").join(
        Markup("<code>{}</code>").format(part) if k % 2 else escape(part) for k, part in enumerate(parts)
    )


def _of_task(name: str) -> str | None:
    """The template that a task brings, whose name is that of the task after `OF_TASKS`; None if there is none."""
    place, _, task = name.partition("/")
    part = TASKS[task].result if place == OF_TASKS and task in TASKS else None
    return None if part is None or part.template is None else part.template.read_text("utf-8")


_templates = Environment(
    loader=ChoiceLoader([PackageLoader(__package__), FunctionLoader(_of_task)]),
    autoescape=True,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)
_templates.globals |= {
    "version": VERSION,
    "static": static,
    "words": words,
    "group_words": group_words,
    "signed": signed,
    "states": list(State),
}
_templates.globals["areas"] = AREAS
_templates.filters["prose"] = prose
_templates.globals |= {"campaign_states": list(CampaignState), "polar": polar, "around": around}


def part_of(request: Request, page: str) -> str:
    """The template of a page, or that of the part of it which its script reloads from the path below /parts."""
    return f"_{page}" if request.url.path.startswith("/parts/") else page


def html(template: str, status: int = 200, caller: Caller | None = None, **values: Any) -> Response:
    """A page made of a template and values, for a caller who can sign out if it has a key."""
    text = _templates.get_template(template).render(now=datetime.now(UTC), caller=caller, **values)
    return HTMLResponse(text, status, HEADERS)
