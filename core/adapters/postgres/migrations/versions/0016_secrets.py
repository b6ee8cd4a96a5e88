"""The secret before a webhook's newest one, and the index by which old deliveries are found."""

import sqlalchemy as sa
from alembic import op
from sqlalchemy.dialects.postgresql import TIMESTAMP

revision = "0016"
down_revision = "0015"


def upgrade() -> None:
    op.add_column("webhooks", sa.Column("old_secret", sa.Text()))
    op.add_column("webhooks", sa.Column("old_secret_until", TIMESTAMP(timezone=True)))
    op.create_index(
        "deliveries_ended", "deliveries", ["ended_at"], postgresql_where=sa.text("ended_at IS NOT NULL")
    )


def downgrade() -> None:
    op.drop_index("deliveries_ended", "deliveries")
    op.drop_column("webhooks", "old_secret_until")
    op.drop_column("webhooks", "old_secret")
