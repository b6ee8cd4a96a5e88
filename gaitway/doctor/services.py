"""What the service leans on: Redis and the object store."""

import secrets
from collections.abc import Mapping
from datetime import UTC, datetime
from email.utils import parsedate_to_datetime
from typing import Any

import httpx

from gaitway.doctor.check import Check

_S3 = ("GAITWAY_S3_ENDPOINT", "GAITWAY_S3_ACCESS_KEY", "GAITWAY_S3_SECRET_KEY")
_NOT_CONFIGURED = "not configured (the embedded stack will start its own)"


def redis(environ: Mapping[str, str]) -> Check:
    """Whether the job records answer, and survive a restart."""
    url = environ.get("GAITWAY_REDIS_URL")
    if not url:
        return Check("redis", "skip", _NOT_CONFIGURED)
    from core.adapters.connect import connect_redis

    try:
        with connect_redis(url, retries=0) as client:
            client.ping()  # pyright: ignore[reportUnknownMemberType]
            facts: Any = client.info()  # pyright: ignore[reportUnknownMemberType]
    except Exception as error:  # a bad address, a refusal, a wrong password: all are findings
        return Check(
            "redis", "fail", f"{type(error).__name__}: {error}", "Start it, or correct GAITWAY_REDIS_URL."
        )
    number = facts.get("valkey_version") or facts.get("redis_version", "?")
    detail = f"{facts.get('server_name', 'redis')} {number}"
    if not facts.get("aof_enabled"):
        remedy = (
            "Set `appendonly yes`: without it a restart of Redis loses what happened since its last snapshot."
        )
        return Check("redis", "warn", f"{detail}, append-only file off", remedy)
    return Check("redis", "pass", f"{detail}, append-only file on")


def object_store(environ: Mapping[str, str]) -> Check:
    """Whether a put, a get, a ranged get, a listing and a delete do what they should."""
    missing = [name for name in _S3 if not environ.get(name)]
    if len(missing) == len(_S3):
        return Check("object store", "skip", _NOT_CONFIGURED)
    if missing:
        return Check("object store", "fail", f"{', '.join(missing)} is not set", f"Set {', '.join(missing)}.")
    try:
        wrong = _exercise(environ)
    except Exception as error:  # whatever it is, it is the finding
        remedy = (
            "Start it, or correct GAITWAY_S3_ENDPOINT, its keys, GAITWAY_S3_BUCKET and GAITWAY_S3_SECURE."
        )
        return Check("object store", "fail", f"{type(error).__name__}: {error}", remedy)
    where = f"{environ['GAITWAY_S3_ENDPOINT']}, bucket {environ.get('GAITWAY_S3_BUCKET', 'gaitway')}"
    if wrong:
        remedy = "Use a store with the whole S3 interface, and no cache before it."
        return Check("object store", "fail", f"{where}: {wrong}", remedy)
    return Check("object store", "pass", f"{where}: put, get, range, list and delete work")


def clock(environ: Mapping[str, str]) -> Check:
    """Whether this clock agrees with the object store's: S3 refuses signatures that are 15 minutes off."""
    if not environ.get("GAITWAY_S3_ENDPOINT"):
        return Check("clock", "skip", _NOT_CONFIGURED)
    scheme = "http" if _is_plain(environ) else "https"
    try:
        answer = httpx.get(f"{scheme}://{environ['GAITWAY_S3_ENDPOINT']}/", timeout=5)
        skew_s = abs((datetime.now(UTC) - parsedate_to_datetime(answer.headers["Date"])).total_seconds())
    except (httpx.HTTPError, KeyError, ValueError, TypeError):
        return Check("clock", "skip", "the object store does not tell the time")
    remedy = "Let both machines take their time from NTP."
    # The header has whole seconds, and the answer takes its time.
    if skew_s > 300:
        return Check("clock", "fail", f"{skew_s:.0f} s away from the object store's", remedy)
    if skew_s > 5:
        return Check("clock", "warn", f"{skew_s:.0f} s away from the object store's", remedy)
    return Check("clock", "pass", "agrees with the object store's")


def _exercise(environ: Mapping[str, str]) -> str:
    """Use the store for real; what it did wrong, or nothing."""
    from core.adapters.connect import connect_s3
    from core.adapters.s3_objects import S3ObjectStore
    from core.errors import ObjectNotFound

    endpoint, access_key, secret_key = (environ[name] for name in _S3)
    region = environ.get("GAITWAY_S3_REGION")
    client = connect_s3(
        endpoint, access_key, secret_key, secure=not _is_plain(environ), region=region, retries=0
    )
    store = S3ObjectStore(client, environ.get("GAITWAY_S3_BUCKET", "gaitway"))
    prefix, body = f"doctor/{secrets.token_hex(8)}/", secrets.token_bytes(4096)
    key = f"{prefix}probe"
    try:
        store.put(key, body)
        if store.get(key) != body:
            return "a get gives other bytes than were put"
        with store.open(key, 1000, 500) as pieces:
            if b"".join(pieces) != body[1000:1500]:
                return "a ranged get gives other bytes than were asked for"
        if [found.key for found in store.list(prefix)] != [key]:
            return "a listing does not show what was put"
    finally:
        store.delete_prefix(prefix)
    try:
        store.get(key)
    except ObjectNotFound:
        return ""
    return "an object is still there after its delete"


def _is_plain(environ: Mapping[str, str]) -> bool:
    return environ.get("GAITWAY_S3_SECURE", "true").lower() in ("false", "0", "no", "off", "f", "n")
