"""Objects on an S3 server, through the minio SDK."""

import time
from collections.abc import Generator, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from datetime import datetime
from io import BytesIO
from itertools import chain
from pathlib import Path
from typing import IO, Any, BinaryIO, cast

from minio import Minio
from minio.datatypes import ListMultipartUploadsResult
from minio.deleteobjects import DeleteObject
from minio.error import S3Error

from core.adapters.s3.errors import meaning, reaching_s3
from core.adapters.s3.keys import check_readable, check_writable
from core.adapters.s3.reading import Reading
from core.adapters.timing import Observe, timed, unobserved
from core.errors import ObjectDamaged, ObjectNotFound, StorageRefuses
from core.storage.objects import ObjectInfo

_ANY = "application/octet-stream"
_PART_BYTES = 8 * 2**20
_KEPT_IN_MIND_S, _MOST_KEPT_IN_MIND = 60.0, 1000


class S3ObjectStore:
    """An ObjectStore in one bucket; thread-safe."""

    def __init__(self, client: Minio, bucket: str, observe: Observe = unobserved) -> None:
        self._client = client
        self._bucket = bucket
        self._observe = observe
        self._damaged: dict[str, float] = {}  # Until when that is believed.

    def ensure_bucket(self) -> None:
        """Create the bucket unless it exists. Raises StorageUnavailable."""
        with self._reaching():
            if not self._client.bucket_exists(self._bucket):
                self._make_bucket()

    def put(self, key: str, body: bytes, *, media_type: str = _ANY) -> None:
        check_writable(key)
        self._damaged.pop(key, None)
        with self._timed(), self._reaching(key):
            self._client.put_object(self._bucket, key, BytesIO(body), len(body), content_type=media_type)

    def put_file(self, key: str, path: Path, *, media_type: str = _ANY) -> None:
        check_writable(key)
        with path.open("rb") as file:
            self.put_stream(key, file, path.stat().st_size, media_type=media_type)

    def put_stream(self, key: str, stream: IO[bytes], size: int, *, media_type: str = _ANY) -> None:
        check_writable(key)
        self._damaged.pop(key, None)
        with self._timed(), self._reaching(key):
            self._client.put_object(
                self._bucket,
                key,
                cast("BinaryIO", stream),
                size,
                content_type=media_type,
                part_size=_PART_BYTES,
            )

    def get(self, key: str) -> bytes:
        with self.open(key) as pieces:
            return b"".join(pieces)

    def open(
        self, key: str, start: int = 0, length: int | None = None, *, size: int | None = None
    ) -> AbstractContextManager[Iterator[bytes]]:
        check_readable(key)
        if length == 0:
            self.info(key)
            return nullcontext(iter(()))
        if self._damaged.get(key, 0.0) > time.monotonic():
            raise ObjectDamaged(key, "the object store did not give its bytes in the last minute")
        end = None if length is None else start + length
        reading = Reading(self._client, self._bucket, key, start, end, size)
        with self._noting(key), self._timed():
            reading.begin()
        return self._streaming(key, reading)

    def info(self, key: str) -> ObjectInfo:
        check_readable(key)
        try:
            with self._timed(), self._reaching(key):
                found = self._client.stat_object(self._bucket, key)
        except (ObjectNotFound, StorageRefuses):
            # The answer to a HEAD has no body to say that the bucket is missing, or what is refused.
            self.list(key)
            raise
        return ObjectInfo(key, found.size or 0, found.content_type or _ANY, modified_at=found.last_modified)

    def list(self, prefix: str) -> Iterator[ObjectInfo]:
        found = _in_key_order(self._listed(prefix), prefix)
        first = next(found, None)  # So that a refusal is raised here, not where the listing is read.
        return iter(()) if first is None else chain([first], found)

    def delete_prefix(self, prefix: str) -> None:
        self.delete([item.key for item in self.list(prefix)])

    def delete(self, keys: Iterable[str]) -> None:
        with self._timed(), self._reaching():
            named = [DeleteObject(key) for key in keys]
            failures = list(self._client.remove_objects(self._bucket, named))
        if failures:
            raise meaning(failures[0].code, failures[0].message, self._bucket)

    def end_uploads(self, prefix: str, before: datetime) -> int:
        # The first page, of 1000: SeaweedFS does not say where the next one begins. The SDK, whose version is
        # pinned, has these two requests as private methods alone.
        client: Any = self._client
        with self._reaching(prefix):
            found: ListMultipartUploadsResult = client._list_multipart_uploads(self._bucket, prefix=prefix)
            old = [one for one in found.uploads if one.initiated_time and one.initiated_time < before]
            for one in old:
                try:
                    client._abort_multipart_upload(self._bucket, one.object_name, one.upload_id)
                except S3Error as error:
                    if error.code != "NoSuchUpload":  # Another process was faster.
                        raise
        return len(old)

    def _listed(self, prefix: str) -> Generator[ObjectInfo]:
        """The objects in the server's order, fetched in pages of 1000."""
        with self._reaching(prefix):
            for item in self._client.list_objects(self._bucket, prefix=prefix, recursive=True):
                if item.object_name:
                    yield ObjectInfo(item.object_name, item.size or 0, modified_at=item.last_modified)

    @contextmanager
    def _streaming(self, key: str, reading: Reading) -> Generator[Iterator[bytes]]:
        def pieces() -> Iterator[bytes]:
            with self._noting(key):
                yield from reading.pieces()

        try:
            yield pieces()
        finally:
            reading.close()

    @contextmanager
    def _noting(self, key: str) -> Generator[None]:
        """Keep in mind for a while that it is damaged: finding that out takes seconds."""
        try:
            yield
        except ObjectDamaged:
            if len(self._damaged) >= _MOST_KEPT_IN_MIND:
                self._damaged.clear()
            self._damaged[key] = time.monotonic() + _KEPT_IN_MIND_S
            raise

    def _timed(self) -> AbstractContextManager[None]:
        """Of a read, until its first bytes; an upload takes longer the larger it is."""
        return timed(self._observe, "objects")

    def _reaching(self, key: str = "") -> AbstractContextManager[None]:
        return reaching_s3(self._bucket, key)

    def _make_bucket(self) -> None:
        try:
            self._client.make_bucket(self._bucket)
        except S3Error as error:
            # Another process was faster.
            if error.code not in ("BucketAlreadyOwnedByYou", "BucketAlreadyExists"):
                raise


def _in_key_order(listed: Iterable[ObjectInfo], prefix: str) -> Generator[ObjectInfo]:
    """Sorted by key, holding one child of `prefix` in memory at a time.

    Servers that keep objects in folders list them folder by folder: jobs/a/1 before jobs/a-b. That differs
    from key order only among consecutive children whose names start with the name of the first.
    """
    held: list[ObjectInfo] = []
    begins = ""
    for info in listed:
        child = info.key[len(prefix) :].partition("/")[0]
        if held and not child.startswith(begins):
            yield from sorted(held, key=lambda info: info.key)
            held.clear()
        if not held:
            begins = child
        held.append(info)
    yield from sorted(held, key=lambda info: info.key)
