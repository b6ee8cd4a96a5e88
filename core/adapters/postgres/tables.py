"""The tables of the record. Migrations make them; `tests/contract/test_migrations.py` compares the two.

jobs        one row per job; `token` and `lease_until` belong to the attempt that holds it
attempts    one row per attempt at a job
artifacts   the files of a job that readers may fetch, each with its key and hash
chunks      finished parts of a job's feeds, which lie in the object store
entries     the newest part of each feed, until it is moved into a chunk
metrics     the newest metrics of each job in blocks, with numbers among those of its events; likewise
dispatches  messages for RQ that are not sent yet; written in the transaction that makes them necessary
deletions   jobs that were deleted, until the objects of each are gone
models, clip_files   users' own models, and files of clips, by a hash
workers     the last announcement of each worker
idempotency_keys   the submissions of the last day that came with a key
sweeps      one row per sweep; `key_hash` is that of the idempotency key that its submission came with
trials      one row per trial of a sweep: the primary key lets each number begin once
usage       the ledger: what attempts took, by hour, project, user and device (`core.jobs.usage`)
peaks       the most that trainings had of a GPU's memory, by what they have in common (`core.jobs.sharing`)
tallies     what workers count and time, summed over all of them (`core.jobs.tallies`)
shares      what users have used of late: sums of one moment, which are halved by the half-life in `pulse`
quotas      what users and projects may have (`core.jobs.quotas`)
pulse       one row: when the reconciler last reached this database
users, projects, members   who may use the service, and who sees what
model_projects, clip_file_projects   the projects in which each was sent, with who sent it there first
tokens      API tokens, by a public id and the hash of the whole
sessions    who is signed in on the page, as tokens
audit       what was done; a trigger forbids to change or remove a row
retention   what projects keep of their ended jobs (`core.jobs.retention`)
webhooks    whom a project's news is sent to, with the secret of each
news        messages about jobs, until there is a delivery of each for every webhook that wants it
deliveries  messages for one webhook each, and what came of them, for a week

Documents are JSON stored as text: PostgreSQL's JSON types refuse the character U+0000, which a log may hold.
Labels are JSONB, for their index.
"""

from typing import Any

from sqlalchemy import (
    BigInteger,
    Boolean,
    Column,
    Computed,
    Double,
    ForeignKey,
    ForeignKeyConstraint,
    Identity,
    Index,
    Integer,
    LargeBinary,
    MetaData,
    String,
    Table,
    Text,
    func,
    text,
)
from sqlalchemy.dialects.postgresql import ARRAY, INTERVAL, JSONB, TIMESTAMP

metadata = MetaData()
# The database's clock; unlike CURRENT_TIMESTAMP it advances within a transaction.
NOW = func.clock_timestamp()


def _moment(name: str, *, nullable: bool = True) -> Column[Any]:
    return Column(name, TIMESTAMP(timezone=True), nullable=nullable)


# What PostgreSQL refuses in JSON that is valid: U+0000, half a character, a number out of its bounds.
_REFUSED = r"\\u(0000|d[89a-f])|[0-9.]e[+-]?[0-9]{4}|[0-9]{255}"


def _of_progress(name: str, *paths: str) -> Column[Any]:
    """The first number of `progress` that there is: reading the JSON of 10,000 jobs takes 0.4 s."""
    # In PostgreSQL's own form, so that a comparison with the database's finds them equal.
    values = [f"JSON_VALUE(progress::jsonb, '{path}' RETURNING double precision)" for path in paths]
    value = f"COALESCE({', '.join(values)})" if len(values) > 1 else values[0]
    is_whole = f"progress IS JSON AND progress !~* '{_REFUSED}'::text"
    number = f"CASE WHEN {is_whole} THEN {value} ELSE NULL::double precision END"
    return Column(name, Double, Computed(number, persisted=True))


