"""Uploaded meshes that were deleted, and which jobs and campaigns refer to which."""

from collections.abc import Iterator
from typing import Any

import sqlalchemy as sa
from alembic import op

revision = "0014"
down_revision = "0013"
branch_labels = None
depends_on = None

AT_ONCE = 500
"""Rows that are read at a time."""


def upgrade() -> None:
    op.create_table(
        "assets",
        sa.Column("name", sa.String(100), primary_key=True),
        sa.Column("deleted_at", sa.DateTime()),
    )
    op.create_index("assets_by_deletion", "assets", ["deleted_at"])
    for what in ("job", "campaign"):
        op.create_table(
            f"{what}_assets",
            sa.Column(f"{what}_id", sa.String(32), sa.ForeignKey(f"{what}s.id", ondelete="CASCADE"), primary_key=True),
            sa.Column("name", sa.String(100), primary_key=True),
        )
        op.create_index(f"{what}_assets_by_name", f"{what}_assets", ["name"])
        _fill(what)


def _fill(what: str) -> None:
    """Adds the uploads to which the jobs, or the campaigns, of the record refer."""
    connection = op.get_bind()
    users = sa.table(f"{what}s", sa.column("id"), sa.column("spec", sa.JSON()))
    uses = sa.table(f"{what}_assets", sa.column(f"{what}_id"), sa.column("name"))
    naming = sa.cast(users.c.spec, sa.Text()).like("%sha256:%")
    ids = connection.scalars(sa.select(users.c.id).where(naming)).all()
    for start in range(0, len(ids), AT_ONCE):
        some = connection.execute(sa.select(users).where(users.c.id.in_(ids[start : start + AT_ONCE])))
        rows = [{f"{what}_id": row.id, "name": name} for row in some for name in set(_named(row.spec))]
        if rows:
            connection.execute(uses.insert(), rows)


def _named(spec: Any, field: str = "") -> Iterator[str]:
    """The uploads that the fields `mesh` and `meshes` of a spec name, wherever they are."""
    if isinstance(spec, dict):
        for key, value in spec.items():
            yield from _named(value, key)
    elif isinstance(spec, list):
        for value in spec:
            yield from _named(value, field)
    elif field in ("mesh", "meshes") and isinstance(spec, str) and spec.startswith("sha256:") and len(spec) <= 100:
        yield spec


def downgrade() -> None:
    for table in ("campaign_assets", "job_assets", "assets"):
        op.drop_table(table)
