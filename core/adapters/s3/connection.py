"""A client for S3, apart from the other stores for processes that need only this one."""

import base64
import hashlib
import ssl
from collections.abc import Generator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import Any

from minio import Minio
from minio.helpers import ObjectWriteResult
from urllib3 import BaseHTTPResponse, PoolManager
from urllib3 import Retry as HTTPRetry
from urllib3 import Timeout as HTTPTimeout

from core.errors import Misconfigured

# core/adapters/s3/reading.py decides when to ask again for an object.
_ONE_TRY = HTTPRetry(total=1, connect=1, read=0, status=0, other=0, backoff_factor=0.1, raise_on_status=False)
_patience_s = ContextVar[float | None]("patience_s", default=None)


@contextmanager
def waiting(patience_s: float) -> Generator[None]:
    """Objects that are asked for within this are given up after so many seconds without a byte."""
    before = _patience_s.set(patience_s)
    try:
        yield
    finally:
        _patience_s.reset(before)


class _Pool(PoolManager):
    """Asks for an object, whose body alone is streamed, once and with the patience of its reader."""

    def urlopen(self, method: str, url: str, redirect: bool = True, **kw: Any) -> BaseHTTPResponse:  # type: ignore[override]
        if kw.get("preload_content") is False:
            kw["retries"] = _ONE_TRY
            if (patience_s := _patience_s.get()) is not None:
                kw["timeout"] = HTTPTimeout(connect=2, read=patience_s)
        return super().urlopen(method, url, redirect, **kw)


def connect_s3(  # noqa: PLR0913 # As the SDK's own.
    endpoint: str,
    access_key: str,
    secret_key: str,
    *,
    secure: bool,
    region: str | None,
    authorities: Path | None = None,
    retries: int = 2,
    timeout_s: float = 15.0,
) -> Minio:
    """A client for the object store at host:port; it connects at its first request.

    authorities: a PEM file of authorities to trust besides the system's. timeout_s: how long to wait for a
    silent store, but for an object's bytes. Raises Misconfigured for an address that cannot be read.
    """
    pool = _Pool(
        maxsize=32,
        ssl_context=None if authorities is None else trusting(authorities),
        timeout=HTTPTimeout(connect=2, read=timeout_s),
        retries=HTTPRetry(
            total=retries,
            read=retries // 2,  # Silence takes longer than a refusal.
            backoff_factor=0.1,
            status_forcelist=[500, 502, 503, 504],
            raise_on_status=False,  # The last answer says more than "too many".
        ),
    )
    try:
        return _ChecksummedUploads(
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


def trusting(authorities: Path) -> ssl.SSLContext:
    """A TLS context that trusts the authorities in the PEM file besides the system's."""
    context = ssl.create_default_context()
    context.load_verify_locations(authorities)
    return context


class _ChecksummedUploads(Minio):
    """Sends and signs the MD5 of each upload: the store refuses a body with a flipped byte.

    The SDK does so only over TLS. Without TLS it signs the body's SHA-256, which SeaweedFS does not check.
    """

    def _put_object(
        self,
        bucket_name: str,
        object_name: str,
        data: bytes,
        headers: dict[str, Any] | None = None,
        query_params: dict[str, Any] | None = None,
    ) -> ObjectWriteResult:
        md5 = hashlib.md5(data, usedforsecurity=False).digest()
        signed = {**(headers or {}), "Content-MD5": base64.b64encode(md5).decode()}
        return super()._put_object(bucket_name, object_name, data, signed, query_params)
