"""Sessions of those who are signed in on the page."""

from datetime import datetime

import sqlalchemy as sa
from alembic import op
from sqlalchemy.dialects.postgresql import TIMESTAMP

revision = "0012"
down_revision = "0011"


def _moment(name: str) -> sa.Column[datetime]:
    return sa.Column(name, TIMESTAMP(timezone=True), nullable=False)


def upgrade() -> None:
    op.create_table(
        "sessions",
        sa.Column("id", sa.Text(), primary_key=True),
        sa.Column("user_name", sa.Text(), sa.ForeignKey("users.name"), nullable=False),
        sa.Column("token", sa.Text(), sa.ForeignKey("tokens.id")),
        sa.Column("scope", sa.Text(), nullable=False),
        sa.Column("sha256", sa.Text(), nullable=False),
        _moment("created_at"),
        _moment("last_used_at"),
        _moment("expires_at"),
    )


def downgrade() -> None:
    op.drop_table("sessions")
