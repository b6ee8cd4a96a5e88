"""Makes adapters from settings; for composition roots."""

from minio.helpers import check_bucket_name
from redis import Redis
from redis.backoff import ExponentialBackoff
from redis.exceptions import ConnectionError as RedisConnectionError
from redis.exceptions import TimeoutError as RedisTimeoutError
from redis.retry import Retry

from core.adapters.postgres.engine import connect_postgres
from core.adapters.postgres.store import PostgresJobStore
from core.adapters.rq.queue import RQQueue
from core.adapters.s3.connection import connect_s3
from core.adapters.s3.objects import S3ObjectStore
from core.adapters.timing import Observe, unobserved
from core.errors import Misconfigured
from core.settings import StoreSettings


def connect_redis(url: str, *, retries: int = 1, timeout_s: float = 2.0) -> Redis:
    """A client for a redis://, rediss:// or unix:// address; it connects at its first command.

    timeout_s: how long to wait for a silent server; None leaves that to RQ, whose workers block on a read.
    Raises Misconfigured for an address that cannot be read.
    """
    try:
        # A command may be retried: what RQ receives twice has the same effect as once.
        return Redis.from_url(  # pyright: ignore[reportUnknownMemberType]
            url,
            socket_connect_timeout=2,
            socket_timeout=timeout_s,
            health_check_interval=30,
            retry=Retry(ExponentialBackoff(cap=0.5, base=0.05), retries),
            retry_on_error=[RedisConnectionError, RedisTimeoutError],
        )
    except ValueError:  # Its message may hold a piece of the password.
        raise Misconfigured(
            "GAITWAY_REDIS_URL cannot be read: write redis://:PASSWORD@HOST:PORT/0, the port as a number; in "
            "the password / is %2F, # is %23, ? is %3F and @ is %40."
        ) from None


def job_store(
    settings: StoreSettings, *, pool_size: int = 10, observe: Observe = unobserved
) -> PostgresJobStore:
    engine = connect_postgres(settings.database_url.get_secret_value(), pool_size=pool_size)
    return PostgresJobStore(engine, observe=observe)


def job_queue(settings: StoreSettings, *, observe: Observe = unobserved) -> RQQueue:
    return RQQueue(connect_redis(settings.redis_url.get_secret_value()), observe)


def object_store(
    settings: StoreSettings, *, retries: int = 2, timeout_s: float = 15.0, observe: Observe = unobserved
) -> S3ObjectStore:
    """The object store; a process whose callers wait passes short limits."""
    client = connect_s3(
        settings.s3_endpoint,
        settings.s3_access_key,
        settings.s3_secret_key.get_secret_value(),
        secure=settings.s3_secure,
        region=settings.s3_region,
        authorities=settings.tls_ca,
        retries=retries,
        timeout_s=timeout_s,
    )
    match settings.s3_style:
        case "auto":
            pass  # The SDK's own choice.
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
    return S3ObjectStore(client, settings.s3_bucket, observe)
