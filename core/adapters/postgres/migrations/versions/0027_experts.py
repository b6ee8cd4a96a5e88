"""Note the jobs from whose policies a job learns, so that they are not deleted while it waits or runs."""

import sqlalchemy as sa
from alembic import op
from sqlalchemy.dialects.postgresql import ARRAY

revision = "0027"
down_revision = "0026"


def upgrade() -> None:
    op.add_column("jobs", sa.Column("experts", ARRAY(sa.Text()), nullable=False, server_default="{}"))
    named = sa.text("experts <> '{}'")
    op.create_index("jobs_by_experts", "jobs", ["experts"], postgresql_using="gin", postgresql_where=named)


def downgrade() -> None:
    op.drop_index("jobs_by_experts", "jobs")
    op.drop_column("jobs", "experts")
