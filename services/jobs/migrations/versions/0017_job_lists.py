"""What people say about jobs, what lists sort and filter by of an outcome, and the index that has all of it."""

from typing import Any

import sqlalchemy as sa
from alembic import op

from services.jobs.listed import listed_outcome

revision = "0017"
down_revision = "0016"
branch_labels = None
depends_on = None

COLUMNS: dict[str, Any] = {
    "title": sa.String(100),
    "note": sa.Text(),
    "tags": sa.JSON(),
    "retry_of": sa.String(32),
    "verdict": sa.String(16),
    "verified": sa.Boolean(),
    "p": sa.Float(53),
    "queries": sa.BigInteger(),
    "seconds": sa.Float(53),
    "ended_at": sa.DateTime(),
}
LISTED_BY = (
    *("kind", "created_at", "id", "state", "owner", "campaign_id", "title", "scene", "renderer", "method", "target"),
    *("verdict", "verified", "p", "queries", "seconds", "ended_at", "priority"),
)


def upgrade() -> None:
    for column, kind in COLUMNS.items():
        op.add_column("jobs", sa.Column(column, kind))
    op.execute("UPDATE jobs SET ended_at = coalesce(succeeded_at, failed_at, rejected_at, cancelled_at)")
    filled = ("verdict", "verified", "p", "queries", "seconds")
    known: tuple[Any, ...] = (sa.column("id"), sa.column("state"), sa.column("outcome", sa.JSON()))
    jobs = sa.table("jobs", *known, *map(sa.column, filled))
    connection = op.get_bind()
    ended = sa.select(jobs.c.id).where(jobs.c.state == "succeeded")
    for job_id in connection.scalars(ended).all():
        outcome = connection.scalars(sa.select(jobs.c.outcome).where(jobs.c.id == job_id)).one()
        if outcome:
            connection.execute(jobs.update().where(jobs.c.id == job_id).values(listed_outcome(outcome)))
    op.create_table(
        "job_tags",
        sa.Column("job_id", sa.String(32), sa.ForeignKey("jobs.id", ondelete="CASCADE"), primary_key=True),
        sa.Column("tag", sa.String(50), primary_key=True),
    )
    op.create_index("job_tags_by_tag", "job_tags", ["tag", "job_id"])
    op.create_index("jobs_by_list", "jobs", list(LISTED_BY))
    op.create_index("jobs_by_retry", "jobs", ["retry_of"])


def downgrade() -> None:
    op.drop_index("jobs_by_retry", "jobs")
    op.drop_index("jobs_by_list", "jobs")
    op.drop_table("job_tags")
    for column in reversed(COLUMNS):
        op.drop_column("jobs", column)
