"""The highest priority of jobs that users and projects may submit."""

import sqlalchemy as sa
from alembic import op

revision = "0022"
down_revision = "0021"


def upgrade() -> None:
    op.add_column("quotas", sa.Column("highest_priority", sa.Text(), nullable=False, server_default="high"))


def downgrade() -> None:
    op.drop_column("quotas", "highest_priority")