jobs = Table(
    "jobs",
    metadata,
    # "C" compares bytes: ids sort by time in a database of any language.
    Column("id", String(collation="C"), primary_key=True),
    Column("version", Integer, nullable=False),
    Column("kind", Text, nullable=False),
    Column("environment", Text, nullable=False),
    Column("name", Text),
    Column("labels", JSONB, nullable=False),
    Column("note", Text),
    Column("model", Text),
    # The ids of the clip files that its options name.
    Column("clip_files", ARRAY(Text), nullable=False, server_default="{}"),
    Column("source", Text),
    Column("source_step", BigInteger),
    # The job whose decoder acts in its task.
    Column("decoder", Text),
    # The jobs from whose policies it learns.
    Column("experts", ARRAY(Text), nullable=False, server_default="{}"),
    Column("spec", Text, nullable=False),
    Column("status", Text, nullable=False),
    Column("reason", Text),
    Column("message", Text),
    _moment("created_at", nullable=False),
    _moment("started_at"),
    _moment("finished_at"),
    _moment("not_before"),
    Column("progress", Text),
    _of_progress("progress_step", '$."step"'),
    _of_progress("progress_speed", '$."steps_per_second"'),
    _of_progress(
        "progress_return",
        *(f'$."metrics"."{phase}/episode_reward"' for phase in ("eval", "training")),
    ),
    Column("imported_from", Text),
    # What retention rules have removed of its files.
    Column("removed", Text),
    Column("correlation_id", Text),
    Column("token", Text, nullable=False, server_default=""),
    _moment("lease_until"),
    Column("num_attempts", Integer, nullable=False, server_default="0"),
    Column("num_events", BigInteger, nullable=False, server_default="0"),
    Column("num_logs", BigInteger, nullable=False, server_default="0"),
    Column("last_write", Text),
    # The name of RQ's queue for its next attempt; null where an older version wrote the row.
    Column("queue", Text),
    Column("preemptible", Boolean, nullable=False, server_default="false"),
    # The waiting job for which the attempt that holds it drains.
    Column("yields_to", Text),
    # When others were last told to drain for it.
    _moment("room_asked_at"),
    Column("owner", Text),
    Column("project", Text, nullable=False, server_default="default"),
    # Of a job that shares a GPU: the memory that it asked for, or else what it has in common with such jobs.
    Column("gpu_bytes", BigInteger),
    Column("alike", Text),
    # Of all its files, so that sums over many jobs read none of them.
    Column("bytes", BigInteger, nullable=False, server_default="0"),
    # Of its newest attempt that has one: lists are sorted by them.
    Column("device", Text),
    Column("engine", Text),
    # Free space in each page: a renewed lease then touches no index.
    postgresql_with={"fillfactor": "80"},
)
Index("jobs_by_status", jobs.c.status, jobs.c.id)
Index("jobs_by_kind", jobs.c.kind, jobs.c.id)
Index("jobs_by_environment", jobs.c.environment, jobs.c.id)
# For several conditions at once; PostgreSQL 18 skips a column without a condition.
Index("jobs_by_state", jobs.c.status, jobs.c.kind, jobs.c.environment, jobs.c.id)
Index("jobs_by_name", jobs.c.name, jobs.c.id, postgresql_where=jobs.c.name.isnot(None))
Index("jobs_by_project", jobs.c.project, jobs.c.id)
Index("jobs_by_owner", jobs.c.owner, jobs.c.id, postgresql_where=jobs.c.owner.isnot(None))
Index("jobs_by_label", jobs.c.labels, postgresql_using="gin", postgresql_ops={"labels": "jsonb_path_ops"})
Index(
    "jobs_by_bytes",
    jobs.c.project,
    jobs.c.owner,
    jobs.c.bytes,
    postgresql_where=text("bytes > 0"),
)
UNFINISHED = ("queued", "starting", "running", "cancelling")
_IS_UNFINISHED = text("status IN ('queued', 'starting', 'running', 'cancelling')")
Index("jobs_queued", jobs.c.queue, jobs.c.id, postgresql_where=text("status = 'queued'"))
Index(
    "jobs_turns",
    jobs.c.queue,
    jobs.c.project,
    text("coalesce(owner, '')"),
    jobs.c.id,
    postgresql_where=text("status = 'queued'"),
)
Index("jobs_unfinished", jobs.c.id, postgresql_where=_IS_UNFINISHED)
Index("jobs_yielding", jobs.c.yields_to, postgresql_where=jobs.c.yields_to.isnot(None))
Index("jobs_by_source", jobs.c.source, postgresql_where=_IS_UNFINISHED)
Index("jobs_by_decoder", jobs.c.decoder, postgresql_where=_IS_UNFINISHED)
HAS_EXPERTS = text("experts <> '{}'")
Index("jobs_by_experts", jobs.c.experts, postgresql_using="gin", postgresql_where=HAS_EXPERTS)


def _of_job() -> Column[Any]:
    return Column("job_id", ForeignKey(jobs.c.id, ondelete="CASCADE"), primary_key=True)


