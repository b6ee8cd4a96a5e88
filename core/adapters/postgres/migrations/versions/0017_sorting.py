"""Numbers of a job's progress as columns, by which lists are sorted; a sweep's jobs in their order."""

from alembic import op

revision = "0017"
down_revision = "0016"

_METRIC = "(progress::json -> 'metrics' ->> '{}/episode_reward')::double precision"
_COLUMNS = {
    "progress_step": "(progress::json ->> 'step')::double precision",
    "progress_speed": "(progress::json ->> 'steps_per_second')::double precision",
    "progress_return": f"coalesce({_METRIC.format('eval')}, {_METRIC.format('training')})",
}


def upgrade() -> None:
    # One statement writes the table anew once.
    op.execute(f"ALTER TABLE jobs {', '.join(_added(name, value) for name, value in _COLUMNS.items())}")
    op.create_index("trials_jobs", "trials", ["sweep_id", "job_id"])


def _added(name: str, value: str) -> str:
    """PostgreSQL's JSON refuses U+0000, and a damaged record is no JSON."""
    is_whole = r"progress IS JSON OBJECT AND strpos(progress, '\u0000') = 0"
    computed = f"CASE WHEN {is_whole} THEN {value} END"
    return f"ADD COLUMN {name} double precision GENERATED ALWAYS AS ({computed}) STORED"


def downgrade() -> None:
    op.drop_index("trials_jobs", "trials")
    for name in reversed(_COLUMNS):
        op.drop_column("jobs", name)
