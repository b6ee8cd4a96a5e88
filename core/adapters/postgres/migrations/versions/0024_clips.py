"""Files of clips, and which of them a job names."""

import sqlalchemy as sa
from alembic import op
from sqlalchemy.dialects import postgresql

revision = "0024"
down_revision = "0023"


def upgrade() -> None:
    op.create_table(
        "clip_files",
        sa.Column("id", sa.Text(), primary_key=True),
        sa.Column("status", sa.Text(), nullable=False),
        sa.Column("media_type", sa.Text(), nullable=False),
        sa.Column("size", sa.BigInteger(), nullable=False),
        sa.Column("created_at", sa.TIMESTAMP(timezone=True), nullable=False),
        sa.Column("description", sa.Text()),
        sa.Column("message", sa.Text()),
        sa.Column("refused_at", sa.TIMESTAMP(timezone=True)),
        sa.Column("name", sa.Text()),
        sa.Column("sha256", sa.Text(), nullable=False),
        sa.Column("body", sa.Text(), nullable=False),
        sa.Column("rate", sa.Double[float]()),
    )
    op.create_index("clip_files_by_status", "clip_files", ["status"])
    named = sa.text("name IS NOT NULL")
    op.create_index("clip_files_by_name", "clip_files", ["name"], postgresql_where=named)
    op.create_table(
        "clip_file_projects",
        sa.Column(
            "clip_file_id", sa.Text(), sa.ForeignKey("clip_files.id", ondelete="CASCADE"), primary_key=True
        ),
        sa.Column("project", sa.Text(), primary_key=True),
        sa.Column("owner", sa.Text()),
    )
    op.add_column(
        "jobs", sa.Column("clip_files", postgresql.ARRAY(sa.Text()), nullable=False, server_default="{}")
    )


def downgrade() -> None:
    op.drop_column("jobs", "clip_files")
    op.drop_table("clip_file_projects")
    op.drop_table("clip_files")