attempts = Table(
    "attempts",
    metadata,
    _of_job(),
    Column("number", Integer, primary_key=True),
    Column("token", Text, nullable=False),
    Column("worker", Text, nullable=False),
    Column("device", Text),
    Column("engine", Text),
    # The most that it has had of a GPU's memory.
    Column("peak_bytes", BigInteger),
    # The part of the GPU's memory that it may take, where it shares the GPU.
    Column("gpu_part", Double),
    Column("details", Text, nullable=False, server_default="{}"),
    _moment("started_at", nullable=False),
    _moment("ended_at"),
    Column("reason", Text),
    Column("message", Text),
)

artifacts = Table(
    "artifacts",
    metadata,
    _of_job(),
    Column("name", Text, primary_key=True),
    Column("position", Integer, nullable=False),
    Column("role", Text, nullable=False),
    Column("media_type", Text, nullable=False),
    Column("size", BigInteger, nullable=False),
    Column("sha256", Text, nullable=False),
    Column("key", Text, nullable=False),
    Column("step", BigInteger),
    Column("metadata", Text, nullable=False, server_default="{}"),
)

chunks = Table(
    "chunks",
    metadata,
    _of_job(),
    Column("channel", Text, primary_key=True),
    Column("first", BigInteger, primary_key=True),
    Column("last", BigInteger, nullable=False),
    Column("key", Text, nullable=False),
    Column("size", BigInteger, nullable=False),
    Column("sha256", Text, nullable=False),
)

entries = Table(
    "entries",
    metadata,
    _of_job(),
    Column("channel", Text, primary_key=True),
    Column("number", BigInteger, primary_key=True),
    Column("kind", Text, nullable=False),
    # `time` is by the clock of who reported it, `stored_at` by the database's.
    _moment("time", nullable=False),
    Column("data", Text, nullable=False),
    Column("stored_at", TIMESTAMP(timezone=True), nullable=False, server_default=NOW),
)

# A block has the bytes of a `core.jobs.metrics.Block`, whose rows have the numbers `first` to `last`.
metrics = Table(
    "metrics",
    metadata,
    _of_job(),
    Column("first", BigInteger, primary_key=True),
    Column("last", BigInteger, nullable=False),
    Column("block", LargeBinary, nullable=False),
)

dispatches = Table(
    "dispatches",
    metadata,
    Column("task", Text, primary_key=True),
    Column("subject", Text, primary_key=True),
    Column("attempt", Integer, primary_key=True),
    _moment("created_at", nullable=False),
)

deletions = Table(
    "deletions",
    metadata,
    Column("job_id", String(collation="C"), primary_key=True),
    _moment("begun_at", nullable=False),
)


def _uploads(name: str, *more: Column[Any]) -> Table:
    """The table of one kind of files that users send, with further columns of that kind."""
    table = Table(
        name,
        metadata,
        Column("id", Text, primary_key=True),
        Column("status", Text, nullable=False),
        Column("media_type", Text, nullable=False),
        Column("size", BigInteger, nullable=False),
        _moment("created_at", nullable=False),
        Column("description", Text),
        Column("message", Text),
        _moment("refused_at"),
        Column("name", Text),
        *more,
    )
    Index(f"{name}_by_status", table.c.status)
    Index(f"{name}_by_name", table.c.name, postgresql_where=table.c.name.isnot(None))
    return table


models = _uploads("models")
clip_files = _uploads(
    "clip_files",
    Column("sha256", Text, nullable=False),
    Column("body", Text, nullable=False),
    Column("rate", Double),
)

workers = Table(
    "workers",
    metadata,
    Column("name", Text, primary_key=True),
    Column("document", Text, nullable=False),
    _moment("gone_at", nullable=False),
)

idempotency_keys = Table(
    "idempotency_keys",
    metadata,
    Column("key_hash", Text, primary_key=True),
    Column("fingerprint", Text, nullable=False),
    Column("job_id", String(collation="C"), ForeignKey(jobs.c.id, ondelete="CASCADE"), nullable=False),
    _moment("forgotten_at", nullable=False),
)
Index("idempotency_keys_by_job", idempotency_keys.c.job_id)
Index("idempotency_keys_by_end", idempotency_keys.c.forgotten_at)

