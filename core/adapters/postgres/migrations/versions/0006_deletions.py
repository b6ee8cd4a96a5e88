"""Jobs that are deleted are remembered until their objects are gone."""

import sqlalchemy as sa
from alembic import op

revision = "0006"
down_revision = "0005"


def upgrade() -> None:
    op.create_table(
        "deletions",
        sa.Column("job_id", sa.String(collation="C"), primary_key=True),
        sa.Column("begun_at", sa.TIMESTAMP(timezone=True), nullable=False),
    )


def downgrade() -> None:
    op.drop_table("deletions")
