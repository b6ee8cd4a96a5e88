"""What users and projects have used of late, what they may have, and the index by which turns are found."""

import sqlalchemy as sa
from alembic import op
from sqlalchemy.dialects.postgresql import INTERVAL, TIMESTAMP

revision = "0014"
down_revision = "0013"


def upgrade() -> None:
    op.create_table(
        "shares",
        sa.Column("device", sa.Text(), primary_key=True),
        sa.Column("project", sa.Text(), primary_key=True),
        sa.Column("owner", sa.Text(), primary_key=True),
        sa.Column("amount", sa.Double[float](), nullable=False),
        sa.Column("attempts", sa.Double[float](), nullable=False),
        sa.Column("seconds", sa.Double[float](), nullable=False),
        sa.Column("at", TIMESTAMP(timezone=True), nullable=False),
    )
    op.create_table(
        "quotas",
        sa.Column("kind", sa.Text(), primary_key=True),
        sa.Column("name", sa.Text(), primary_key=True),
        sa.Column("weight", sa.Double[float](), nullable=False),
        sa.Column("running", sa.Integer()),
        sa.Column("queued", sa.Integer()),
        sa.Column("gpu_hours", sa.Double[float]()),
        sa.Column("bytes", sa.BigInteger()),
    )
    op.add_column("pulse", sa.Column("half_life", INTERVAL(), nullable=False, server_default="3 days"))
    op.create_index(
        "jobs_turns",
        "jobs",
        ["queue", "project", sa.text("coalesce(owner, '')"), "id"],
        postgresql_where=sa.text("status = 'queued'"),
    )


def downgrade() -> None:
    op.drop_index("jobs_turns", "jobs")
    op.drop_column("pulse", "half_life")
    op.drop_table("quotas")
    op.drop_table("shares")
