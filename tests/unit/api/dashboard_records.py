"""A record with jobs in every state, and the dashboard on it."""

import copy
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from html.parser import HTMLParser
from pathlib import Path
from typing import Any, cast

import httpx
from fastapi import FastAPI
from httpx import ASGITransport

from scene_attack.rendering.plan import GradientError, Item, Plan, Stage
from scene_attack.runs.result import JobWarning, Result, outcome
from scene_attack.runs.spec import JobSpec, parse
from scene_attack_api import dashboard
from scene_attack_api.requests import Services, caller
from scene_attack_service.access.caller import KEYLESS
from scene_attack_service.jobs.database import connect, migrate
from scene_attack_service.jobs.leases import Attempt
from scene_attack_service.jobs.models import Artifact, Job
from scene_attack_service.jobs.queue import Queue
from scene_attack_service.jobs.record import Record
from scene_attack_service.settings import Settings

SPEC = parse(
    {
        "scene": {"objects": [{"mesh": "furniture/grand-piano"}]},
        "goal": {"leave": "grand piano"},
        "attack": {"renderer": "torch"},
        "seed": 7,
    }
)


ATTRIBUTION = {
    "parts": ["normals", "illumination"],
    "method": "exact",
    "images": 2,
    "log_odds": {"effect": -3.0, "shapley": [-2.25, -0.75], "interactions": [[0.0, 0.5], [0.5, 0.0]]},
    "probability": {"effect": -0.4, "shapley": [-0.31, -0.09], "interactions": [[0.0, 0.02], [0.02, 0.0]]},
}


CHANGE = {
    "group": "translation",
    "subject": "drill",
    "sentence": "moved 4.2 cm right",
    "values": [{"name": "object 0 translation x", "unit": "cm", "before": 10.0, "after": 14.2}],
}


def row(step: int, **changed: Any) -> dict[str, Any]:
    """A row of a trace whose numbers fall and rise with the step."""
    return {
        "step": step,
        "loss": 0.8 * 0.6**step,
        "label": "grand piano" if step < 4 else "upright",
        "confidence": 0.8 if step < 4 else 0.55,
        "advantage": 3.0 - step,
        "objective": 3.0 - step,
        "distance": 2.0 * step,
        "perceptibility": 0.003 * step,
        "truncated": 0,
        "below_noise": 0,
        "queries": 2 * step + 2,
        "renders": 2 * step + 2,
        "seconds": 0.25 * step,
    } | changed


def result(spec: JobSpec = SPEC, **changed: Any) -> dict[str, Any]:
    """A result that a job of this spec could have, with these parts or fields of parts changed."""

    def answer(label: str, confidence: float) -> dict[str, Any]:
        top = [
            [label, confidence],
            ["upright", 0.1],
            ["accordion", 0.05],
            ["desk", 0.002],
            ["harp", 0.0000213],
        ]
        return {"label": label, "index": 1, "confidence": confidence, "goal_probability": 0.2, "top": top}

    def subset(groups: list[str], fooled: bool) -> dict[str, Any]:
        said = "upright" if fooled else "grand piano"
        return {
            "groups": groups,
            "label": said,
            "confidence": 0.6,
            "goal_probability": 0.31,
            "goal_log_odds": -0.8,
            "float_perceptibility": 0.00375 * len(groups),
            "perceptibility": 0.004 * len(groups),
            "fooled": fooled,
        }

    values: dict[str, Any] = {
        "spec": spec.model_dump(mode="json"),
        "verdict": {
            "outcome": "fooled",
            "truth": ["grand piano"],
            "right_before": True,
            "fooled": True,
            "verified": True,
            "stopped": "verified",
            "leave": "grand piano",
            "labels_to_leave": ["grand piano"],
            "reach": None,
        },
        "original": answer("grand piano", 0.77),
        "attacked": answer("upright", 0.55),
        "in_loop": answer("upright", 0.58),
        "change": {
            "step": 5,
            "float_perceptibility": 0.0117,
            "perceptibility": 0.0123,
            "group_perceptibility": {"normals": 0.02, "illumination": 0.01, "material": 0.03},
            "at_epsilon": {},
            "beyond_truncation": 4,
            "things": [CHANGE],
        },
        "plan": Plan.of(
            "torch",
            ["normals", "illumination"],
            (224, 224),
            1e-3,
            [Item(part="object 0", what="lobes", kept=4, of=9, why="five are <dark>", error=2e-5)],
            [
                Stage(
                    part="object 0",
                    name="pixels",
                    method="looked up",
                    when="every image",
                    evaluations=9293,
                    unit="lookups",
                    why="11 times less work",
                    error=4e-4,
                )
            ],
            [GradientError(part="object 0", group="normals", relative=0.01, wrong_signs=0.025)],
        ),
        "measured": {
            "image_error": 1.5e-4,
            "sampled_error": {"mean": 2.5e-5, "share": 0.0031},
            "settings": {"delta": {"normals": 0.001}},
        },
        "cost": {"steps": 5, "queries": 1234, "surrogate_queries": 0, "renders": 12, "truncated": 3, "seconds": 1.25},
        "subsets": [
            subset([], False),
            subset(["normals"], False),
            subset(["illumination"], False),
            subset(["normals", "illumination"], True),
        ],
        "attribution": ATTRIBUTION,
        "trace": [row(step) for step in range(6)],
        "provenance": {
            "seed": 7,
            "backend": "torch 2.13; OSMesa",
            "versions": {"python": "3.11"},
            "scene_sha256": "5c" * 32,
            "weights_sha256": "3e" * 32,
            "meshes": {"furniture/grand-piano": "9a" * 32},
            "plugins": {"mine 1.0": "1f" * 32},
            "credits": ["“Grand piano” by Dante, CC0 1.0"],
        },
    }
    return Result.model_validate(with_fields(values, **changed)).model_dump(mode="json")


