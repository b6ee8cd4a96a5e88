"""Checks at the start of a process that the stores do what it needs of them."""

import math
import secrets
from collections.abc import Callable
from contextlib import suppress
from functools import partial

import structlog
from redis import Redis

from core.adapters.postgres import schema
from core.adapters.postgres.engine import connect_postgres
from core.adapters.postgres.worker_role import prepare_worker_role
from core.adapters.redis.errors import reaching_redis
from core.adapters.s3.objects import S3ObjectStore
from core.adapters.wiring import connect_redis, job_store, object_store
from core.errors import (
    Misconfigured,
    ObjectNotFound,
    RecordsRefuse,
    StorageRefuses,
    StorageUnavailable,
    Unavailable,
)
from core.retry import retry_while_unavailable
from core.settings import ReconcilerSettings, StoreSettings

log = structlog.get_logger()

_TIMEOUT_S = 10.0
# A store that has just started may not know its bucket and its keys yet.
_REFUSAL_IS_FINAL_AFTER_S = 3.0
_REFUSALS = (RecordsRefuse, StorageRefuses)

# KEYS: a name that nobody else uses. It is deleted, or expires after a second if this is cut off.
_WRITE = "redis.call('SET', KEYS[1], '', 'PX', 1000) return redis.call('DEL', KEYS[1])"


def check_stores(settings: StoreSettings, timeout_s: float = _TIMEOUT_S) -> None:
    """Return when each store serves, or has been unavailable for `timeout_s`: it may come back later.

    Raises Misconfigured if a store answers and refuses for some seconds: waiting will not mend that.
    """
    # Without retries of their own, so that the first error is in the log at once.
    queue = connect_redis(settings.redis_url.get_secret_value(), retries=0)
    objects = object_store(settings, retries=0)
    looks = {
        "postgresql": job_store(settings, pool_size=0).ping,
        "redis": partial(exercise_queue, queue),
        "object_store": partial(exercise_objects, objects),
    }
    for name, look in looks.items():
        try:
            _try(look, timeout_s)
        except _REFUSALS as error:
            raise Misconfigured(error.detail) from error
        except Unavailable as error:
            log.warning("store_away_at_start", store=name, error=error.detail)


def prepare_database(settings: StoreSettings) -> None:
    """Create or upgrade the tables; waits as long as the database is unavailable.

    Raises Misconfigured if the database refuses for some seconds, or its tables are of a newer version.
    """
    engine = connect_postgres(settings.database_url.get_secret_value(), pool_size=0)
    try:
        _try(partial(schema.upgrade, engine), math.inf)
    except RecordsRefuse as error:
        raise Misconfigured(error.detail) from error


def prepare_workers(settings: ReconcilerSettings) -> None:
    """Give the workers' role its rights, where the settings name one. Raises Misconfigured."""
    if settings.worker_database_url is not None:
        engine = connect_postgres(settings.database_url.get_secret_value(), pool_size=0)
        _try(partial(prepare_worker_role, engine, settings.worker_database_url.get_secret_value()), math.inf)


def _try(look: Callable[[], None], timeout_s: float) -> None:
    try:
        retry_while_unavailable(look, timeout_s, gives_up_on=_REFUSALS)
    except _REFUSALS:
        retry_while_unavailable(look, _REFUSAL_IS_FINAL_AFTER_S)


@reaching_redis()
def exercise_queue(client: Redis) -> None:
    """Let a script write and delete a key. Raises RecordsUnavailable, or RecordsRefuse naming a setting."""
    client.eval(_WRITE, 1, f"gaitway:probe:{secrets.token_hex(8)}")  # pyright: ignore[reportUnknownMemberType]


def exercise_objects(objects: S3ObjectStore) -> None:
    """Use the store as the service does, and leave nothing in it.

    Raises StorageUnavailable, or StorageRefuses naming what to change.
    """
    prefix, body = f"probes/{secrets.token_hex(8)}/", secrets.token_bytes(4096)
    key = f"{prefix}probe"
    objects.list(prefix)  # First: for a put, some stores say no more than that it is forbidden.
    objects.delete([key])  # Before the put: an object that may not be deleted would stay.
    try:
        objects.put(key, body)
        wrong = _wrong_with(objects, prefix, key, body)
    except StorageUnavailable:
        with suppress(StorageUnavailable):
            objects.delete([key])
        raise
    objects.delete([key])
    if not wrong and _get(objects, key) is not None:
        wrong = "an object is still there after its delete"
    if wrong:
        raise StorageRefuses(
            f"The object store at GAITWAY_S3_ENDPOINT does not work as S3 does: {wrong}. Set it to a store "
            "with the whole S3 interface, and without a cache in front of it."
        )


def _wrong_with(objects: S3ObjectStore, prefix: str, key: str, body: bytes) -> str:
    """The fault that the store shows with an object that was put; empty if there is none."""
    if _get(objects, key) != body:
        return "a get does not return the bytes that were put"
    with objects.open(key, 1000, 500) as pieces:
        if b"".join(pieces) != body[1000:1500]:
            return "a ranged get does not return the bytes that were asked for"
    if [found.key for found in objects.list(prefix)] != [key]:
        return "a listing does not show what was put"
    return ""


def _get(objects: S3ObjectStore, key: str) -> bytes | None:
    try:
        return objects.get(key)
    except ObjectNotFound:
        return None
