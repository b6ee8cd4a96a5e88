"""`gaitway import-0.1`: brings the jobs and models of version 0.1 into the record, once. Composition root.

Nothing of version 0.1 is changed: its keys in Redis and its objects stay as they are.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from core.adapters.connect import connect_postgres, connect_redis, job_store, object_store
from core.adapters.postgres import schema
from core.adapters.postgres.jobs import PostgresJobStore
from core.adapters.version_01 import Version01
from core.errors import JobUnreadable, ModelNotFound
from core.jobs import feeds
from core.settings import StoreSettings
from core.storage.objects import ObjectStore

Report = Callable[[str], None]

_REPORT_EVERY = 100
_ASKED_AT_ONCE = 1000


class ImportRefused(Exception):
    """Nothing was imported; the message says why, and what to do."""


@dataclass
class _Counts:
    imported: int = 0
    unreadable: int = 0
    known: int = 0

    def sentence(self, what: str) -> str:
        return (
            f"{what}: {self.imported:,} imported, {self.known:,} in the record before, "
            f"{self.unreadable:,} not readable."
        )


def import_stores(settings: StoreSettings, report: Report, *, without_redis: bool = False) -> bool:
    """Import what version 0.1 kept in these stores; returns whether all of it could be read.

    without_redis: what it had in Redis is lost. Raises ImportRefused, Unavailable, Misconfigured.
    """
    old = _version_01(settings, without_redis)
    schema.upgrade(connect_postgres(settings.database_url.get_secret_value(), pool_size=0))
    store, objects = job_store(settings), object_store(settings)
    try:
        # A job may need a model.
        models = _import_models(old, store, report)
        jobs = _import_jobs(old, store, objects, report, without_redis)
    finally:
        store.close()
    report(models.sentence("Models"))
    report(jobs.sentence("Jobs"))
    return models.unreadable + jobs.unreadable == 0


def refuse_while_at_work(settings: StoreSettings) -> None:
    """Raises ImportRefused where workers of version 0.1 are alive."""
    if workers := _version_01(settings, without_redis=False).workers():
        raise ImportRefused(
            f"Version 0.1 is still running: {', '.join(workers)}. Stop all of it; a killed worker is "
            "listed for another minute."
        )


def _version_01(settings: StoreSettings, without_redis: bool) -> Version01:
    redis = None if without_redis else connect_redis(settings.redis_url.get_secret_value(), timeout_s=10)
    return Version01(redis, object_store(settings))


def _import_models(old: Version01, store: PostgresJobStore, report: Report) -> _Counts:
    counts = _Counts()
    for model_id in old.model_ids():
        try:
            store.find_model(model_id)
            counts.known += 1
        except ModelNotFound:
            try:
                store.add_model(old.read_model(model_id))
                counts.imported += 1
            except ValueError as error:
                counts.unreadable += 1
                report(f"Model {model_id} is skipped, because its record cannot be read: {error}.")
    return counts


def _import_jobs(
    old: Version01, store: PostgresJobStore, objects: ObjectStore, report: Report, without_redis: bool
) -> _Counts:
    """Oldest first: a job may need the checkpoint of an older one."""
    counts, now = _Counts(), store.now()
    ids, live = old.job_ids(), old.live_job_ids()
    missing = list(_missing(ids, store))
    counts.known = len(ids) - len(missing)
    if missing and not live and not without_redis:
        raise ImportRefused(
            f"The object store has {len(missing):,} jobs of version 0.1, and Redis has none. Set "
            "GAITWAY_REDIS_URL to the Redis that version 0.1 used, and let it load its data. If these are "
            "lost: --without-redis imports what the object store has, which is no log and not always the "
            "last state of a job."
        )
    _report_deleted(list(_missing(sorted(set(live).difference(ids)), store)), report)
    for number, job_id in enumerate(missing, 1):
        try:
            found = old.read(job_id, now)
            is_new = store.import_job(found.job, found.events, found.logs, found.keys)
        except JobUnreadable as error:
            counts.unreadable += 1
            report(f"Job {job_id} is skipped, because its record cannot be read: {error.problem}.")
        else:
            counts.imported += is_new
            counts.known += not is_new
            # After each job: the database should not hold the feeds of all jobs together.
            while feeds.compact(store=store, objects=objects):
                pass
        if number % _REPORT_EVERY == 0:
            report(f"{number:,} of {len(missing):,} jobs")
    return counts


def _missing(ids: Sequence[str], store: PostgresJobStore) -> Iterator[str]:
    """Those that the record does not have, in the same order."""
    for start in range(0, len(ids), _ASKED_AT_ONCE):
        some = ids[start : start + _ASKED_AT_ONCE]
        known = store.marks(some)
        yield from (job_id for job_id in some if job_id not in known)


def _report_deleted(ids: Sequence[str], report: Report) -> None:
    if ids:
        report(
            f"{len(ids):,} jobs that Redis has are left out, because the object store has nothing of them: "
            "they were deleted, or GAITWAY_S3_BUCKET is not the bucket that version 0.1 used."
        )
