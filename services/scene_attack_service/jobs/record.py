"""The record: everything that the service knows of jobs, campaigns and uploads, in its database."""

from sqlalchemy import Engine

from scene_attack_service.jobs.campaigns import Campaigns
from scene_attack_service.jobs.database import Clock, Database
from scene_attack_service.jobs.job_list import JobLists
from scene_attack_service.jobs.jobs import Jobs
from scene_attack_service.jobs.leases import Leases
from scene_attack_service.jobs.queue import Scheduler
from scene_attack_service.jobs.statistics import Figures, TargetRecords
from scene_attack_service.jobs.uploads import AssetRecords


class Record:
    """The record, with a part for each kind of question, all on the same database and clock."""

    def __init__(self, engine: Engine, clock: Clock | None = None) -> None:
        self.database = Database(engine, clock)  # the only way to open a transaction
        self.jobs = Jobs(self.database)  # for clients: create, get, cancel, events, artifacts, delete
        self.leases = Leases(self.database)  # for workers: lease, renew, report, finish; fenced by attempt number
        self.scheduler = Scheduler(self.database)  # which job is next, and why jobs wait
        self.lists = JobLists(self.database)
        self.campaigns = Campaigns(self.database)
        self.uploads = AssetRecords(self.database)
        self.targets = TargetRecords(self.database)
        self.figures = Figures(self.database)
