"""Finds the queued jobs whose id is not on the queue, without reading the others."""

from alembic import op

revision = "0016"
down_revision = "0015"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_index("jobs_by_sending", "jobs", ["state", "sent_at"])


def downgrade() -> None:
    op.drop_index("jobs_by_sending", "jobs")
