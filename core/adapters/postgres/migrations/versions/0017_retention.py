"""What projects keep of their ended jobs, and what that has removed of a job."""

import sqlalchemy as sa
from alembic import op
from sqlalchemy.dialects.postgresql import TIMESTAMP

revision = "0017"
down_revision = "0016"


def upgrade() -> None:
    op.create_table(
        "retention",
        sa.Column("project", sa.Text(), sa.ForeignKey("projects.name"), primary_key=True),
        sa.Column("rules", sa.Text(), nullable=False),
        sa.Column("set_at", TIMESTAMP(timezone=True), nullable=False),
        sa.Column("set_by", sa.Text()),
    )
    op.add_column("jobs", sa.Column("removed", sa.Text()))


def downgrade() -> None:
    op.drop_column("jobs", "removed")
    op.drop_table("retention")
