"""What lists show of a request, in columns, and indexes for the queries of lists, queue and campaigns."""

import sqlalchemy as sa
from alembic import op

from services.jobs.listed import listed

revision = "0005"
down_revision = "0004"
branch_labels = None
depends_on = None

COLUMNS = ("name", "scene", "attack", "renderer", "method", "target", "question")
INDEXES = {
    "jobs_by_state": (["state", "created_at"], ["state", "created_at", "id"]),
    "jobs_by_campaign": (["campaign_id"], ["campaign_id", "created_at", "id"]),
}
"""Index: its columns before and after."""


def upgrade() -> None:
    for column in COLUMNS:
        op.add_column("jobs", sa.Column(column, sa.String(300)))
    jobs = sa.table("jobs", sa.column("id"), sa.column("spec", sa.JSON()), sa.column("kind"), *map(sa.column, COLUMNS))
    connection = op.get_bind()
    attacks = sa.select(jobs.c.id).where(jobs.c.kind == "attack")
    for job_id in connection.scalars(attacks).all():
        spec = connection.scalars(sa.select(jobs.c.spec).where(jobs.c.id == job_id)).one()
        connection.execute(jobs.update().where(jobs.c.id == job_id).values(listed(spec)))
    for index, (_, columns) in INDEXES.items():
        op.drop_index(index, "jobs")
        op.create_index(index, "jobs", columns)
    op.create_index("jobs_by_turn", "jobs", ["state", "campaign_id", "kind"])


def downgrade() -> None:
    op.drop_index("jobs_by_turn", "jobs")
    for index, (columns, _) in INDEXES.items():
        op.drop_index(index, "jobs")
        op.create_index(index, "jobs", columns)
    for column in reversed(COLUMNS):
        op.drop_column("jobs", column)
