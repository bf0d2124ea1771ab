"""The tables of the record. The database holds the state of every job; Redis only wakes workers."""

from collections.abc import Mapping
from datetime import UTC, datetime
from enum import StrEnum
from typing import Any

from sqlalchemy import (
    JSON,
    BigInteger,
    DateTime,
    Dialect,
    Enum,
    Float,
    ForeignKey,
    Index,
    String,
    Text,
    TypeDecorator,
    literal,
    or_,
    select,
    text,
    true,
    tuple_,
)
from sqlalchemy.orm import DeclarativeBase, Mapped, mapped_column
from sqlalchemy.sql.elements import ColumnElement

from scene_attack.analysis.verdict import SUCCESS
from scene_attack.client.states import CampaignState as CampaignState
from scene_attack.client.states import JobKind as JobKind
from scene_attack.client.states import Priority, times_of
from scene_attack.client.states import State as State
from scene_attack.runs.spec import asked_of, attack_name, job_name, scene_name


class UtcTime(TypeDecorator[datetime]):
    """A column of aware UTC datetimes. SQLite stores no time zone, so it is removed on writing and added on reading."""

    impl = DateTime
    cache_ok = True

    def process_bind_param(self, value: datetime | None, dialect: Dialect) -> datetime | None:  # noqa: ARG002
        """Converts an aware datetime to the naive UTC time that the database stores."""
        return None if value is None else value.astimezone(UTC).replace(tzinfo=None)

    def process_result_value(self, value: datetime | None, dialect: Dialect) -> datetime | None:  # noqa: ARG002
        """Converts the naive UTC time of the database to an aware datetime."""
        return None if value is None else value.replace(tzinfo=UTC)


def place(before: tuple[datetime, str]) -> ColumnElement[Any]:
    """A (created_at, id) as SQL. The time has the columns' type: PostgreSQL would compare an aware datetime with a
    column that has no time zone in the zone of the session.
    """
    return tuple_(literal(before[0], UtcTime()), before[1])


def _words(kind: type[StrEnum]) -> Enum:
    return Enum(
        kind, native_enum=False, length=16, values_callable=lambda members: [member.value for member in members]
    )


class Base(DeclarativeBase):
    """Base of the tables."""

    type_annotation_map = {  # noqa: RUF012
        datetime: UtcTime,
        dict[str, Any]: JSON,
        list[Any]: JSON,
        list[dict[str, Any]]: JSON,
        State: _words(State),
        CampaignState: _words(CampaignState),
        JobKind: _words(JobKind),
        Priority: _words(Priority),
    }


LISTED_BY = (
    *("kind", "created_at", "id", "state", "owner", "campaign_id", "title", "scene", "renderer", "method", "target"),
    *("verdict", "verified", "p", "queries", "seconds", "ended_at", "priority"),
)
"""Columns by which lists filter, sort and count, in one index: they need not read the rows, whose requests and results
are long. Together the texts stay below the 2.7 kB that PostgreSQL allows an entry.
"""


