"""Webhooks of projects, news about jobs, and deliveries."""

import sqlalchemy as sa
from alembic import op
from sqlalchemy.dialects.postgresql import TIMESTAMP

revision = "0013"
down_revision = "0012"


def _moment(name: str, *, nullable: bool = True) -> sa.Column[object]:
    return sa.Column(name, TIMESTAMP(timezone=True), nullable=nullable)


def upgrade() -> None:
    op.create_table(
        "webhooks",
        sa.Column("project", sa.Text(), sa.ForeignKey("projects.name"), primary_key=True),
        sa.Column("name", sa.Text(), primary_key=True),
        sa.Column("owner", sa.Text(), sa.ForeignKey("users.name")),
        sa.Column("url", sa.Text(), nullable=False),
        sa.Column("events", sa.ARRAY(sa.Text()), nullable=False),
        sa.Column("jobs", sa.Text(), nullable=False),
        sa.Column("secret", sa.Text()),
        _moment("created_at", nullable=False),
        sa.Column("stopped", sa.Text()),
    )
    op.create_table(
        "news",
        sa.Column("id", sa.Text(), primary_key=True),
        sa.Column("event", sa.Text(), nullable=False),
        sa.Column("project", sa.Text(), nullable=False),
        sa.Column("owner", sa.Text()),
        sa.Column("job", sa.Text()),
        sa.Column("notify", sa.ARRAY(sa.Text()), nullable=False),
        sa.Column("document", sa.Text(), nullable=False),
        _moment("created_at", nullable=False),
    )
    op.create_table(
        "deliveries",
        sa.Column("id", sa.BigInteger(), sa.Identity(always=True), primary_key=True),
        *(sa.Column(name, sa.Text(), nullable=False) for name in ("project", "webhook", "message", "event")),
        sa.Column("job", sa.Text()),
        sa.Column("document", sa.Text(), nullable=False),
        sa.Column("status", sa.Text(), nullable=False, server_default="waiting"),
        sa.Column("attempts", sa.Integer(), nullable=False, server_default="0"),
        _moment("created_at", nullable=False),
        _moment("next_attempt_at"),
        _moment("ended_at"),
        sa.Column("answer", sa.Integer()),
        sa.Column("error", sa.Text()),
        sa.ForeignKeyConstraint(
            ["project", "webhook"],
            ["webhooks.project", "webhooks.name"],
            name="deliveries_webhook",
            ondelete="CASCADE",
        ),
    )
    op.create_index("deliveries_by_webhook", "deliveries", ["project", "webhook", "id"])
    op.create_index(
        "deliveries_by_job", "deliveries", ["job", "id"], postgresql_where=sa.text("job IS NOT NULL")
    )
    op.create_index(
        "deliveries_due",
        "deliveries",
        ["project", "webhook", "next_attempt_at"],
        postgresql_where=sa.text("status = 'waiting'"),
    )


def downgrade() -> None:
    for table in ("deliveries", "news", "webhooks"):
        op.drop_table(table)
