"""Which jobs make room for others of the same priority, and for which waiting job an attempt drains."""

import sqlalchemy as sa
from alembic import op

revision = "0020"
down_revision = "0019"


def upgrade() -> None:
    op.add_column("jobs", sa.Column("preemptible", sa.Boolean(), nullable=False, server_default="false"))
    op.add_column("jobs", sa.Column("yields_to", sa.Text()))
    op.create_index("jobs_yielding", "jobs", ["yields_to"], postgresql_where=sa.text("yields_to IS NOT NULL"))


def downgrade() -> None:
    op.drop_index("jobs_yielding", "jobs")
    op.drop_column("jobs", "yields_to")
    op.drop_column("jobs", "preemptible")