class Job(Base):
    """One attack on one scene, from request to result."""

    __tablename__ = "jobs"
    __table_args__ = (
        Index("jobs_by_state", "state", "created_at", "id"),
        Index("jobs_by_turn", "state", "campaign_id", "kind"),
        Index("jobs_by_age", "created_at", "id"),
        Index("jobs_by_owner", "owner", "created_at", "id"),
        Index("jobs_by_start", "owner", "priority", "running_at"),
        Index("jobs_by_digest", "digest"),
        Index("jobs_by_campaign", "campaign_id", "created_at", "id"),
        Index("jobs_by_list", *LISTED_BY),
        Index("jobs_by_retry", "retry_of"),
    )

    id: Mapped[str] = mapped_column(String(32), primary_key=True)
    state: Mapped[State]
    spec: Mapped[dict[str, Any]]
    seed: Mapped[int] = mapped_column(BigInteger)
    created_at: Mapped[datetime]
    kind: Mapped[JobKind] = mapped_column(default=JobKind.ATTACK, server_default="attack")
    digest: Mapped[str | None] = mapped_column(String(64))
    """Digest of the spec (scene_attack.runs.campaign_plan), by which a campaign finds earlier results."""
    campaign_id: Mapped[str | None] = mapped_column(String(32))
    """The campaign that queued the job."""
    owner: Mapped[str] = mapped_column(String(100), default="", server_default="")
    """Sender of the job or its campaign: the owner of the key, "" for a service without keys."""

    priority: Mapped[Priority] = mapped_column(default=Priority.NORMAL, server_default="normal")
    needs: Mapped[str] = mapped_column(Text)
    """Requirements on the worker that runs it (scene_attack_service.jobs.queue.Needs.text)."""
    waiting: Mapped[str | None] = mapped_column(Text)
    """Reason why none of the live workers takes the queued job; None if one of them can."""

    # What lists show of `spec` (`listed`); None for jobs that no list shows.
    name: Mapped[str | None] = mapped_column(String(300))
    scene: Mapped[str | None] = mapped_column(String(300))
    attack: Mapped[str | None] = mapped_column(String(300))
    renderer: Mapped[str | None] = mapped_column(String(300))
    method: Mapped[str | None] = mapped_column(String(300))
    target: Mapped[str | None] = mapped_column(String(300))
    asked: Mapped[str | None] = mapped_column(String(300))

    # What a person has said about the job (scene_attack_service.jobs.job_list).
    title: Mapped[str | None] = mapped_column(String(100))
    note: Mapped[str | None] = mapped_column(Text)
    tags: Mapped[list[Any] | None]
    """Sorted; the table `job_tags` has the same for lists that filter by them."""
    retry_of: Mapped[str | None] = mapped_column(String(32))
    """The job whose request this one repeats."""

    # What lists show and sort by of `outcome` (`listed_outcome`); None until the job succeeded.
    verdict: Mapped[str | None] = mapped_column(String(16))
    verified: Mapped[bool | None]
    """Whether the attack succeeded: the network was fooled, and still is when the adversary is rendered afresh."""
    p: Mapped[float | None] = mapped_column(Float(53))
    queries: Mapped[int | None] = mapped_column(BigInteger)
    seconds: Mapped[float | None] = mapped_column(Float(53))
    ended_at: Mapped[datetime | None]
    """The time at which the job entered a state that is the last."""

    queued_at: Mapped[datetime | None]
    running_at: Mapped[datetime | None]
    cancelling_at: Mapped[datetime | None]
    succeeded_at: Mapped[datetime | None]
    failed_at: Mapped[datetime | None]
    rejected_at: Mapped[datetime | None]
    cancelled_at: Mapped[datetime | None]

    attempt: Mapped[int] = mapped_column(default=0)
    """Number of times that a worker leased the job. Writes carry it and change nothing if it has increased since."""
    lost: Mapped[int] = mapped_column(default=0)
    """Number of attempts in a row that ended with their process before they got further than those before."""
    furthest: Mapped[int] = mapped_column(BigInteger, default=0, server_default=text("0"))
    """Greatest progress of the lost attempts (scene_attack_service.jobs.leases.distance)."""
    lease_owner: Mapped[str | None] = mapped_column(String(100))
    lease_until: Mapped[datetime | None]

    checked: Mapped[bool] = mapped_column(default=True, server_default=true())
    """Whether the scene was rendered and the network asked before the job was accepted, or by a worker since."""
    errors: Mapped[list[dict[str, Any]] | None]
    """The invalid fields of a rejected job, each as {"field", "detail"}."""
    warnings: Mapped[list[Any]]
    """Warnings to the sender (scene_attack.runs.result.JobWarning)."""
    phase: Mapped[str | None] = mapped_column(String(32))
    step: Mapped[int | None]
    steps: Mapped[int | None]
    phase_at: Mapped[datetime | None]
    """The time at which the attempt entered the phase; None while there is no attempt."""
    steps_done: Mapped[int] = mapped_column(default=0, server_default="0")
    """Steps of the attack that any attempt has come to."""
    queries_done: Mapped[int] = mapped_column(BigInteger, default=0, server_default="0")
    """Images that the target classified until then."""
    outcome: Mapped[dict[str, Any] | None]
    """The part of the result that lists show (scene_attack.runs.result)."""
    result: Mapped[dict[str, Any] | None] = mapped_column(deferred=True)
    failure_kind: Mapped[str | None] = mapped_column(String(64))
    failure_detail: Mapped[str | None] = mapped_column(Text)
    events: Mapped[int] = mapped_column(default=0)
    """Number of the last event."""

    @property
    def times(self) -> dict[str, datetime]:
        """The last time at which the job entered each state, in the order of the states."""
        return times_of(self)


