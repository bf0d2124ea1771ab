"""What jobs and campaigns ask of the queue: their priority, what a worker must have, and why a job waits."""

import sqlalchemy as sa
from alembic import op

revision = "0013"
down_revision = "0011"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("jobs", sa.Column("priority", sa.String(16), nullable=False, server_default="normal"))
    op.add_column("jobs", sa.Column("needs", sa.Text()))
    op.add_column("jobs", sa.Column("waiting", sa.Text()))
    op.create_index("jobs_by_start", "jobs", ["owner", "priority", "running_at"])
    op.add_column("campaigns", sa.Column("demand", sa.JSON()))


def downgrade() -> None:
    op.drop_column("campaigns", "demand")
    op.drop_index("jobs_by_start", "jobs")
    for column in ("waiting", "needs", "priority"):
        op.drop_column("jobs", column)
