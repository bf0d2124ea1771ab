"""The record: everything that the service knows of jobs, campaigns and uploads, in its database."""

from sqlalchemy import Engine

from services.jobs.campaigns import Campaigns
from services.jobs.database import Clock, Database
from services.jobs.job_list import JobLists
from services.jobs.jobs import Jobs
from services.jobs.leases import Leases
from services.jobs.queue import Scheduler
from services.jobs.statistics import Figures, TargetRecords
from services.jobs.uploads import AssetRecords


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
