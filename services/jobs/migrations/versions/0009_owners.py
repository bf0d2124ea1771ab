"""Owners of jobs, campaigns and uploads. What there is belongs to the owner "", that of a service without keys."""

import sqlalchemy as sa
from alembic import op

revision = "0009"
down_revision = "0008"
branch_labels = None
depends_on = None


def upgrade() -> None:
    for table in ("jobs", "campaigns"):
        op.add_column(table, sa.Column("owner", sa.String(100), nullable=False, server_default=""))
        op.create_index(f"{table}_by_owner", table, ["owner", "created_at", "id"])
    op.create_table(
        "owned_assets",
        sa.Column("owner", sa.String(100), primary_key=True),
        sa.Column("name", sa.String(100), primary_key=True),
        sa.Column("size", sa.BigInteger(), nullable=False),
        sa.Column("created_at", sa.DateTime(), nullable=False),
    )


def downgrade() -> None:
    op.drop_table("owned_assets")
    for table in ("campaigns", "jobs"):
        op.drop_index(f"{table}_by_owner", table)
        op.drop_column(table, "owner")