sweeps = Table(
    "sweeps",
    metadata,
    Column("id", String(collation="C"), primary_key=True),
    Column("version", Integer, nullable=False),
    Column("status", Text, nullable=False),
    Column("spec", Text, nullable=False),
    Column("message", Text),
    _moment("created_at", nullable=False),
    _moment("finished_at"),
    # The importance of its parameters, computed from its trials.
    Column("results", Text, nullable=False, server_default="{}"),
    Column("key_hash", Text, unique=True),
    Column("fingerprint", Text),
    Column("owner", Text),
    Column("project", Text, nullable=False, server_default="default"),
)
_IS_ACTIVE = text("status IN ('running', 'cancelling')")
Index("sweeps_active", sweeps.c.id, postgresql_where=_IS_ACTIVE)

trials = Table(
    "trials",
    metadata,
    Column[Any]("sweep_id", ForeignKey(sweeps.c.id, ondelete="CASCADE"), primary_key=True),
    Column("number", Integer, primary_key=True),
    # Null if the trial never became a job, or its job was deleted.
    Column[Any]("job_id", ForeignKey(jobs.c.id, ondelete="SET NULL")),
    Column("outcome", Text),
    _moment("created_at", nullable=False),
    # The rest of the record.
    Column("document", Text, nullable=False),
)
Index("trials_by_job", trials.c.job_id)
Index("trials_jobs", trials.c.sweep_id, trials.c.job_id)
Index("trials_going", trials.c.sweep_id, postgresql_where=text("outcome IS NULL"))

usage = Table(
    "usage",
    metadata,
    # UTC, and the beginning of an hour.
    Column("hour", TIMESTAMP(timezone=True), primary_key=True),
    *(
        Column(name, Text, primary_key=True)
        for name in ("project", "owner", "host", "device", "status", "reason")
    ),
    Column("jobs", Integer, nullable=False),
    Column("attempts", Integer, nullable=False),
    Column("seconds", Double, nullable=False),
    Column("gpu_seconds", Double, nullable=False),
)

peaks = Table(
    "peaks",
    metadata,
    Column("alike", Text, primary_key=True),
    Column("bytes", BigInteger, nullable=False),
    _moment("measured_at", nullable=False),
)

tallies = Table(
    "tallies",
    metadata,
    Column("series", Text, primary_key=True),
    Column("labels", ARRAY(Text), primary_key=True),
    Column("buckets", ARRAY(BigInteger), nullable=False),
    Column("total", Double, nullable=False),
)

shares = Table(
    "shares",
    metadata,
    # `gpu` or `cpu`, by what the attempts held.
    *(Column(name, Text, primary_key=True) for name in ("device", "project", "owner")),
    # GPU-seconds, or a CPU's seconds; attempts that have ended, and their seconds.
    *(Column(name, Double, nullable=False) for name in ("amount", "attempts", "seconds")),
    _moment("at", nullable=False),
)

quotas = Table(
    "quotas",
    metadata,
    # `user` or `project`.
    Column("kind", Text, primary_key=True),
    Column("name", Text, primary_key=True),
    Column("weight", Double, nullable=False),
    # Null: as many as they like.
    Column("running", Integer),
    Column("queued", Integer),
    Column("gpu_hours", Double),
    Column("bytes", BigInteger),
    # Of what they submit.
    Column("highest_priority", Text, nullable=False, server_default="high"),
)

pulse = Table(
    "pulse",
    metadata,
    Column("id", Integer, primary_key=True),
    _moment("beat_at", nullable=False),
    # After a longer silence, attempts get time to renew their leases.
    Column("longest_silence", INTERVAL, nullable=False, server_default="0"),
    _moment("quiet_until", nullable=False),
    # After this time half of a use is forgotten; see `core.jobs.turns`.
    Column("half_life", INTERVAL, nullable=False, server_default="3 days"),
)

users = Table(
    "users",
    metadata,
    Column("name", Text, primary_key=True),
    Column("role", Text, nullable=False),
    Column("active", Boolean, nullable=False, server_default="true"),
    Column("subject", Text, unique=True),
    _moment("created_at", nullable=False),
)

projects = Table(
    "projects", metadata, Column("name", Text, primary_key=True), _moment("created_at", nullable=False)
)

members = Table(
    "members",
    metadata,
    Column[Any]("project", ForeignKey(projects.c.name), primary_key=True),
    Column[Any]("user_name", ForeignKey(users.c.name), primary_key=True),
)
Index("members_by_user", members.c.user_name)


def _projects_of(name: str, upload: str, uploads: Table) -> Table:
    return Table(
        name,
        metadata,
        Column[Any](upload, ForeignKey(uploads.c.id, ondelete="CASCADE"), primary_key=True),
        Column("project", Text, primary_key=True),
        Column("owner", Text),
    )


