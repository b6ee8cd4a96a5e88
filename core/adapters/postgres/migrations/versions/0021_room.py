"""When others were last told to make room for a waiting job."""

import sqlalchemy as sa
from alembic import op

revision = "0021"
down_revision = "0020"


def upgrade() -> None:
    op.add_column("jobs", sa.Column("room_asked_at", sa.TIMESTAMP(timezone=True)))


def downgrade() -> None:
    op.drop_column("jobs", "room_asked_at")
