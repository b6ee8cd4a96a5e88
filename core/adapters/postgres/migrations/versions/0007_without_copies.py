"""Jobs are not copied into the bucket."""

import sqlalchemy as sa
from alembic import op

revision = "0007"
down_revision = "0006"


def upgrade() -> None:
    op.drop_index("jobs_to_copy", "jobs")
    op.drop_column("jobs", "copied_version")


def downgrade() -> None:
    op.add_column("jobs", sa.Column("copied_version", sa.Integer(), server_default="0", nullable=False))
    is_to_copy = sa.text("copied_version <> version AND num_attempts > 0")
    op.create_index("jobs_to_copy", "jobs", ["id"], postgresql_where=is_to_copy)
