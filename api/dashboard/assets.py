"""Routes of the dashboard's pages about assets: the meshes and environment maps that a scene can name."""

from dataclasses import dataclass
from math import degrees
from typing import Annotated, Literal
from urllib.parse import urlencode

from fastapi import APIRouter, Query, Response

from api.authentication import CallerDependency
from api.dashboard.pages import HEADERS, html
from api.schemas import Uploaded
from api.state import ServicesDependency, no_such
from services.jobs.asset_record import FirstAnswer
from services.jobs.models import Job
from services.scenes.entries import Entry

PAGE = 60
"""Number of assets on one page."""
JOBS = 24
"""Largest number of jobs whose images an asset's page shows."""

Kind = Literal["furniture", "primitive", "upload", "environment"]
Text = Annotated[str, Query(max_length=200)]


router = APIRouter(include_in_schema=False)


@dataclass(frozen=True)
class Shown:
    """An asset in the grid: its picture, if it has one, and the networks' first answers, if there are any."""

    entry: Entry
    picture: str | None
    answers: list[FirstAnswer]


@dataclass(frozen=True)
class View:
    """A job on the asset; the azimuth of its view is in degrees."""

    job: Job
    azimuth: float


@router.get("/assets")
def assets(
    services: ServicesDependency,
    caller: CallerDependency,
    kind: Kind | None = None,
    category: Text = "",
    licence: Text = "",
    q: Text = "",
    page: Annotated[int, Query(ge=1, le=10_000)] = 1,
) -> Response:
    """A grid of assets, narrowed by kind, category, licence and words."""
    everything = [*services.library.entries(may_see=services.assets.visible(caller)), *services.library.environments()]
    words = q.lower().split()
    found = [
        entry
        for entry in everything
        if kind in (None, entry.kind)
        and category in ("", entry.category)
        and licence in ("", entry.licence)
        and all(word in f"{entry.name} {entry.title} {entry.creator}".lower() for word in words)
    ]
    begin = (page - 1) * PAGE
    entries = found[begin : begin + PAGE]
    answers = services.asset_records.first_answers([entry.name for entry in entries], caller.only)
    chosen = {"kind": kind or "", "category": category, "licence": licence, "q": q}
    pages = {"newer": page - 1 if page > 1 else None, "older": page + 1 if begin + PAGE < len(found) else None}
    return html(
        "assets.html",
        caller=caller,
        shown=[Shown(entry, picture(entry), answers.get(entry.name, [])) for entry in entries],
        count=len(found),
        begin=begin,
        chosen=chosen,
        kinds=list(dict.fromkeys(entry.kind for entry in everything)),
        categories=sorted({entry.category for entry in everything}),
        licences=sorted({entry.licence for entry in everything}),
        links={way: None if at is None else _address(chosen, at) for way, at in pages.items()},
    )


@router.get("/assets/pictures/{asset:path}")
def asset_picture(asset: str, services: ServicesDependency) -> Response:
    """The picture that a furniture library has of its model."""
    data = services.library.picture(asset)
    if data is None:
        raise no_such("picture")
    headers = HEADERS | {"Cache-Control": "private, max-age=86400", "Content-Security-Policy": "default-src 'none'"}
    return Response(data, headers=headers, media_type="image/png")


@router.get("/assets/{asset:path}")
def one_asset(asset: str, services: ServicesDependency, caller: CallerDependency) -> Response:
    """The page of one asset."""
    everything = [*services.library.entries(may_see=services.assets.visible(caller)), *services.library.environments()]
    entry = next((one for one in everything if one.name == asset), None)
    if entry is None:
        raise no_such("asset")
    jobs = services.asset_records.jobs(entry.name, JOBS, caller.only)
    answers = services.asset_records.first_answers([entry.name], caller.only).get(entry.name, [])
    views = [View(job, degrees(job.spec["scene"]["camera"]["azimuth"])) for job in jobs]
    shown = Shown(entry, picture(entry), answers)
    return html("asset.html", caller=caller, one=shown, views=sorted(views, key=lambda v: v.azimuth))


def picture(entry: Entry) -> str | None:
    """The address of an asset's picture; None if it has none."""
    if entry.kind == "furniture":
        return f"/assets/pictures/{entry.name}"
    return Uploaded.of(entry).thumbnail if entry.name.startswith("sha256:") else None


def _address(chosen: dict[str, str], page: int) -> str:
    return "/assets?" + urlencode({name: value for name, value in chosen.items() if value} | {"page": page})
