"""All tables. 0001 to 0019 were an earlier history: a database of theirs must not be taken for one of this."""

import sqlalchemy as sa
from alembic import op

revision = "0020"
down_revision = None
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "access_keys",
        sa.Column("prefix", sa.String(16), primary_key=True),
        sa.Column("digest", sa.String(64), nullable=False, unique=True),
        sa.Column("name", sa.String(100), nullable=False),
        sa.Column("owner", sa.String(100), nullable=False),
        sa.Column("scopes", sa.JSON(), nullable=False),
        sa.Column("created_at", sa.DateTime(), nullable=False),
        sa.Column("last_used_at", sa.DateTime()),
        sa.Column("revoked_at", sa.DateTime()),
        sa.Column("expires_at", sa.DateTime()),
    )
    op.create_table(
        "assets",
        sa.Column("name", sa.String(100), primary_key=True),
        sa.Column("title", sa.String(100)),
        sa.Column("deleted_at", sa.DateTime()),
    )
    op.create_index("assets_by_deletion", "assets", ["deleted_at"])
    op.create_table(
        "campaigns",
        sa.Column("id", sa.String(32), primary_key=True),
        sa.Column("name", sa.String(100), nullable=False),
        sa.Column("owner", sa.String(100), nullable=False, server_default=""),
        sa.Column("state", sa.String(16), nullable=False),
        sa.Column("spec", sa.JSON(), nullable=False),
        sa.Column("created_at", sa.DateTime(), nullable=False),
        sa.Column("selected_at", sa.DateTime()),
        sa.Column("paused_at", sa.DateTime()),
        sa.Column("ended_at", sa.DateTime()),
        sa.Column("failure", sa.Text()),
        sa.Column("demand", sa.JSON()),
        sa.Column("view_count", sa.Integer(), nullable=False),
        sa.Column("views", sa.JSON()),
        sa.Column("key", sa.String(255), unique=True),
        sa.Column("request_digest", sa.String(64), nullable=False),
    )
    op.create_index("campaigns_by_age", "campaigns", ["created_at", "id"])
    op.create_index("campaigns_by_owner", "campaigns", ["owner", "created_at", "id"])
    op.create_table(
        "jobs",
        sa.Column("id", sa.String(32), primary_key=True),
        sa.Column("state", sa.String(16), nullable=False),
        sa.Column("spec", sa.JSON(), nullable=False),
        sa.Column("seed", sa.BigInteger(), nullable=False),
        sa.Column("created_at", sa.DateTime(), nullable=False),
        sa.Column("kind", sa.String(16), nullable=False, server_default="attack"),
        sa.Column("digest", sa.String(64)),
        sa.Column("campaign_id", sa.String(32)),
        sa.Column("owner", sa.String(100), nullable=False, server_default=""),
        sa.Column("priority", sa.String(16), nullable=False, server_default="normal"),
        sa.Column("needs", sa.Text(), nullable=False),
        sa.Column("waiting", sa.Text()),
        sa.Column("name", sa.String(300)),
        sa.Column("scene", sa.String(300)),
        sa.Column("attack", sa.String(300)),
        sa.Column("renderer", sa.String(300)),
        sa.Column("method", sa.String(300)),
        sa.Column("target", sa.String(300)),
        sa.Column("asked", sa.String(300)),
        sa.Column("title", sa.String(100)),
        sa.Column("note", sa.Text()),
        sa.Column("tags", sa.JSON()),
        sa.Column("retry_of", sa.String(32)),
        sa.Column("verdict", sa.String(16)),
        sa.Column("verified", sa.Boolean()),
        sa.Column("p", sa.Float(53)),
        sa.Column("queries", sa.BigInteger()),
        sa.Column("seconds", sa.Float(53)),
        sa.Column("ended_at", sa.DateTime()),
        sa.Column("queued_at", sa.DateTime()),
        sa.Column("running_at", sa.DateTime()),
        sa.Column("cancelling_at", sa.DateTime()),
        sa.Column("succeeded_at", sa.DateTime()),
        sa.Column("failed_at", sa.DateTime()),
        sa.Column("rejected_at", sa.DateTime()),
        sa.Column("cancelled_at", sa.DateTime()),
        sa.Column("attempt", sa.Integer(), nullable=False),
        sa.Column("lost", sa.Integer(), nullable=False),
        sa.Column("furthest", sa.BigInteger(), nullable=False, server_default=sa.text("0")),
        sa.Column("lease_owner", sa.String(100)),
        sa.Column("lease_until", sa.DateTime()),
        sa.Column("checked", sa.Boolean(), nullable=False, server_default=sa.true()),
        sa.Column("errors", sa.JSON()),
        sa.Column("warnings", sa.JSON(), nullable=False),
        sa.Column("phase", sa.String(32)),
        sa.Column("step", sa.Integer()),
        sa.Column("steps", sa.Integer()),
        sa.Column("phase_at", sa.DateTime()),
        sa.Column("steps_done", sa.Integer(), nullable=False, server_default="0"),
        sa.Column("queries_done", sa.BigInteger(), nullable=False, server_default="0"),
        sa.Column("outcome", sa.JSON()),
        sa.Column("result", sa.JSON()),
        sa.Column("failure_kind", sa.String(64)),
        sa.Column("failure_detail", sa.Text()),
        sa.Column("events", sa.Integer(), nullable=False),
    )
    op.create_index("jobs_by_age", "jobs", ["created_at", "id"])
    op.create_index("jobs_by_campaign", "jobs", ["campaign_id", "created_at", "id"])
    op.create_index("jobs_by_digest", "jobs", ["digest"])
    op.create_index(
        "jobs_by_list",
        "jobs",
        [
            "kind",
            "created_at",
            "id",
            "state",
            "owner",
            "campaign_id",
            "title",
            "scene",
            "renderer",
            "method",
            "target",
            "verdict",
            "verified",
            "p",
            "queries",
            "seconds",
            "ended_at",
            "priority",
        ],
    )
    op.create_index("jobs_by_owner", "jobs", ["owner", "created_at", "id"])
    op.create_index("jobs_by_retry", "jobs", ["retry_of"])
    op.create_index("jobs_by_start", "jobs", ["owner", "priority", "running_at"])
    op.create_index("jobs_by_state", "jobs", ["state", "created_at", "id"])
    op.create_index("jobs_by_turn", "jobs", ["state", "campaign_id", "kind"])
    op.create_table(
        "owned_assets",
        sa.Column("owner", sa.String(100), primary_key=True),
        sa.Column("name", sa.String(100), primary_key=True),
        sa.Column("size", sa.BigInteger(), nullable=False),
        sa.Column("created_at", sa.DateTime(), nullable=False),
    )
    op.create_table(
        "totals",
        sa.Column("name", sa.String(32), primary_key=True),
        sa.Column("label", sa.String(100), primary_key=True),
        sa.Column("value", sa.Float(53), nullable=False),
    )
    op.create_table(
        "artifacts",
        sa.Column("job_id", sa.String(32), sa.ForeignKey("jobs.id", ondelete="CASCADE"), primary_key=True),
        sa.Column("name", sa.String(100), primary_key=True),
        sa.Column("sha256", sa.String(64), nullable=False),
        sa.Column("media_type", sa.String(100), nullable=False),
        sa.Column("size", sa.BigInteger(), nullable=False),
    )
    op.create_index("artifacts_by_hash", "artifacts", ["sha256"])
    op.create_table(
        "campaign_assets",
        sa.Column("campaign_id", sa.String(32), sa.ForeignKey("campaigns.id", ondelete="CASCADE"), primary_key=True),
        sa.Column("name", sa.String(100), primary_key=True),
    )
    op.create_index("campaign_assets_by_name", "campaign_assets", ["name"])
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
    op.create_index("campaign_jobs_by_end", "campaign_jobs", ["ended"])
    op.create_index("campaign_jobs_by_job", "campaign_jobs", ["job_id"])
    op.create_table(
        "dashboard_sessions",
        sa.Column("digest", sa.String(64), primary_key=True),
        sa.Column("key", sa.String(16), sa.ForeignKey("access_keys.prefix", ondelete="CASCADE"), nullable=False),
        sa.Column("created_at", sa.DateTime(), nullable=False),
        sa.Column("expires_at", sa.DateTime(), nullable=False),
    )
    op.create_table(
        "events",
        sa.Column("job_id", sa.String(32), sa.ForeignKey("jobs.id", ondelete="CASCADE"), primary_key=True),
        sa.Column("number", sa.Integer(), primary_key=True),
        sa.Column("kind", sa.String(16), nullable=False),
        sa.Column("data", sa.JSON(), nullable=False),
        sa.Column("created_at", sa.DateTime(), nullable=False),
    )
    op.create_table(
        "idempotency_keys",
        sa.Column("key", sa.String(255), primary_key=True),
        sa.Column("digest", sa.String(64), nullable=False),
        sa.Column("job_id", sa.String(32), sa.ForeignKey("jobs.id", ondelete="CASCADE"), nullable=False),
        sa.Column("answer", sa.JSON(), nullable=False),
        sa.Column("created_at", sa.DateTime(), nullable=False),
    )
    op.create_table(
        "job_assets",
        sa.Column("job_id", sa.String(32), sa.ForeignKey("jobs.id", ondelete="CASCADE"), primary_key=True),
        sa.Column("name", sa.String(100), primary_key=True),
    )
    op.create_index("job_assets_by_name", "job_assets", ["name"])
    op.create_table(
        "job_tags",
        sa.Column("job_id", sa.String(32), sa.ForeignKey("jobs.id", ondelete="CASCADE"), primary_key=True),
        sa.Column("tag", sa.String(50), primary_key=True),
    )
    op.create_index("job_tags_by_tag", "job_tags", ["tag", "job_id"])
