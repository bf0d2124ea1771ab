"""A record with many jobs, as tests and benchmarks of long lists need it: `fill`."""

import random
from datetime import UTC, datetime, timedelta
from typing import Any

from sqlalchemy.orm import Session

from scene_attack.runs.spec import parse
from scene_attack_service.jobs.database import connect
from scene_attack_service.jobs.models import Job, State, listed, listed_outcome
from scene_attack_service.jobs.queue import Needs
from scene_attack_service.settings import Settings

MESHES = ("furniture/grand-piano", "furniture/sofa", "primitive/sphere", "primitive/cube")


def fill(settings: Settings, jobs: int, rows: int = 0, seed: int = 7) -> None:
    """Adds jobs of several scenes and renderers, submitted a second apart: 85 % succeeded, 10 % failed, 5 % queued.
    Results have a trace of `rows` rows of 65 bytes.
    """
    chance = random.Random(seed)
    kinds = [
        parse({"scene": {"objects": [{"mesh": mesh}]}, "attack": {"renderer": renderer}}).model_dump(mode="json")
        for mesh in MESHES
        for renderer in ("image", "torch", "pyrender")
    ]
    result = {"trace": [{"step": step, "loss": chance.random(), "label": "grand piano"} for step in range(rows)]}
    began = datetime.now(UTC) - timedelta(seconds=jobs)
    engine = connect(settings).execution_options(writes=True)
    with Session(engine) as session, session.begin():
        for number in range(jobs):
            spec, at = kinds[number % len(kinds)], began + timedelta(seconds=number)
            ended = {} if number % 20 == 0 else _failed(at) if number % 20 < 3 else _succeeded(at, chance, result)
            about = {"state": State.QUEUED, "created_at": at, "queued_at": at, "seed": 0, "events": 1} | ended
            about |= {"needs": Needs().text, "warnings": []}
            session.add(Job(id=f"{chance.getrandbits(128):032x}", spec=spec, **listed(spec), **about))
            if number % 500 == 0:
                session.flush()
                session.expunge_all()
    engine.dispose()


def _failed(at: datetime) -> dict[str, Any]:
    return {
        "state": State.FAILED,
        "failed_at": at,
        "ended_at": at,
        "failure_kind": "timeout",
        "failure_detail": "3600 s",
    }


def _succeeded(at: datetime, chance: random.Random, result: dict[str, Any]) -> dict[str, Any]:
    fooled = chance.random() < 0.7
    outcome = {
        "outcome": "fooled" if fooled else "held",
        "right_before": True,
        "fooled": fooled,
        "verified": fooled,
        "stopped": "verified",
        "before": "grand piano",
        "before_confidence": chance.random(),
        "after": "upright" if fooled else "grand piano",
        "after_confidence": chance.random(),
        "answers": [],
        "float_perceptibility": 0.01 * chance.random(),
        "perceptibility": 0.01 * chance.random(),
        "steps": chance.randrange(1, 500),
        "queries": chance.randrange(2, 50_000),
        "seconds": 100 * chance.random(),
    }
    ended = {"state": State.SUCCEEDED, "succeeded_at": at, "ended_at": at}
    return ended | {"outcome": outcome, "result": result, **listed_outcome(outcome)}