LONGEST_TEXT = 300
"""Characters of a listed text; a scene may have many meshes. Longer ones end in an ellipsis."""


def listed(spec: Mapping[str, Any], titles: Mapping[str, str] | None = None) -> dict[str, str | None]:
    """The listed columns of the full spec of an attack or re-rendering, by name; `titles` are those of uploads, by
    their names in scenes.
    """
    asked = asked_of(spec)
    if "fit" in spec:
        work = {"attack": "re-rendering", "renderer": "torch", "method": f"fit by {spec['fit']['optimiser']}"}
    else:
        attack = spec["attack"]
        work = {"attack": attack_name(spec), "renderer": attack["renderer"], "method": attack["method"]}
    columns = {
        "name": job_name(spec, titles),
        "scene": scene_name(spec, titles),
        **work,
        "target": spec["target"]["name"],
        "asked": asked.names[0] if asked is not None and asked.names else None,
    }
    return {column: _cut(text) for column, text in columns.items()}


def listed_outcome(outcome: Mapping[str, Any]) -> dict[str, Any]:
    """The columns of an outcome (scene_attack.runs.result) that lists sort and filter by; p is the paper's."""
    return {
        "verdict": outcome["outcome"],
        "verified": outcome["outcome"] == SUCCESS and outcome["verified"],
        "p": outcome["float_perceptibility"],
        "queries": outcome["queries"],
        "seconds": outcome["seconds"],
    }


def _cut(text: str | None) -> str | None:
    return text if text is None or len(text) <= LONGEST_TEXT else text[: LONGEST_TEXT - 1] + "…"


class JobTag(Base):
    """A tag of a job, by which lists find it."""

    __tablename__ = "job_tags"
    __table_args__ = (Index("job_tags_by_tag", "tag", "job_id"),)

    job_id: Mapped[str] = mapped_column(ForeignKey("jobs.id", ondelete="CASCADE"), primary_key=True)
    tag: Mapped[str] = mapped_column(String(50), primary_key=True)


class Event(Base):
    """A change of a job's state or progress. Events of a job are numbered without gaps, so a reader can resume."""

    __tablename__ = "events"

    job_id: Mapped[str] = mapped_column(ForeignKey("jobs.id", ondelete="CASCADE"), primary_key=True)
    number: Mapped[int] = mapped_column(primary_key=True)
    kind: Mapped[str] = mapped_column(String(16))
    data: Mapped[dict[str, Any]]
    created_at: Mapped[datetime]


class Artifact(Base):
    """A named file of a finished job, whose bytes are in the artifact store under their hash."""

    __tablename__ = "artifacts"
    __table_args__ = (Index("artifacts_by_hash", "sha256"),)

    job_id: Mapped[str] = mapped_column(ForeignKey("jobs.id", ondelete="CASCADE"), primary_key=True)
    name: Mapped[str] = mapped_column(String(100), primary_key=True)
    sha256: Mapped[str] = mapped_column(String(64))
    media_type: Mapped[str] = mapped_column(String(100))
    size: Mapped[int] = mapped_column(BigInteger)


class Total(Base):
    """A counter of the service (scene_attack_service.jobs.leases)."""

    __tablename__ = "totals"

    name: Mapped[str] = mapped_column(String(32), primary_key=True)
    label: Mapped[str] = mapped_column(String(100), primary_key=True)
    value: Mapped[float] = mapped_column(Float(53))


class IdempotencyKey(Base):
    """A client's key for one submission, with the digest of the request and the first answer to it.

    `key` is that of the owner "", or SHA-256 of an owner and its key (`scene_attack_service.jobs.record.Key.stored`).
    """

    __tablename__ = "idempotency_keys"

    key: Mapped[str] = mapped_column(String(255), primary_key=True)
    digest: Mapped[str] = mapped_column(String(64))
    job_id: Mapped[str] = mapped_column(ForeignKey("jobs.id", ondelete="CASCADE"))
    answer: Mapped[dict[str, Any]]
    created_at: Mapped[datetime]


