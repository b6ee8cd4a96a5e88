"""Alembic runs this file: it runs the migrations on the connection that `schema` hands over."""

from alembic import context

from core.adapters.postgres.tables import metadata

context.configure(connection=context.config.attributes["connection"], target_metadata=metadata)
context.run_migrations()
