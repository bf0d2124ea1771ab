"""An index by which the jobs that name a file are found."""

from alembic import op

revision = "0010"
down_revision = "0009"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_index("artifacts_by_hash", "artifacts", ["sha256"])


def downgrade() -> None:
    op.drop_index("artifacts_by_hash", "artifacts")
