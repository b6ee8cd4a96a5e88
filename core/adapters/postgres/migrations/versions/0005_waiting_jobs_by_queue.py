"""Jobs say which queue they wait for, and entries when the database got them."""

import sqlalchemy as sa
from alembic import op
from sqlalchemy.dialects.postgresql import TIMESTAMP

revision = "0005"
down_revision = "0004"


def upgrade() -> None:
    # Jobs of before have none until they change: the reconciler hands them over as one more queue.
    op.add_column("jobs", sa.Column("queue", sa.Text(), nullable=True))
    queued = sa.text("status = 'queued'")
    op.create_index("jobs_queued", "jobs", ["queue", "id"], postgresql_where=queued)
    going = sa.text("outcome IS NULL")
    op.create_index("trials_going", "trials", ["sweep_id"], postgresql_where=going)
    stored_at = sa.Column(
        "stored_at", TIMESTAMP(timezone=True), nullable=False, server_default=sa.func.clock_timestamp()
    )
    op.add_column("entries", stored_at)


def downgrade() -> None:
    op.drop_column("entries", "stored_at")
    op.drop_index("trials_going", "trials")
    op.drop_index("jobs_queued", "jobs")
    op.drop_column("jobs", "queue")
