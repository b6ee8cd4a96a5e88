"""The migrations make exactly the tables that the code expects, in every database that they may meet."""

import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from datetime import timedelta
from pathlib import Path

import psycopg
import pytest
from alembic.autogenerate import compare_metadata
from alembic.config import Config
from alembic.runtime.migration import MigrationContext
from alembic.script import ScriptDirectory
from pydantic import SecretStr
from sqlalchemy import Engine, inspect, text

from core.accounts.principal import NOBODYS, Role, TokenScope
from core.accounts.store import Actor, PageSession, Token, User
from core.accounts.tokens import SESSION, new_secret
from core.adapters.postgres import schema
from core.adapters.postgres.engine import DEADLINE_S, connect_postgres
from core.adapters.postgres.store import PostgresJobStore
from core.adapters.postgres.tables import metadata
from core.errors import Misconfigured, RecordsUnavailable
from core.jobs.job import Job
from core.jobs.retention import RetentionRules
from core.jobs.status import JobStatus
from core.jobs.store import Entry, Idempotency
from core.jobs.tallies import Tally
from core.jobs.turns import Quota
from core.news.webhook import Webhook
from core.reasons import Reason
from tests.conftest import Databases
from tests.contract.recording import (
    LEASE,
    NOW,
    Database,
    artifact,
    chunk_of,
    clip_file,
    held,
    model,
    queued_job,
    say,
    worker,
)
from tests.unit.sweeps.making import sweep_of, trial_of

OURS = {table.name for table in metadata.sorted_tables}

# What a database says of its columns, indexes, constraints and storage. PostgreSQL 18 also names NOT NULL
# constraints, after the column's first name; the columns' own rows say the same by `is_nullable`.
DESCRIPTIONS = (
    "SELECT table_name, column_name, data_type, is_nullable, column_default, collation_name "
    "FROM information_schema.columns WHERE table_schema = 'public'",
    "SELECT indexdef FROM pg_indexes WHERE schemaname = 'public'",
    "SELECT conrelid::regclass::text, conname, pg_get_constraintdef(oid) FROM pg_constraint "
    "WHERE connamespace = 'public'::regnamespace AND contype <> 'n'",
    "SELECT relname, reloptions FROM pg_class WHERE relnamespace = 'public'::regnamespace AND relkind = 'r'",
)


@pytest.fixture
def empty(databases: Databases) -> Iterator[Engine]:
    """A database without tables."""
    yield from _database_without_tables(databases)


@pytest.fixture
def another(databases: Databases) -> Iterator[Engine]:
    yield from _database_without_tables(databases)


def _database_without_tables(databases: Databases) -> Iterator[Engine]:
    url = databases.fresh()
    with psycopg.connect(url, autocommit=True) as connection:
        connection.execute("DROP SCHEMA public CASCADE; CREATE SCHEMA public")
    yield connect_postgres(url, pool_size=0)
    databases.drop(url)


def tables(engine: Engine) -> set[str]:
    return set(inspect(engine).get_table_names())


def revision(engine: Engine) -> str | None:
    with engine.connect() as connection:
        return schema.current(connection)


def revisions() -> list[str]:
    """From the first to the newest."""
    config = Config()
    config.set_main_option("script_location", str(Path(schema.__file__).parent / "migrations"))
    return [script.revision for script in ScriptDirectory.from_config(config).walk_revisions()][::-1]


def described(engine: Engine) -> set[str]:
    """Everything about its tables but Alembic's own."""
    with engine.connect() as connection:
        found = [str(row) for query in DESCRIPTIONS for row in connection.execute(text(query))]
    return {row for row in found if "alembic_version" not in row}


