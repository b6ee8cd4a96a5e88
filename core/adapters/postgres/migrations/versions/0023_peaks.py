"""What trainings take of a GPU's memory, and which jobs share a GPU."""

import sqlalchemy as sa
from alembic import op

revision = "0023"
down_revision = "0022"


def upgrade() -> None:
    # Jobs before attempts, as whoever saves one locks them; otherwise each could wait for the other.
    op.add_column("jobs", sa.Column("gpu_bytes", sa.BigInteger))
    op.add_column("jobs", sa.Column("alike", sa.Text))
    op.add_column("attempts", sa.Column("peak_bytes", sa.BigInteger))
    op.add_column("attempts", sa.Column("gpu_part", sa.Double))
    op.create_table(
        "peaks",
        sa.Column("alike", sa.Text, primary_key=True),
        sa.Column("bytes", sa.BigInteger, nullable=False),
        sa.Column("measured_at", sa.TIMESTAMP(timezone=True), nullable=False),
    )


def downgrade() -> None:
    op.drop_table("peaks")
    op.drop_column("jobs", "alike")
    op.drop_column("jobs", "gpu_bytes")
    op.drop_column("attempts", "gpu_part")
    op.drop_column("attempts", "peak_bytes")
