"""How many bytes the files of a job have, for sums by project and user."""

import sqlalchemy as sa
from alembic import op

revision = "0019"
down_revision = "0018"


def upgrade() -> None:
    op.add_column("jobs", sa.Column("bytes", sa.BigInteger(), nullable=False, server_default="0"))
    op.execute(
        """
        UPDATE jobs SET bytes = sums.bytes
        FROM (SELECT job_id, sum(size) AS bytes FROM artifacts GROUP BY job_id) AS sums
        WHERE jobs.id = sums.job_id
        """
    )
    op.create_index(
        "jobs_by_bytes", "jobs", ["project", "owner", "bytes"], postgresql_where=sa.text("bytes > 0")
    )


def downgrade() -> None:
    op.drop_index("jobs_by_bytes", "jobs")
    op.drop_column("jobs", "bytes")
