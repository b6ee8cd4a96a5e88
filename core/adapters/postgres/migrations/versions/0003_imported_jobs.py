"""Jobs that were imported say where they were run."""

import sqlalchemy as sa
from alembic import op

revision = "0003"
down_revision = "0002"


def upgrade() -> None:
    op.add_column("jobs", sa.Column("imported_from", sa.Text(), nullable=True))


def downgrade() -> None:
    op.drop_column("jobs", "imported_from")
