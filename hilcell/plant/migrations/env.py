"""Alembic's environment: `hilcell.plant.database` hands the open connection over."""

from alembic import context

from hilcell.plant.tables import TABLES

context.configure(
    connection=context.config.attributes["connection"],
    target_metadata=TABLES,
    render_as_batch=True,
)
with context.begin_transaction():
    context.run_migrations()
