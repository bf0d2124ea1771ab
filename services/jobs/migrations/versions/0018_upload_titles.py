"""The names that people see of uploads, so that lists of jobs show them."""

import sqlalchemy as sa
from alembic import op

revision = "0018"
down_revision = "0017"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("assets", sa.Column("title", sa.String(100)))


def downgrade() -> None:
    op.drop_column("assets", "title")