model_projects = _projects_of("model_projects", "model_id", models)
clip_file_projects = _projects_of("clip_file_projects", "clip_file_id", clip_files)

tokens = Table(
    "tokens",
    metadata,
    Column("id", Text, primary_key=True),
    Column[Any]("user_name", ForeignKey(users.c.name), nullable=False),
    Column("name", Text, nullable=False),
    Column("scope", Text, nullable=False),
    Column("sha256", Text, nullable=False),
    _moment("created_at", nullable=False),
    _moment("expires_at"),
    _moment("last_used_at"),
    _moment("revoked_at"),
)
Index("tokens_by_user", tokens.c.user_name)

sessions = Table(
    "sessions",
    metadata,
    Column("id", Text, primary_key=True),
    Column[Any]("user_name", ForeignKey(users.c.name), nullable=False),
    Column[Any]("token", ForeignKey(tokens.c.id)),
    Column("scope", Text, nullable=False),
    Column("sha256", Text, nullable=False),
    _moment("created_at", nullable=False),
    _moment("last_used_at", nullable=False),
    _moment("expires_at", nullable=False),
)

audit = Table(
    "audit",
    metadata,
    Column("id", BigInteger, Identity(always=True), primary_key=True),
    _moment("at", nullable=False),
    Column("user_name", Text),
    Column("token", Text),
    Column("action", Text, nullable=False),
    Column("object", Text),
    Column("details", Text, nullable=False, server_default="{}"),
    Column("address", Text),
    Column("correlation_id", Text),
)
Index("audit_by_user", audit.c.user_name, audit.c.id)
Index("audit_by_object", audit.c.object, audit.c.id)

retention = Table(
    "retention",
    metadata,
    Column[Any]("project", ForeignKey(projects.c.name), primary_key=True),
    Column("rules", Text, nullable=False),
    _moment("set_at", nullable=False),
    Column("set_by", Text),
)

webhooks = Table(
    "webhooks",
    metadata,
    Column[Any]("project", ForeignKey(projects.c.name), primary_key=True),
    Column("name", Text, primary_key=True),
    Column[Any]("owner", ForeignKey(users.c.name)),
    Column("url", Text, nullable=False),
    Column("events", ARRAY(Text), nullable=False),
    Column("jobs", Text, nullable=False),
    Column("secret", Text),
    _moment("created_at", nullable=False),
    Column("stopped", Text),
    Column("old_secret", Text),
    _moment("old_secret_until"),
)

news = Table(
    "news",
    metadata,
    Column("id", Text, primary_key=True),
    Column("event", Text, nullable=False),
    Column("project", Text, nullable=False),
    Column("owner", Text),
    Column("job", Text),
    Column("notify", ARRAY(Text), nullable=False),
    Column("document", Text, nullable=False),
    _moment("created_at", nullable=False),
)

deliveries = Table(
    "deliveries",
    metadata,
    Column("id", BigInteger, Identity(always=True), primary_key=True),
    Column("project", Text, nullable=False),
    Column("webhook", Text, nullable=False),
    Column("message", Text, nullable=False),
    Column("event", Text, nullable=False),
    Column("job", Text),
    Column("document", Text, nullable=False),
    Column("status", Text, nullable=False, server_default="waiting"),
    Column("attempts", Integer, nullable=False, server_default="0"),
    _moment("created_at", nullable=False),
    # When it is tried next; while a sender tries it, when that one is taken for dead.
    _moment("next_attempt_at"),
    _moment("ended_at"),
    Column("answer", Integer),
    Column("error", Text),
    ForeignKeyConstraint(
        ["project", "webhook"],
        ["webhooks.project", "webhooks.name"],
        name="deliveries_webhook",
        ondelete="CASCADE",
    ),
)
Index("deliveries_by_webhook", deliveries.c.project, deliveries.c.webhook, deliveries.c.id)
Index("deliveries_by_job", deliveries.c.job, deliveries.c.id, postgresql_where=deliveries.c.job.isnot(None))
Index("deliveries_ended", deliveries.c.ended_at, postgresql_where=deliveries.c.ended_at.isnot(None))
_IS_WAITING = text("status = 'waiting'")
Index(
    "deliveries_due",
    deliveries.c.project,
    deliveries.c.webhook,
    deliveries.c.next_attempt_at,
    postgresql_where=_IS_WAITING,
)