def fill(engine: Engine) -> Job:
    """Put something into every table; a job that is held."""
    jobs = PostgresJobStore(engine)
    claimed = held(jobs, queued_job())
    jobs.add(queued_job(1), Idempotency("k", "body"))
    jobs.save(published := claimed.with_artifacts((artifact("a"),)))
    say(jobs, claimed, "a", "b")
    jobs.replace_by_chunk(claimed.id, chunk_of(jobs.oldest_entries(claimed.id, "logs", limit=1)))
    row = Entry(kind="metrics", time=NOW, data={"step": 1, "values": {"reward": 1.0}})
    jobs.record(claimed.id, claimed.token, "events", [row], write_id="w")
    jobs.models.add(record := model(status="validating"))
    jobs.models.claim(record.id, NOBODYS)
    jobs.clips.add(file := clip_file(status="validating"))
    jobs.clips.claim(file.id, NOBODYS)
    if not jobs.users():
        user = jobs.add_user(
            User(name="ann", role=Role.ADMIN, projects=("default",), created_at=NOW), Actor()
        )
        secret = new_secret()
        token = Token(id=secret.id, user=user.name, name="", scope=TokenScope.READ, created_at=NOW)
        jobs.add_token(token, secret, Actor())
        session = PageSession(
            id=secret.id, user=user.name, scope=token.scope, created_at=NOW, expires_at=NOW + LEASE
        )
        jobs.add_session(session, new_secret(SESSION), Actor())
    jobs.announce(worker("w"), LEASE)
    gone = jobs.add(queued_job(2))
    jobs.delete(gone.id, gone.version)
    sweep = jobs.add_sweep(sweep_of(), Idempotency("k", "body"))
    jobs.add_trial(sweep.id, trial_of(0, job=None), None)
    jobs.set_quota("user", "ann", Quota(running=1), Actor())
    jobs.set_retention("default", RetentionRules(checkpoints=1), Actor())
    jobs.add_tallies([Tally("series", ("label",), (1, 2), 3.0)])
    jobs.keep_peak("ant/ppo", 1)
    _tell_a_webhook(jobs)
    jobs.save(held(jobs, queued_job(3)).ended(JobStatus.FAILED, Reason.DIVERGED, "", NOW))
    return published


def _tell_a_webhook(jobs: PostgresJobStore) -> None:
    if not jobs.webhooks("default"):
        url = SecretStr("https://hooks.example")
        hook = Webhook(
            project="default", name="hook", url=url, events=("job.started",), jobs="all", created_at=NOW
        )
        jobs.add_webhook(hook, Actor())
    jobs.spread_news()


def test_from_nothing_they_make_exactly_what_the_code_expects(empty: Engine, another: Engine) -> None:
    schema.upgrade(empty)
    with empty.connect() as connection:
        options = {"compare_type": True, "compare_server_default": True}
        assert compare_metadata(MigrationContext.configure(connection, opts=options), metadata) == []
    # That passes over conditions of indexes, collations and storage; the database's own words do not.
    metadata.create_all(another)
    assert described(empty) ^ described(another) == set()
    assert tables(empty) == OURS | {"alembic_version"}


def test_a_new_database_serves_at_once(empty: Engine) -> None:
    schema.upgrade(empty)
    jobs = PostgresJobStore(empty)
    jobs.ping()
    jobs.beat(LEASE)
    job = fill(empty)
    assert jobs.get(job.id) == job


def test_without_tables_the_record_is_unavailable_and_says_what_makes_them(empty: Engine) -> None:
    with pytest.raises(RecordsUnavailable, match="no tables yet: the reconciler makes them"):
        PostgresJobStore(empty).ping()


def test_an_upgrade_of_what_is_there_changes_nothing(empty: Engine) -> None:
    schema.upgrade(empty)
    job = fill(empty)
    before = described(empty)
    schema.upgrade(empty)
    assert described(empty) == before
    assert PostgresJobStore(empty).get(job.id) == job


def test_a_downgrade_to_the_base_drops_everything(empty: Engine) -> None:
    schema.upgrade(empty)
    fill(empty)
    schema.downgrade(empty, "base")
    assert tables(empty) == {"alembic_version"}
    assert revision(empty) is None


def test_every_step_up_and_down_works_with_rows_and_ends_at_the_same_tables(empty: Engine) -> None:
    schema.upgrade(empty)
    newest = described(empty)
    fill(empty)
    ladder = revisions()
    for step in [*reversed(ladder[:-1]), "base"]:
        schema.downgrade(empty, step)
    for step in ladder:
        schema.upgrade(empty, step)
        assert revision(empty) == step
    assert described(empty) == newest
    fill(empty)


def test_damaged_progress_hinders_no_upgrade_and_no_write(empty: Engine) -> None:
    schema.upgrade(empty)
    job = fill(empty)
    schema.downgrade(empty, "0017")
    damaged = [
        "{",
        r'{"step": 1, "note": "\u0000"}',
        r'{"step": 1, "note": "\udc00"}',
        '{"step": 1e200000}',
        '{"step": 1e-200000}',
        f'{{"step": {200_000 * "1"}}}',
        '{"step": 1e400}',
    ]
    damage = text("UPDATE jobs SET progress = :progress")
    for progress in damaged:
        with empty.begin() as connection:
            connection.execute(damage, {"progress": progress})
        schema.upgrade(empty)
        with empty.connect() as connection:
            steps = connection.execute(text("SELECT progress_step FROM jobs")).scalars().all()
        assert set(steps) == {None}, progress[:40]
        assert PostgresJobStore(empty).get(job.id).id == job.id
        schema.downgrade(empty, "0017")


