"""What an S3 server's refusals mean here."""

from collections.abc import Generator
from contextlib import contextmanager

from minio.error import MinioException, S3Error
from urllib3.exceptions import HTTPError

from core.errors import ObjectNotFound, StorageRefuses, StorageUnavailable

_NOT_THERE = {"NoSuchKey", "NoSuchObject"}
_LOOK_AT = {
    "InvalidAccessKeyId": "GAITWAY_S3_ACCESS_KEY is not known there",
    "SignatureDoesNotMatch": "GAITWAY_S3_SECRET_KEY does not belong to GAITWAY_S3_ACCESS_KEY",
    "AccessDenied": "GAITWAY_S3_ACCESS_KEY may not do this in GAITWAY_S3_BUCKET",
    "NoSuchBucket": "GAITWAY_S3_BUCKET names a bucket that does not exist",
    "AuthorizationHeaderMalformed": "GAITWAY_S3_REGION is not the bucket's region",
    "RequestTimeTooSkewed": "this machine's clock and the store's differ too much",
}


@contextmanager
def reaching_s3(key: str = "") -> Generator[None]:
    """Turn the SDK's errors into ObjectNotFound of `key`, or StorageUnavailable naming what to look at."""
    try:
        yield
    except S3Error as error:
        if error.code in _NOT_THERE:
            raise ObjectNotFound(key) from error
        if remedy := _LOOK_AT.get(error.code or ""):
            raise StorageRefuses(f"The object store refuses ({error.code}): {remedy}.") from error
        reason = error.message or "no reason given"
        raise StorageUnavailable(f"The object store cannot do it now ({error.code}): {reason}.") from error
    except (MinioException, HTTPError) as error:
        raise StorageUnavailable(
            f"The object store does not answer at GAITWAY_S3_ENDPOINT ({type(error).__name__})."
        ) from error
