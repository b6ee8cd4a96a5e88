"""Numbers of a job's progress as columns, by which lists are sorted; a sweep's jobs in their order."""

from alembic import op

revision = "0018"
down_revision = "0017"

_PATHS = {
    "progress_step": ["$.step"],
    "progress_speed": ["$.steps_per_second"],
    "progress_return": ['$.metrics."eval/episode_reward"', '$.metrics."training/episode_reward"'],
}
# What PostgreSQL refuses in JSON that is valid: U+0000, half a character, a number out of its bounds.
_REFUSED = r"\\u(0000|d[89a-f])|[0-9.]e[+-]?[0-9]{4}|[0-9]{255}"


def upgrade() -> None:
    # In one statement, PostgreSQL rewrites the table once.
    op.execute(f"ALTER TABLE jobs {', '.join(_added(name, paths) for name, paths in _PATHS.items())}")
    op.create_index("trials_jobs", "trials", ["sweep_id", "job_id"])


def _added(name: str, paths: list[str]) -> str:
    """Null for a damaged record."""
    is_whole = f"progress IS JSON AND progress !~* '{_REFUSED}'"
    values = [f"JSON_VALUE(progress::jsonb, '{path}' RETURNING double precision)" for path in paths]
    value = f"COALESCE({', '.join(values)})" if len(values) > 1 else values[0]
    computed = f"CASE WHEN {is_whole} THEN {value} END"
    return f"ADD COLUMN {name} double precision GENERATED ALWAYS AS ({computed}) STORED"


def downgrade() -> None:
    op.drop_index("trials_jobs", "trials")
    for name in reversed(_PATHS):
        op.drop_column("jobs", name)
