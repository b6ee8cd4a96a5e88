"""The device and the engine of a job's newest attempt in its own row, by which lists are sorted."""

import sqlalchemy as sa
from alembic import op

revision = "0025"
down_revision = "0024"


def upgrade() -> None:
    for name in ("device", "engine"):
        op.add_column("jobs", sa.Column(name, sa.Text()))
    op.execute(
        """
        UPDATE jobs SET device = newest.device, engine = newest.engine
        FROM (
            SELECT job_id,
                (array_agg(device ORDER BY number DESC) FILTER (WHERE device <> ''))[1] AS device,
                (array_agg(engine ORDER BY number DESC) FILTER (WHERE engine <> ''))[1] AS engine
            FROM attempts GROUP BY job_id
        ) AS newest
        WHERE jobs.id = newest.job_id AND coalesce(newest.device, newest.engine) IS NOT NULL
        """
    )


def downgrade() -> None:
    for name in ("engine", "device"):
        op.drop_column("jobs", name)
