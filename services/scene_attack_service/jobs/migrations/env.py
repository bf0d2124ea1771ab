"""Runs the migrations on the connection that `scene_attack_service.jobs.database.migrate` hands over."""

from alembic import context

from scene_attack_service.jobs.models import Base

context.configure(
    connection=context.config.attributes["connection"],
    target_metadata=Base.metadata,
    render_as_batch=True,  # SQLite alters a table by copying it
)
with context.begin_transaction():
    context.run_migrations()
