"""Whether a request was checked before its job was accepted, and the fields for which a job was rejected."""

import sqlalchemy as sa
from alembic import op

revision = "0004"
down_revision = "0003"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("jobs", sa.Column("checked", sa.Boolean(), nullable=False, server_default=sa.true()))
    op.add_column("jobs", sa.Column("errors", sa.JSON()))
    op.add_column("jobs", sa.Column("rejected_at", sa.DateTime()))


def downgrade() -> None:
    op.drop_column("jobs", "rejected_at")
    op.drop_column("jobs", "errors")
    op.drop_column("jobs", "checked")