def with_fields(result: dict[str, Any], **changed: Any) -> dict[str, Any]:
    """A copy of a result in which these parts, or fields of its parts, are others."""
    copied = copy.deepcopy(result)
    for name, value in changed.items():
        parts = [copied[part] for part in ("verdict", "change", "measured", "cost") if name in copied[part]]
        (parts[0] if parts else copied)[name] = value
    return copied


def add(record: Record, spec: JobSpec = SPEC, warnings: Sequence[JobWarning] = ()) -> Job:
    """A queued job."""
    job, _ = record.jobs.create(spec, 1000, None, lambda _: {}, warnings)
    assert job is not None
    return job


def start(record: Record, job: Job) -> Attempt:
    """The job, running."""
    attempt = record.leases.lease(job.id, "worker", 20)
    assert attempt is not None
    return attempt


def succeed(record: Record, job: Job, found: dict[str, Any]) -> None:
    """The job, ended with this result and its images."""
    attempt = start(record, job)
    artifacts = [
        Artifact(job_id=job.id, name=name, sha256="ab" * 32, media_type="image/png", size=12345)
        for name in ("original.png", "attacked.png", "perturbation.png")
    ]
    assert record.leases.succeed(attempt, found, outcome(Result.model_validate(found)), artifacts)


@contextmanager
def open_record(folder: Path) -> Iterator[Record]:
    """An empty record in a folder."""
    settings = Settings(data=folder)
    engine = connect(settings)
    migrate(engine, settings)
    yield Record(engine)
    engine.dispose()


def app(record: Record, queue: Queue | None = None) -> FastAPI:
    """The dashboard alone, on this record. It uses nothing else of the services."""
    made = FastAPI()
    made.include_router(dashboard.router)
    made.dependency_overrides[caller] = lambda: KEYLESS
    none = cast(Any, None)
    made.state.services = Services(
        keys=none,
        sessions=none,
        assets=none,
        quotas=none,
        record=record,
        queue=cast(Any, queue),
        submissions=none,
        store=none,
        library=none,
        pool=none,
        checks=none,
        uploads=none,
        exporter=none,
        watcher=none,
        storage=none,
        deleted_assets=none,
    )
    return made


class Tags(HTMLParser):
    """All start tags with their attributes, and all text."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.found: list[tuple[str, dict[str, str | None]]] = []
        self.words: list[str] = []
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, dict(attrs)))

    def handle_data(self, data: str) -> None:
        self.words.append(data)

    def all(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.found if name == tag]

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.words).split())


async def send(record: Record, path: str, form: dict[str, str] | None = None) -> httpx.Response:
    """The dashboard's answer: to a form that is sent, or else of a page."""
    async with httpx.AsyncClient(transport=ASGITransport(app(record)), base_url="http://dashboard") as client:
        return await client.get(path) if form is None else await client.post(path, data=form)
