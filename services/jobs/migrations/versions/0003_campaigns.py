"""Campaigns and their planned jobs; kind, digest and campaign of a job."""

import sqlalchemy as sa
from alembic import op

revision = "0003"
down_revision = "0002"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "campaigns",
        sa.Column("id", sa.String(32), primary_key=True),
        sa.Column("name", sa.String(100), nullable=False),
        sa.Column("state", sa.String(16), nullable=False),
        sa.Column("spec", sa.JSON(), nullable=False),
        sa.Column("created_at", sa.DateTime(), nullable=False),
        sa.Column("selected_at", sa.DateTime()),
        sa.Column("paused_at", sa.DateTime()),
        sa.Column("ended_at", sa.DateTime()),
        sa.Column("failure", sa.Text()),
        sa.Column("view_count", sa.Integer(), nullable=False),
        sa.Column("views", sa.JSON()),
        sa.Column("key", sa.String(255), unique=True),
        sa.Column("request_digest", sa.String(64), nullable=False),
    )
    op.create_index("campaigns_by_age", "campaigns", ["created_at", "id"])
    op.create_table(
        "campaign_jobs",
        sa.Column("campaign_id", sa.String(32), sa.ForeignKey("campaigns.id", ondelete="CASCADE"), primary_key=True),
        sa.Column("number", sa.Integer(), primary_key=True),
        sa.Column("target", sa.String(100), nullable=False),
        sa.Column("attack", sa.String(200), nullable=False),
        sa.Column("view", sa.Integer(), nullable=False),
        sa.Column("right", sa.Boolean(), nullable=False),
        sa.Column("identity", sa.String(64)),
        sa.Column("digest", sa.String(64), nullable=False),
        sa.Column("spec", sa.JSON(), nullable=False),
        sa.Column("job_id", sa.String(32), sa.ForeignKey("jobs.id", ondelete="SET NULL")),
        sa.Column("reused", sa.Boolean(), nullable=False),
        sa.Column("ended", sa.Boolean(), nullable=False),
        sa.Column("case", sa.JSON()),
        sa.Column("curves", sa.JSON()),
    )
    op.create_index("campaign_jobs_by_job", "campaign_jobs", ["job_id"])
    op.create_index("campaign_jobs_by_end", "campaign_jobs", ["ended"])
    op.add_column("jobs", sa.Column("kind", sa.String(16), nullable=False, server_default="attack"))
    op.add_column("jobs", sa.Column("digest", sa.String(64)))
    op.add_column("jobs", sa.Column("campaign_id", sa.String(32)))
    op.create_index("jobs_by_digest", "jobs", ["digest"])
    op.create_index("jobs_by_campaign", "jobs", ["campaign_id"])


def downgrade() -> None:
    op.execute("DELETE FROM jobs WHERE kind = 'selection'")
    op.drop_index("jobs_by_campaign", "jobs")
    op.drop_index("jobs_by_digest", "jobs")
    for column in ("campaign_id", "digest", "kind"):
        op.drop_column("jobs", column)
    op.drop_table("campaign_jobs")
    op.drop_table("campaigns")
