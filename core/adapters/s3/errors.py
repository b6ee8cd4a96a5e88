"""An S3 server's refusals as sentences that name the setting and the remedy."""

import re
from collections.abc import Generator
from contextlib import contextmanager
from xml.etree.ElementTree import ParseError

from minio.error import InvalidResponseError, MinioException, S3Error
from urllib3.exceptions import ConnectTimeoutError, HTTPError, MaxRetryError, NewConnectionError

from core.adapters.causes import causes, reason, tls_refusal
from core.errors import ObjectNotFound, StorageRefuses, StorageUnavailable

_NOT_THERE = {"NoSuchKey", "NoSuchObject"}
_OTHER_REGION = (
    "GAITWAY_S3_REGION is not the region of bucket '{bucket}': set it to that, or leave it out where the "
    "store has no regions."
)
# These last until a setting or something at the store is changed.
_REFUSALS = {
    "InvalidAccessKeyId": "GAITWAY_S3_ACCESS_KEY is not known there: set it to the id of a key that the "
    "store has, or create that key there.",
    "SignatureDoesNotMatch": "GAITWAY_S3_SECRET_KEY does not belong to GAITWAY_S3_ACCESS_KEY: set both from "
    "the same key.",
    "AccessDenied": "GAITWAY_S3_ACCESS_KEY lacks a right in bucket '{bucket}': allow that key to list, read, "
    "write and delete there, or set GAITWAY_S3_BUCKET to a bucket where it may.",
    "NoSuchBucket": "there is no bucket '{bucket}': create it (`aws s3 mb s3://{bucket}` with "
    "--endpoint-url), or set GAITWAY_S3_BUCKET to one that exists.",
    "InvalidBucketName": "'{bucket}' cannot be a bucket's name: set GAITWAY_S3_BUCKET to one of lowercase "
    "letters, digits and hyphens.",
    "AuthorizationHeaderMalformed": _OTHER_REGION,
    "PermanentRedirect": _OTHER_REGION,
    "RequestTimeTooSkewed": "this machine's clock and the store's are more than 15 minutes apart: "
    "synchronise both with NTP (here: `timedatectl set-ntp true`).",
}
# These are about the store as a whole, whichever object was asked for.
_OF_THE_STORE = {"SlowDown", "ServiceUnavailable", "RequestLimitExceeded", "InsufficientStorage"}
# These pass when somebody frees space. SeaweedFS says InternalError for a full disk, MinIO XMinioStorageFull.
_NO_ROOM = {"InternalError", "XMinioStorageFull", "InsufficientStorage"}


@contextmanager
def reaching_s3(bucket: str, key: str = "") -> Generator[None]:
    """Turn the SDK's errors into ObjectNotFound for `key`, StorageRefuses or StorageUnavailable."""
    try:
        yield
    except S3Error as error:
        if error.code in _NOT_THERE:
            raise ObjectNotFound(key) from error
        raise meaning(error.code, error.message, bucket) from error
    except InvalidResponseError as error:
        raise _meaning_of_no_s3(str(error)) from error
    except (ValueError, ParseError) as error:
        # From parsing the answer: a web server's page is no listing, and a flipped byte may be no text.
        raise no_s3("its answer cannot be read") from error
    except (MinioException, HTTPError) as error:
        raise _meaning_of_no_answer(error) from error


def is_of_one_object(error: StorageUnavailable) -> bool:
    """Whether this is how a store may answer, or not answer, for an object that it cannot read."""
    found = error.__cause__
    if isinstance(found, S3Error):
        return found.code not in _OF_THE_STORE
    never_there = (ConnectTimeoutError, NewConnectionError)
    return isinstance(found, HTTPError) and not any(isinstance(one, never_there) for one in causes(found))


def meaning(code: str | None, message: str | None, bucket: str) -> StorageUnavailable:
    """The exception to raise for an S3 error code."""
    if sentence := _REFUSALS.get(code or ""):
        return StorageRefuses(f"The object store refuses ({code}): {sentence.format(bucket=bucket)}")
    if code in _NO_ROOM:
        return StorageUnavailable(
            f"The object store failed ({code}). If this was a write, the store most likely has no room or no "
            "volume to write to: free or add disk space at the store; its own log says more."
        )
    return StorageUnavailable(f"The object store cannot do it now ({code}): {message or 'no reason given'}.")


def no_s3(answer: str) -> StorageRefuses:
    """The exception to raise if another server answers. answer: what it answered, in a word."""
    return StorageRefuses(
        f"The server at GAITWAY_S3_ENDPOINT is not an S3 server ({answer}): set it to the host and port of "
        "the store's S3 interface."
    )


def _meaning_of_no_s3(answer: str) -> StorageUnavailable:
    """For an answer other than S3's XML: from another server, or from a proxy whose server is unavailable."""
    if "HTTPS" in answer:
        return StorageRefuses(
            "The object store at GAITWAY_S3_ENDPOINT wants TLS: set GAITWAY_S3_SECURE=true, or leave it out."
        )
    found = re.search(r"Response code: (\d+)", answer)
    status = int(found[1]) if found else 0
    if status in (502, 503, 504):
        return StorageUnavailable(f"No server behind GAITWAY_S3_ENDPOINT answers now (HTTP {status}).")
    return no_s3(f"HTTP {status}")


def _meaning_of_no_answer(error: MinioException | HTTPError) -> StorageUnavailable:
    without = "set GAITWAY_S3_SECURE=false"
    if refusal := tls_refusal(error, "the object store", "GAITWAY_S3_ENDPOINT", without):
        return StorageRefuses(refusal)
    pool = error.pool if isinstance(error, MaxRetryError) else None
    where = f"{pool.host}:{pool.port} (GAITWAY_S3_ENDPOINT)" if pool else "GAITWAY_S3_ENDPOINT"
    return StorageUnavailable(
        f"The object store does not answer at {where}: {reason(error)}. Start it, or correct the setting."
    )
