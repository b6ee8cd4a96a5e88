"""Objects on an S3 server, through the minio SDK."""

from collections.abc import Generator, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from io import BytesIO
from pathlib import Path

from minio import Minio
from minio.deleteobjects import DeleteObject
from minio.error import S3Error
from urllib3.response import BaseHTTPResponse

from core.adapters.object_keys import PIECE_BYTES, check_readable, check_writable
from core.adapters.s3_errors import reaching_s3
from core.errors import StorageUnavailable
from core.storage.objects import ObjectInfo

_ANY = "application/octet-stream"
_PART_BYTES = 8 * 2**20


class S3ObjectStore:
    """An ObjectStore in one bucket; thread-safe."""

    def __init__(self, client: Minio, bucket: str) -> None:
        self._client = client
        self._bucket = bucket

    def ensure_bucket(self) -> None:
        """Make the bucket unless it is there. Raises StorageUnavailable."""
        with reaching_s3():
            if not self._client.bucket_exists(self._bucket):
                self._make_bucket()

    def put(self, key: str, body: bytes, *, media_type: str = _ANY) -> None:
        check_writable(key)
        with reaching_s3(key):
            self._client.put_object(self._bucket, key, BytesIO(body), len(body), content_type=media_type)

    def put_file(self, key: str, path: Path, *, media_type: str = _ANY) -> None:
        check_writable(key)
        with reaching_s3(key):
            self._client.fput_object(
                self._bucket, key, str(path), content_type=media_type, part_size=_PART_BYTES
            )

    def get(self, key: str) -> bytes:
        with self.open(key) as pieces:
            return b"".join(pieces)

    def open(
        self, key: str, start: int = 0, length: int | None = None
    ) -> AbstractContextManager[Iterator[bytes]]:
        check_readable(key)
        if length == 0:
            self.info(key)
            return nullcontext(iter(()))
        with reaching_s3(key):
            try:
                response = self._client.get_object(self._bucket, key, offset=start, length=length or 0)
            except S3Error as error:
                if error.code == "InvalidRange":  # begins at or after the end: nothing is there
                    return nullcontext(iter(()))
                raise
        return _streaming(key, response)

    def info(self, key: str) -> ObjectInfo:
        check_readable(key)
        with reaching_s3(key):
            found = self._client.stat_object(self._bucket, key)
        return ObjectInfo(key, found.size or 0, found.content_type or _ANY)

    def list(self, prefix: str) -> Iterator[ObjectInfo]:
        with reaching_s3(prefix):
            listed = list(self._client.list_objects(self._bucket, prefix=prefix, recursive=True))
        # Servers that keep objects in folders list them folder by folder, which is another order.
        found = [ObjectInfo(item.object_name, item.size or 0) for item in listed if item.object_name]
        return iter(sorted(found, key=lambda item: item.key))

    def delete_prefix(self, prefix: str) -> None:
        keys = [DeleteObject(item.key) for item in self.list(prefix)]
        with reaching_s3(prefix):
            failures = list(self._client.remove_objects(self._bucket, keys))
        if failures:
            raise StorageUnavailable(
                f"The object store kept {len(failures)} objects it was to delete: {failures[0].message}"
            )

    def _make_bucket(self) -> None:
        try:
            self._client.make_bucket(self._bucket)
        except S3Error as error:
            # Somebody else was faster.
            if error.code not in ("BucketAlreadyOwnedByYou", "BucketAlreadyExists"):
                raise


@contextmanager
def _streaming(key: str, response: BaseHTTPResponse) -> Generator[Iterator[bytes]]:
    try:
        yield _pieces(key, response)
    finally:
        response.close()
        response.release_conn()


def _pieces(key: str, response: BaseHTTPResponse) -> Iterator[bytes]:
    with reaching_s3(key):
        yield from response.stream(PIECE_BYTES)
