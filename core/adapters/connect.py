"""From settings to adapters; for composition roots."""

import base64
import hashlib
from typing import Any

from minio import Minio
from minio.helpers import check_bucket_name
from redis import Redis
from redis.backoff import ExponentialBackoff
from redis.exceptions import ConnectionError as RedisConnectionError
from redis.exceptions import TimeoutError as RedisTimeoutError
from redis.retry import Retry
from urllib3 import BaseHTTPResponse, PoolManager
from urllib3 import Retry as HTTPRetry
from urllib3 import Timeout as HTTPTimeout

from core.adapters.postgres.connection import connect_postgres
from core.adapters.postgres.jobs import PostgresJobStore
from core.adapters.rq_queue import RQQueue
from core.adapters.s3_objects import S3ObjectStore
from core.errors import Misconfigured
from core.settings import StoreSettings


def connect_redis(url: str, *, retries: int = 1, timeout_s: float = 2.0) -> Redis:
    """A client for a redis://, rediss:// or unix:// address; it connects at its first command.

    timeout_s: how long a silent server is waited for; None leaves that to RQ, whose workers block for news.
    Raises Misconfigured for an address that cannot be read.
    """
    try:
        # What RQ is told twice is the same as once.
        return Redis.from_url(  # pyright: ignore[reportUnknownMemberType]
            url,
            socket_connect_timeout=2,
            socket_timeout=timeout_s,
            health_check_interval=30,
            retry=Retry(ExponentialBackoff(cap=0.5, base=0.05), retries),
            retry_on_error=[RedisConnectionError, RedisTimeoutError],
        )
    except ValueError:  # Its words may be a piece of the password.
        raise Misconfigured(
            "GAITWAY_REDIS_URL cannot be read: write redis://:PASSWORD@HOST:PORT/0, the port as a number; in "
            "the password / is %2F, # is %23, ? is %3F and @ is %40."
        ) from None


def connect_s3(  # noqa: PLR0913 # As the SDK's own.
    endpoint: str,
    access_key: str,
    secret_key: str,
    *,
    secure: bool,
    region: str | None,
    retries: int = 2,
    timeout_s: float = 15.0,
) -> Minio:
    """A client for the object store at host:port; it connects at its first request.

    timeout_s: how long a silent store is waited for. It trusts the system's authorities, or those in the file
    that SSL_CERT_FILE names. Raises Misconfigured for an address that cannot be read.
    """
    pool = _ChecksummedUploads(
        maxsize=32,
        timeout=HTTPTimeout(connect=2, read=timeout_s),
        retries=HTTPRetry(
            total=retries,
            read=retries // 2,  # Silence takes longer than a refusal.
            backoff_factor=0.1,
            status_forcelist=[500, 502, 503, 504],
            raise_on_status=False,  # the last answer says more than "too many"
        ),
    )
    try:
        return Minio(
            endpoint,
            access_key=access_key,
            secret_key=secret_key,
            secure=secure,
            region=region,
            http_client=pool,
        )
    except ValueError as error:
        raise Misconfigured(
            f"GAITWAY_S3_ENDPOINT or GAITWAY_S3_REGION cannot be read ({error}): write HOST:PORT, and the "
            "region's short name."
        ) from error


class _ChecksummedUploads(PoolManager):
    """Each upload says its MD5, so that a byte flipped on the way is refused and not stored.

    The SDK does so over TLS alone. Without it, it signs the body's SHA-256, at which SeaweedFS does not look.
    """

    def urlopen(  # type: ignore[override]
        self, method: str, url: str, redirect: bool = True, **said: Any
    ) -> BaseHTTPResponse:
        body = said.get("body")
        if method == "PUT" and isinstance(body, bytes) and "Content-MD5" not in said["headers"]:
            md5 = hashlib.md5(body, usedforsecurity=False).digest()
            said["headers"]["Content-MD5"] = base64.b64encode(md5).decode()
        return super().urlopen(method, url, redirect, **said)


def job_store(settings: StoreSettings, *, pool_size: int = 10) -> PostgresJobStore:
    return PostgresJobStore(connect_postgres(settings.database_url.get_secret_value(), pool_size=pool_size))


def job_queue(settings: StoreSettings) -> RQQueue:
    return RQQueue(connect_redis(settings.redis_url.get_secret_value()))


def object_store(settings: StoreSettings, *, retries: int = 2, timeout_s: float = 15.0) -> S3ObjectStore:
    """The object store; with short limits for a process whose callers wait."""
    client = connect_s3(
        settings.s3_endpoint,
        settings.s3_access_key,
        settings.s3_secret_key.get_secret_value(),
        secure=settings.s3_secure,
        region=settings.s3_region,
        retries=retries,
        timeout_s=timeout_s,
    )
    match settings.s3_style:
        case "auto":
            pass  # As the SDK does by itself.
        case "path":
            client.disable_virtual_style_endpoint()
        case "host":
            client.enable_virtual_style_endpoint()
    try:
        check_bucket_name(settings.s3_bucket)
    except ValueError as error:
        raise Misconfigured(
            f"GAITWAY_S3_BUCKET is wrong: {error}. Set it to the name of a bucket."
        ) from error
    return S3ObjectStore(client, settings.s3_bucket)
