"""A campaign whose request cannot be read is paused; it used to fail."""

from alembic import op

revision = "0021"
down_revision = "0020"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.execute("UPDATE campaigns SET state = 'paused', paused_at = ended_at, ended_at = NULL WHERE state = 'failed'")
