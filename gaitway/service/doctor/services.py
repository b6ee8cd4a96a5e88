"""Checks of PostgreSQL, Redis and the object store, and of the service itself."""

import os
from datetime import UTC, datetime
from email.utils import parsedate_to_datetime
from typing import TYPE_CHECKING, Any

import httpx

from core.errors import GaitwayError
from gaitway import errors
from gaitway.addresses import DEFAULT_URL
from gaitway.client import Client
from gaitway.local import running
from gaitway.retry import Retry
from gaitway.service.doctor.check import Check
from gaitway.service.doctor.settings import of_the_stores
from gaitway.service.installed import PROGRAM

if TYPE_CHECKING:
    from core.settings import StoreSettings

_NO_SETTINGS = "no settings that lead to one"


def postgresql(settings: "StoreSettings | None") -> Check:
    """Check that the record can be reached, is durable, and has tables of this version."""
    if settings is None:
        return Check("postgresql", "skip", _NO_SETTINGS)
    from core.adapters.postgres import schema
    from core.adapters.wiring import connect_postgres, job_store

    try:
        found = schema.facts(connect_postgres(settings.database_url.get_secret_value(), pool_size=0))
        if found.revision is not None:
            job_store(settings, pool_size=0).ping()
    except GaitwayError as error:
        return Check("postgresql", "fail", error.detail)
    detail = f"PostgreSQL {found.server}, tables of revision {found.revision}"
    if not found.is_known:
        if str(found.revision) < str(found.newest):
            remedy = "Let GAITWAY_DATABASE_URL name an empty database."
            return Check("postgresql", "fail", f"{detail}, of a version before the first release", remedy)
        remedy = "Start that version, or downgrade the tables with it first."
        return Check("postgresql", "fail", f"{detail}, which a newer version of Gaitway made", remedy)
    if not found.is_durable:
        remedy = "Set fsync, full_page_writes and synchronous_commit to on."
        return Check("postgresql", "warn", f"{detail}; a power cut may lose committed data", remedy)
    if found.revision is None:
        return Check("postgresql", "pass", f"PostgreSQL {found.server}; the reconciler will make the tables")
    if found.revision != found.newest:
        remedy = "Start the reconciler: it upgrades them."
        return Check("postgresql", "warn", f"{detail}; this version's are of {found.newest}", remedy)
    return Check("postgresql", "pass", detail)


def redis(settings: "StoreSettings | None") -> Check:
    """Check that the queue can be written."""
    if settings is None:
        return Check("redis", "skip", _NO_SETTINGS)
    from core.adapters.redis.errors import reaching_redis
    from core.adapters.startup import exercise_queue
    from core.adapters.wiring import connect_redis

    try:
        with connect_redis(settings.redis_url.get_secret_value(), retries=0) as client, reaching_redis():
            exercise_queue(client)
            facts: Any = client.info()  # pyright: ignore[reportUnknownMemberType]
    except GaitwayError as error:
        return Check("redis", "fail", error.detail)
    number = facts.get("valkey_version") or facts.get("redis_version", "?")
    detail = f"{facts.get('server_name', 'redis')} {number}"
    if not facts.get("maxmemory"):
        remedy = "Set `maxmemory`: without it a flood of jobs takes the machine's memory."
        return Check("redis", "warn", f"{detail}, no maxmemory", remedy)
    if facts.get("maxmemory_policy") != "noeviction":
        remedy = "Set `maxmemory-policy noeviction`: another policy makes Redis forget waiting jobs."
        return Check("redis", "warn", f"{detail}, evicts keys", remedy)
    return Check("redis", "pass", detail)


def object_store(settings: "StoreSettings | None") -> Check:
    """Check that a put, a get, a ranged get, a listing and a delete work."""
    if settings is None:
        return Check("object store", "skip", _NO_SETTINGS)
    from core.adapters.startup import exercise_objects
    from core.adapters.wiring import object_store

    try:
        exercise_objects(object_store(settings, retries=0))
    except GaitwayError as error:
        return Check("object store", "fail", error.detail)
    where = f"{settings.s3_endpoint}, bucket {settings.s3_bucket}"
    return Check("object store", "pass", f"{where}: put, get, range, list and delete work")


def clock(settings: "StoreSettings | None") -> Check:
    """Check that this clock agrees with the object store's: S3 refuses signatures that are 15 minutes off."""
    if settings is None:
        return Check("clock", "skip", _NO_SETTINGS)
    from core.adapters.s3.connection import trusting

    scheme = "https" if settings.s3_secure else "http"
    verify = True if settings.tls_ca is None else trusting(settings.tls_ca)
    try:
        answer = httpx.get(f"{scheme}://{settings.s3_endpoint}/", timeout=5, verify=verify)
        skew_s = abs((datetime.now(UTC) - parsedate_to_datetime(answer.headers["Date"])).total_seconds())
    except (httpx.HTTPError, KeyError, ValueError, TypeError):
        return Check("clock", "skip", "the object store's answer names no time")
    remedy = "Let both machines take their time from NTP (here: `timedatectl set-ntp true`)."
    # The header has whole seconds, and the answer takes a while.
    if skew_s > 300:
        return Check("clock", "fail", f"{skew_s:.0f} s away from the object store's", remedy)
    if skew_s > 5:
        return Check("clock", "warn", f"{skew_s:.0f} s away from the object store's", remedy)
    return Check("clock", "pass", "agrees with the object store's")


def api() -> Check:
    """Check that the service at GAITWAY_URL is ready; otherwise the one on this machine.

    A part of a service, which has settings for its stores, need not have the API on its machine.
    """
    named = os.environ.get("GAITWAY_URL")
    if not named and of_the_stores() is not None:
        return Check("api", "skip", "GAITWAY_URL is not set")
    url = named or running() or DEFAULT_URL
    remedy = "Start the service there, or correct GAITWAY_URL." if named else f"Start it: `{PROGRAM} up`."
    try:
        with Client(url, timeout_s=5, retry=Retry(attempts=1)) as client:
            client.health()
            told = _who(client)
    except errors.Unauthenticated as error:
        return Check(
            "api", "fail", f"{url} is ready, but lets you do nothing: {error}", "Run `gaitway login`."
        )
    except errors.ApiError as error:
        return Check("api", "fail", f"{url} is not ready: {error}", "Run `gaitway doctor` where it runs.")
    except (errors.Unreachable, errors.WrongAddress) as error:
        return Check("api", "fail", str(error), remedy)
    except ValueError:
        return Check("api", "fail", f"The server at {url} is not a Gaitway service.", remedy)
    return Check("api", "pass", f"{url} is ready{told}")


def _who(client: Client) -> str:
    """Who one is there, as the end of a sentence. Raises Unauthenticated."""
    try:
        who = client.whoami()
    except (errors.NotFound, ValueError):  # An older service, which has no accounts either.
        return ""
    return f"; you are {who.user}, a {who.role}" if who.accounts else ""
