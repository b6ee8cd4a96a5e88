"""A ledger of what attempts took, sums of what workers count, and the request behind a job."""

import sqlalchemy as sa
from alembic import op
from sqlalchemy.dialects import postgresql

revision = "0011"
down_revision = "0010"

_KEY = ("project", "owner", "host", "device", "status", "reason")


def upgrade() -> None:
    op.add_column("jobs", sa.Column("correlation_id", sa.Text()))
    op.create_table(
        "usage",
        sa.Column("hour", postgresql.TIMESTAMP(timezone=True), nullable=False),
        *(sa.Column(name, sa.Text(), nullable=False) for name in _KEY),
        sa.Column("jobs", sa.Integer(), nullable=False),
        sa.Column("attempts", sa.Integer(), nullable=False),
        sa.Column("seconds", sa.Double[float](), nullable=False),
        sa.Column("gpu_seconds", sa.Double[float](), nullable=False),
        sa.PrimaryKeyConstraint("hour", *_KEY),
    )
    op.create_table(
        "tallies",
        sa.Column("series", sa.Text(), nullable=False),
        sa.Column("labels", sa.ARRAY(sa.Text()), nullable=False),
        sa.Column("buckets", sa.ARRAY(sa.BigInteger()), nullable=False),
        sa.Column("total", sa.Double[float](), nullable=False),
        sa.PrimaryKeyConstraint("series", "labels"),
    )


def downgrade() -> None:
    op.drop_table("tallies")
    op.drop_table("usage")
    op.drop_column("jobs", "correlation_id")
