"""Models have names for people."""

import sqlalchemy as sa
from alembic import op

revision = "0004"
down_revision = "0003"


def upgrade() -> None:
    op.add_column("models", sa.Column("name", sa.Text(), nullable=True))
    op.create_index("models_by_name", "models", ["name"], postgresql_where=sa.text("name IS NOT NULL"))


def downgrade() -> None:
    op.drop_index("models_by_name", "models")
    op.drop_column("models", "name")
