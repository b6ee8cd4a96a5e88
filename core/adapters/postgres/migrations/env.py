"""What Alembic runs: the migrations, on the connection that `schema` hands it."""

from alembic import context

from core.adapters.postgres.tables import metadata

context.configure(connection=context.config.attributes["connection"], target_metadata=metadata)
context.run_migrations()
