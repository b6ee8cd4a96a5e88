"""From settings to adapters; for composition roots."""

from minio import Minio
from minio.helpers import check_bucket_name
from redis import Redis
from redis.backoff import ExponentialBackoff
from redis.exceptions import ConnectionError as RedisConnectionError
from redis.exceptions import TimeoutError as RedisTimeoutError
from redis.retry import Retry
from urllib3 import PoolManager
from urllib3 import Retry as HTTPRetry
from urllib3 import Timeout as HTTPTimeout

from core.adapters.redis_jobs import LONGEST_BLOCK_S, RedisJobStore
from core.adapters.rq_queue import RQQueue
from core.adapters.s3_objects import S3ObjectStore
from core.errors import Misconfigured
from core.settings import StoreSettings


def connect_redis(url: str, *, retries: int = 2) -> Redis:
    """A client for a redis://, rediss:// or unix:// address; it connects at its first command.

    An outage is noticed within seconds: a refused connection at once, a silent one after its timeout.
    Raises Misconfigured for an address that cannot be read.
    """
    try:
        # A repeated write is the same as one: each carries an identity that its script knows again.
        return Redis.from_url(  # pyright: ignore[reportUnknownMemberType]
            url,
            socket_connect_timeout=3,
            socket_timeout=LONGEST_BLOCK_S + 5,
            health_check_interval=30,
            max_connections=1000,  # each reader that follows a feed holds one
            retry=Retry(ExponentialBackoff(cap=0.5, base=0.05), retries),
            retry_on_error=[RedisConnectionError, RedisTimeoutError],
        )
    except ValueError:  # Its words may be a piece of the password.
        raise Misconfigured(
            "GAITWAY_REDIS_URL cannot be read: write redis://:PASSWORD@HOST:PORT/0, the port as a number; in "
            "the password / is %2F, # is %23, ? is %3F and @ is %40."
        ) from None


def connect_s3(
    endpoint: str, access_key: str, secret_key: str, *, secure: bool, region: str | None, retries: int = 2
) -> Minio:
    """A client for the object store at host:port; it connects at its first request.

    It trusts the system's authorities, or those in the file that SSL_CERT_FILE names.
    Raises Misconfigured for an address that cannot be read.
    """
    pool = PoolManager(
        maxsize=32,
        timeout=HTTPTimeout(connect=3, read=15),
        retries=HTTPRetry(
            total=retries,
            read=min(1, retries),
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


def job_store(settings: StoreSettings) -> RedisJobStore:
    return RedisJobStore(connect_redis(settings.redis_url.get_secret_value()))


def job_queue(settings: StoreSettings) -> RQQueue:
    return RQQueue(connect_redis(settings.redis_url.get_secret_value()))


def object_store(settings: StoreSettings, *, retries: int = 2) -> S3ObjectStore:
    client = connect_s3(
        settings.s3_endpoint,
        settings.s3_access_key,
        settings.s3_secret_key.get_secret_value(),
        secure=settings.s3_secure,
        region=settings.s3_region,
        retries=retries,
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
