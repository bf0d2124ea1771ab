"""Counts of what the service has done, and of a job the steps, queries and the beginning of its phase."""

import sqlalchemy as sa
from alembic import op

revision = "0008"
down_revision = "0007"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "totals",
        sa.Column("name", sa.String(32), primary_key=True),
        sa.Column("label", sa.String(100), primary_key=True),
        sa.Column("value", sa.Float(53), nullable=False),
    )
    op.add_column("jobs", sa.Column("phase_at", sa.DateTime()))
    op.add_column("jobs", sa.Column("steps_done", sa.Integer(), nullable=False, server_default="0"))
    op.add_column("jobs", sa.Column("queries_done", sa.BigInteger(), nullable=False, server_default="0"))
    op.execute(
        "INSERT INTO totals (name, label, value) SELECT 'ended', kind || ' ' || state, count(*) FROM jobs"
        " WHERE state IN ('succeeded', 'failed', 'rejected', 'cancelled') GROUP BY kind, state"
    )
    op.execute(
        "INSERT INTO totals (name, label, value) SELECT 'failures', failure_kind, count(*) FROM jobs"
        " WHERE failure_kind IS NOT NULL GROUP BY failure_kind"
    )
    op.execute("INSERT INTO totals (name, label, value) SELECT 'submitted', kind, count(*) FROM jobs GROUP BY kind")


def downgrade() -> None:
    for column in ("queries_done", "steps_done", "phase_at"):
        op.drop_column("jobs", column)
    op.drop_table("totals")
