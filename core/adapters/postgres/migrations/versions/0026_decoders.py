"""Note the job whose decoder acts in a job's task, so that it is not deleted while that job waits or runs."""

import sqlalchemy as sa
from alembic import op

revision = "0026"
down_revision = "0025"


def upgrade() -> None:
    op.add_column("jobs", sa.Column("decoder", sa.Text()))
    unfinished = sa.text("status IN ('queued', 'starting', 'running', 'cancelling')")
    op.create_index("jobs_by_decoder", "jobs", ["decoder"], postgresql_where=unfinished)


def downgrade() -> None:
    op.drop_index("jobs_by_decoder", "jobs")
    op.drop_column("jobs", "decoder")
