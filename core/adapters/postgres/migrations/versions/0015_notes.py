"""What people note about a job, beside its specification, for the search."""

import sqlalchemy as sa
from alembic import op

revision = "0015"
down_revision = "0014"


def upgrade() -> None:
    op.add_column("jobs", sa.Column("note", sa.Text()))


def downgrade() -> None:
    op.drop_column("jobs", "note")
