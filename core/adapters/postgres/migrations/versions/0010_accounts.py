"""Users, projects, tokens and the audit log; jobs, sweeps and models have an owner and a project."""

from datetime import datetime

import sqlalchemy as sa
from alembic import op
from sqlalchemy.dialects.postgresql import TIMESTAMP

revision = "0010"
down_revision = "0009"

# Even the owner of the table is stopped, who would have to drop the trigger first.
_APPEND_ONLY = """
CREATE FUNCTION audit_is_append_only() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN RAISE EXCEPTION 'the audit log is append-only'; END $$;
CREATE TRIGGER audit_is_append_only BEFORE UPDATE OR DELETE OR TRUNCATE ON audit
  FOR EACH STATEMENT EXECUTE FUNCTION audit_is_append_only();
"""


def _moment(name: str, *, nullable: bool = True) -> sa.Column[datetime]:
    return sa.Column(name, TIMESTAMP(timezone=True), nullable=nullable)


def upgrade() -> None:
    for table in ("jobs", "sweeps"):
        op.add_column(table, sa.Column("owner", sa.Text(), nullable=True))
        op.add_column(table, sa.Column("project", sa.Text(), server_default="default", nullable=False))
    op.create_index("jobs_by_project", "jobs", ["project", "id"])
    op.create_index("jobs_by_owner", "jobs", ["owner", "id"], postgresql_where=sa.text("owner IS NOT NULL"))
    op.create_table(
        "users",
        sa.Column("name", sa.Text(), primary_key=True),
        sa.Column("role", sa.Text(), nullable=False),
        sa.Column("active", sa.Boolean(), server_default="true", nullable=False),
        sa.Column("subject", sa.Text(), unique=True),
        _moment("created_at", nullable=False),
    )
    op.create_table(
        "projects", sa.Column("name", sa.Text(), primary_key=True), _moment("created_at", nullable=False)
    )
    op.execute("INSERT INTO projects (name, created_at) VALUES ('default', clock_timestamp())")
    op.create_table(
        "members",
        sa.Column("project", sa.Text(), sa.ForeignKey("projects.name"), primary_key=True),
        sa.Column("user_name", sa.Text(), sa.ForeignKey("users.name"), primary_key=True),
    )
    op.create_index("members_by_user", "members", ["user_name"])
    op.create_table(
        "model_projects",
        sa.Column("model_id", sa.Text(), sa.ForeignKey("models.id", ondelete="CASCADE"), primary_key=True),
        sa.Column("project", sa.Text(), primary_key=True),
        sa.Column("owner", sa.Text(), nullable=True),
    )
    op.execute("INSERT INTO model_projects (model_id, project) SELECT id, 'default' FROM models")
    op.create_table(
        "tokens",
        sa.Column("id", sa.Text(), primary_key=True),
        sa.Column("user_name", sa.Text(), sa.ForeignKey("users.name"), nullable=False),
        sa.Column("name", sa.Text(), nullable=False),
        sa.Column("scope", sa.Text(), nullable=False),
        sa.Column("sha256", sa.Text(), nullable=False),
        _moment("created_at", nullable=False),
        _moment("expires_at"),
        _moment("last_used_at"),
        _moment("revoked_at"),
    )
    op.create_index("tokens_by_user", "tokens", ["user_name"])
    op.create_table(
        "audit",
        sa.Column("id", sa.BigInteger(), sa.Identity(always=True), primary_key=True),
        _moment("at", nullable=False),
        sa.Column("user_name", sa.Text()),
        sa.Column("token", sa.Text()),
        sa.Column("action", sa.Text(), nullable=False),
        sa.Column("object", sa.Text()),
        sa.Column("details", sa.Text(), server_default="{}", nullable=False),
        sa.Column("address", sa.Text()),
        sa.Column("correlation_id", sa.Text()),
    )
    op.create_index("audit_by_user", "audit", ["user_name", "id"])
    op.create_index("audit_by_object", "audit", ["object", "id"])
    op.execute(_APPEND_ONLY)


def downgrade() -> None:
    for table in ("audit", "tokens", "model_projects", "members", "projects", "users"):
        op.drop_table(table)
    op.execute("DROP FUNCTION audit_is_append_only()")
    for name in ("jobs_by_owner", "jobs_by_project"):
        op.drop_index(name, "jobs")
    for table in ("sweeps", "jobs"):
        op.drop_column(table, "project")
        op.drop_column(table, "owner")
