"""Warnings of a job, which the answer to its submission carries."""

import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision = "0001"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("jobs", sa.Column("warnings", sa.JSON()))


def downgrade() -> None:
    op.drop_column("jobs", "warnings")
