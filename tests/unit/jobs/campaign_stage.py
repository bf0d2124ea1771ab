"""A record with a feeder, and a worker that is played by the test: it renders nothing."""

from typing import Any

from sqlalchemy import Engine, select
from sqlalchemy.orm import Session

from scene_attack.runs.campaign_plan import identity
from scene_attack.runs.campaign_spec import CampaignSpec, parse
from scene_attack.runs.result import Provenance, Result, outcome
from scene_attack.runs.spec import JobSpec
from scene_attack.runs.spec import parse as parse_job
from scene_attack_service.jobs.campaigns import Campaigns, Feeder
from scene_attack_service.jobs.database import Database
from scene_attack_service.jobs.models import Campaign, CampaignState, Job, State, not_paused
from scene_attack_service.jobs.record import Record
from tests.unit.api.dashboard_records import result

QUEUED = 3
"""Jobs of campaigns that the feeder of these tests queues at a time."""


def spec(count: int = 4, seed: int = 0, **values: Any) -> CampaignSpec:
    """Views of a sphere, one attack, one target."""
    grid = {
        "scenes": {"meshes": ["primitive/sphere"], "views": [0.01 * i for i in range(count)]},
        "attacks": [{"name": "normals", "attack": {"renderer": "torch", "groups": ["normals"]}}],
        "seeds": [seed],
    }
    return parse({"name": "c", "grids": [grid]} | values)


class Stage:
    """A record with a feeder, and a worker without a renderer."""

    def __init__(self, engine: Engine, record: Record) -> None:
        self.engine = engine
        self.record = record
        self.campaigns = Campaigns(Database(engine))
        self.feeder = Feeder(Database(engine), QUEUED)

    def begin(self, campaign: CampaignSpec, owner: str = "") -> str:
        return self.campaigns.submit(campaign, None, owner).id

    def state(self, campaign_id: str) -> CampaignState:
        return self.campaign(campaign_id).state

    def campaign(self, campaign_id: str) -> Campaign:
        found = self.campaigns.get(campaign_id, whole=True)
        assert found is not None
        return found

    def queued(self) -> list[Job]:
        """The queued jobs that may run, oldest first."""
        queued = select(Job).where(Job.state == State.QUEUED, not_paused()).order_by(Job.created_at, Job.id)
        with Session(self.engine) as session:
            return list(session.scalars(queued))

    def work(self, job: Job, right: bool = True) -> None:
        """Runs one job as a worker would."""
        attempt = self.record.leases.lease(job.id, "w", 20)
        assert attempt is not None
        if "views" in job.spec:
            answers = [self.answer(one, right) for one in job.spec["views"]]
            self.record.leases.progress(attempt, "selecting", len(answers), len(answers), [])
            self.record.leases.succeed(attempt, {"answers": answers}, {}, [])
        else:
            made = self.result(parse_job(job.spec))
            self.record.leases.succeed(attempt, made, outcome(Result.model_validate(made)), [])

    @staticmethod
    def result(job: JobSpec, **changed: Any) -> dict[str, Any]:
        about: dict[str, Any] = {"outcome": "fooled", "right_before": True, "truth": ["balloon"]}
        made = result(job, **(about | changed))
        made["provenance"]["plugins"] = {}
        return made

    def answer(self, asked: dict[str, Any], right: bool) -> dict[str, Any]:
        result = self.result(parse_job(asked["probe"]))
        provenance, original = Provenance.model_validate(result["provenance"]), result["original"]
        return {
            "view": asked["number"],
            "label": "balloon" if right else "teapot",
            "confidence": 0.5,
            "truth": ["balloon"],
            "refused": None,
            "spec": asked["probe"],
            "identity": identity(provenance, original["label"], original["confidence"]),
        }

    def selected(self, campaign_id: str) -> None:
        """Brings a campaign to the point at which its jobs are queued."""
        while self.state(campaign_id) is CampaignState.SELECTING:
            self.feeder.tick()
            for job in self.queued():
                if "views" in job.spec:
                    self.work(job)

    def finish(self, campaign_id: str) -> None:
        while not self.state(campaign_id).terminal:
            for job in self.queued():
                self.work(job)
            self.feeder.tick()
