"""Columns of sweeps, trials and workers are named after what they hold."""

from alembic import op

revision = "0009"
down_revision = "0008"

_NAMES = (("sweeps", "found", "results"), ("trials", "said", "document"), ("workers", "said", "document"))


def upgrade() -> None:
    for table, old, new in _NAMES:
        op.alter_column(table, old, new_column_name=new)


def downgrade() -> None:
    for table, old, new in _NAMES:
        op.alter_column(table, new, new_column_name=old)