class Campaign(Base):
    """Many attacks that belong together (scene_attack.runs.campaign_spec)."""

    __tablename__ = "campaigns"
    __table_args__ = (
        Index("campaigns_by_age", "created_at", "id"),
        Index("campaigns_by_owner", "owner", "created_at", "id"),
    )

    id: Mapped[str] = mapped_column(String(32), primary_key=True)
    name: Mapped[str] = mapped_column(String(100))
    owner: Mapped[str] = mapped_column(String(100), default="", server_default="")
    state: Mapped[CampaignState]
    spec: Mapped[dict[str, Any]] = mapped_column(deferred=True)
    created_at: Mapped[datetime]
    selected_at: Mapped[datetime | None]
    """The time at which the views were chosen and the jobs were made."""
    paused_at: Mapped[datetime | None]
    ended_at: Mapped[datetime | None]
    failure: Mapped[str | None] = mapped_column(Text)
    """Reason why the service paused the campaign."""
    demand: Mapped[dict[str, Any] | None]
    """Demands of its jobs on the queue (scene_attack_service.jobs.queue.Demand)."""
    view_count: Mapped[int]
    views: Mapped[list[dict[str, Any]] | None] = mapped_column(deferred=True)
    """Every view, with the first answer and why it is not attacked (scene_attack.runs.campaign_plan.ChosenView)."""
    key: Mapped[str | None] = mapped_column(String(255), unique=True)
    """The client's idempotency key, as `IdempotencyKey.key`."""
    request_digest: Mapped[str] = mapped_column(String(64))


class CampaignJob(Base):
    """A job that a campaign has planned. It gets a row in `jobs` when its turn comes, or takes an earlier one's."""

    __tablename__ = "campaign_jobs"
    __table_args__ = (Index("campaign_jobs_by_job", "job_id"), Index("campaign_jobs_by_end", "ended"))

    campaign_id: Mapped[str] = mapped_column(ForeignKey("campaigns.id", ondelete="CASCADE"), primary_key=True)
    number: Mapped[int] = mapped_column(primary_key=True)
    target: Mapped[str] = mapped_column(String(100))
    attack: Mapped[str] = mapped_column(String(200))
    view: Mapped[int]
    right: Mapped[bool]
    """Whether the network's first answer to the view was right."""
    identity: Mapped[str | None] = mapped_column(String(64))
    """Digest of assets, weights, backend and versions at the selection, which an earlier result must share."""
    digest: Mapped[str] = mapped_column(String(64))
    spec: Mapped[dict[str, Any]] = mapped_column(deferred=True)
    job_id: Mapped[str | None] = mapped_column(ForeignKey("jobs.id", ondelete="SET NULL"))
    reused: Mapped[bool] = mapped_column(default=False)
    ended: Mapped[bool] = mapped_column(default=False)
    """Whether the job has ended and `case` says how."""
    case: Mapped[dict[str, Any] | None]
    """The job as a case of the campaign's table (scene_attack.analysis.campaign_table.Case)."""
    curves: Mapped[dict[str, Any] | None] = mapped_column(deferred=True)
    """The curves of the trace (scene_attack.analysis.campaign_table.Curves)."""


class Asset(Base):
    """An uploaded mesh. Its row is what transactions hold that refer to the mesh, upload it or delete it."""

    __tablename__ = "assets"
    __table_args__ = (Index("assets_by_deletion", "deleted_at"),)

    name: Mapped[str] = mapped_column(String(100), primary_key=True)
    """The name by which scenes call the mesh."""
    title: Mapped[str | None] = mapped_column(String(100))
    """The name that people see, if its uploader gave one."""
    deleted_at: Mapped[datetime | None]
    """The time at which it was deleted; None while it is there. The row stays for as long as a request may take."""


class JobAsset(Base):
    """A job refers to an uploaded mesh."""

    __tablename__ = "job_assets"
    __table_args__ = (Index("job_assets_by_name", "name"),)

    job_id: Mapped[str] = mapped_column(ForeignKey("jobs.id", ondelete="CASCADE"), primary_key=True)
    name: Mapped[str] = mapped_column(String(100), primary_key=True)


class CampaignAsset(Base):
    """A campaign refers to an uploaded mesh."""

    __tablename__ = "campaign_assets"
    __table_args__ = (Index("campaign_assets_by_name", "name"),)

    campaign_id: Mapped[str] = mapped_column(ForeignKey("campaigns.id", ondelete="CASCADE"), primary_key=True)
    name: Mapped[str] = mapped_column(String(100), primary_key=True)


def not_paused() -> ColumnElement[bool]:
    """The condition that a queued job may run: it belongs to no campaign, or to one that is not paused."""
    paused = select(Campaign.id).where(Campaign.state == CampaignState.PAUSED)
    return or_(Job.campaign_id.is_(None), Job.campaign_id.not_in(paused))