def test_an_upgrade_finds_the_device_and_the_engine_of_the_newest_attempt(empty: Engine) -> None:
    schema.upgrade(empty)
    jobs = PostgresJobStore(empty)
    job = held(jobs, queued_job())
    for device, engine in (("cpu", "mjx"), ("gpu:0", "native")):
        jobs.save(job := job.running(device=device, engine=engine))
        jobs.save(job := job.requeued(Reason.WORKER_LOST, "", NOW))
        jobs.save(job := job.claimed("host:gpu:0", NOW))
    known = text("SELECT device, engine FROM jobs")
    with empty.connect() as connection:
        assert connection.execute(known).one() == ("gpu:0", "native")
    schema.downgrade(empty, "0024")
    schema.upgrade(empty)
    with empty.connect() as connection:
        assert connection.execute(known).one() == ("gpu:0", "native")


def test_steps_down_and_up_again_keep_the_jobs(empty: Engine) -> None:
    schema.upgrade(empty)
    job = fill(empty)
    for step in revisions()[-2::-1]:  # None, while there is one revision.
        schema.downgrade(empty, step)
        schema.upgrade(empty)
    assert PostgresJobStore(empty).get(job.id) == job


def test_these_tests_put_rows_into_every_table(database_url: str, database: Database) -> None:
    fill(connect_postgres(database_url, pool_size=0))
    assert {name for name in OURS if database.count(name) == 0} == set()


def test_two_that_upgrade_at_once_make_the_tables_once(empty: Engine) -> None:
    together = threading.Barrier(2)

    def upgrade() -> None:
        together.wait()
        schema.upgrade(empty)

    with ThreadPoolExecutor(2) as pool:
        for done in [pool.submit(upgrade) for _ in range(2)]:
            done.result(60)
    assert tables(empty) == OURS | {"alembic_version"}
    with empty.connect() as connection:
        assert connection.execute(text("SELECT count(*) FROM pulse")).scalar_one() == 1


def test_an_upgrade_waits_for_another_one_longer_than_a_call_may_take(empty: Engine) -> None:
    with ThreadPoolExecutor(1) as pool:
        with empty.begin() as connection:
            connection.execute(text(f"SELECT pg_advisory_xact_lock({schema._LOCK})"))
            waiting = pool.submit(schema.upgrade, empty)
            # Beyond the time limits of the client and of the server.
            threading.Event().wait(DEADLINE_S + 0.3)
            assert not waiting.done()
        waiting.result(60)
    assert tables(empty) == OURS | {"alembic_version"}


def test_an_upgrade_that_fails_leaves_what_was_there(empty: Engine) -> None:
    with empty.begin() as connection:
        connection.execute(text("CREATE TABLE workers (theirs integer)"))
    with pytest.raises(Exception, match='"workers" already exists'):
        schema.upgrade(empty)
    assert tables(empty) == {"workers"}


def test_the_revisions_are_known_without_alembic_and_new_tables_are_of_the_last(empty: Engine) -> None:
    assert schema.known() == revisions()
    assert revision(empty) is None
    schema.upgrade(empty)
    assert revision(empty) == schema.known()[-1]


@pytest.mark.parametrize(
    ("number", "refusal"),
    [
        ("9999", r"A newer version .*revision 9999; this one knows 0"),
        ("0001", r"A version before the first release .*revision 0001; .*: name an empty database"),
    ],
)
def test_tables_of_an_unknown_revision_are_refused_and_stay(empty: Engine, number: str, refusal: str) -> None:
    schema.upgrade(empty)
    job = fill(empty)
    before = described(empty)
    with empty.begin() as connection:
        connection.execute(text("UPDATE alembic_version SET version_num = :number"), {"number": number})
    with pytest.raises(Misconfigured, match=refusal):
        schema.upgrade(empty)
    assert described(empty) == before
    assert PostgresJobStore(empty).get(job.id) == job


def test_the_pulse_of_a_new_database_is_not_older_than_it(empty: Engine) -> None:
    schema.upgrade(empty)
    with empty.connect() as connection:
        age = connection.execute(text("SELECT clock_timestamp() - beat_at FROM pulse")).scalar_one()
    assert timedelta(0) <= age < timedelta(minutes=2)
