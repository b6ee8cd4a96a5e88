"""What every ObjectStore promises, on each of them."""

import hashlib
import io
import random
import resource
import time
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, cast
from zipfile import BadZipFile

import pytest
from minio import Minio
from minio.datatypes import Object

from core.adapters.s3.connection import connect_s3
from core.adapters.s3.objects import S3ObjectStore
from core.errors import ObjectNotFound, Rejected, StorageUnavailable
from core.storage.objects import ObjectInfo, ObjectStore
from gaitway.service.embedded.weed import REGION, Weed

MIB = 2**20
BAD_KEYS = [
    "",
    "/a",
    "a/",
    "a//b",
    "a/../b",
    "./a",
    "a\0b",
    "a\nb",
    "\ud800",
    "k" * 256,
    "é" * 128,
    "k/" * 513 + "k",
]
ODD_KEYS = [
    "a b",
    "é/日本/🐜",
    "a+b&c=d?e#f%41",
    "a.b/..c/d..",
    "x" * 255,
    "'\"<>&",
    "/".join(["k" * 127] * 8),
]


class TestEveryStore:
    def test_what_was_put_is_read_back(self, objects: ObjectStore) -> None:
        objects.put("jobs/1/spec.json", b'{"a": 1}', media_type="application/json")
        assert objects.get("jobs/1/spec.json") == b'{"a": 1}'
        assert objects.info("jobs/1/spec.json") == ObjectInfo("jobs/1/spec.json", 8, "application/json")

    def test_an_object_may_be_empty(self, objects: ObjectStore) -> None:
        objects.put("empty", b"")
        assert objects.get("empty") == b""
        assert objects.info("empty").size == 0
        with objects.open("empty", 0, 10) as pieces:
            assert list(pieces) == []

    def test_a_put_replaces(self, objects: ObjectStore) -> None:
        objects.put("a", b"long ago", media_type="text/plain")
        objects.put("a", b"now")
        assert objects.get("a") == b"now"
        assert objects.info("a") == ObjectInfo("a", 3)

    def test_it_is_told_when_an_object_was_put(self, objects: ObjectStore) -> None:
        # By a clock of the store's own, whose answers may be whole seconds.
        before = datetime.now(UTC) - timedelta(seconds=2)
        objects.put("a", b"x")
        after = datetime.now(UTC) + timedelta(seconds=2)
        [listed] = objects.list("a")
        for info in (listed, objects.info("a")):
            assert info.modified_at is not None
            assert before < info.modified_at < after

    def test_two_looks_at_an_object_are_equal_whenever_it_was_put(self) -> None:
        assert ObjectInfo("a", 1, modified_at=datetime.now(UTC)) == ObjectInfo("a", 1)

    @pytest.mark.parametrize(
        "key", ["a b", "é/日本/🐜", "a+b&c=d?e#f%41", "a.b/..c/d..", "x" * 200, "'\"<>&"]
    )
    def test_odd_names_are_kept_as_they_are(self, objects: ObjectStore, key: str) -> None:
        objects.put(key, b"x")
        assert objects.get(key) == b"x"
        assert [found.key for found in objects.list("")] == [key]
        objects.delete_prefix(key)
        assert list(objects.list("")) == []

    @pytest.mark.parametrize("key", BAD_KEYS)
    def test_a_name_that_no_store_would_keep_is_refused(
        self, objects: ObjectStore, key: str, tmp_path: Path
    ) -> None:
        with pytest.raises(Rejected):
            objects.put(key, b"x")
        with pytest.raises(Rejected):
            objects.put_file(key, tmp_path)
        for read in (objects.get, objects.info, objects.open):
            with pytest.raises(ObjectNotFound):
                read(key)
        assert list(objects.list("")) == []

    def test_what_is_not_there_is_not_found_at_once(self, objects: ObjectStore) -> None:
        for read in (objects.get, objects.info, objects.open):
            with pytest.raises(ObjectNotFound, match="nowhere"):
                read("nowhere")
        with pytest.raises(ObjectNotFound):
            objects.open("nowhere", 0, 0)

    @pytest.mark.parametrize(
        ("start", "length", "expected"),
        [
            (0, None, b"0123456789"),
            (0, 4, b"0123"),
            (3, 4, b"3456"),
            (3, None, b"3456789"),
            (9, 1, b"9"),
            (8, 100, b"89"),  # as far as it goes
            (10, None, b""),  # begins at the end
            (10, 5, b""),
            (99, 5, b""),
            (4, 0, b""),
        ],
    )
    def test_a_part_is_read(
        self, objects: ObjectStore, start: int, length: int | None, expected: bytes
    ) -> None:
        objects.put("digits", b"0123456789")
        with objects.open("digits", start, length) as pieces:
            assert b"".join(pieces) == expected

    def test_files_go_in_and_come_out_in_pieces(self, objects: ObjectStore, tmp_path: Path) -> None:
        # 20 MiB and a bit: several parts of an upload, and pieces of 1 MiB at most.
        body = random.Random(0).randbytes(20 * MIB + 17)
        (tmp_path / "film").write_bytes(body)
        objects.put_file("film.mp4", tmp_path / "film", media_type="video/mp4")
        assert objects.info("film.mp4") == ObjectInfo("film.mp4", len(body), "video/mp4")
        with objects.open("film.mp4") as pieces:
            sizes, digest = [], hashlib.sha256()
            for piece in pieces:
                sizes.append(len(piece))
                digest.update(piece)
        assert digest.hexdigest() == hashlib.sha256(body).hexdigest()
        assert max(sizes) <= MIB
        with objects.open("film.mp4", 9 * MIB, 100) as pieces:
            assert b"".join(pieces) == body[9 * MIB : 9 * MIB + 100]

    def test_a_stream_gives_the_bytes_from_where_it_is(self, objects: ObjectStore) -> None:
        body = random.Random(0).randbytes(9 * MIB + 17)
        stream = io.BytesIO(body)
        stream.seek(16)
        objects.put_stream("part", stream, len(body) - 17, media_type="video/mp4")
        assert objects.info("part") == ObjectInfo("part", len(body) - 17, "video/mp4")
        assert objects.get("part") == body[16:-1]
        objects.put_stream("empty", io.BytesIO(), 0)
        assert objects.get("empty") == b""

    def test_a_stream_that_breaks_stores_nothing(self, objects: ObjectStore) -> None:
        class Broken(io.BytesIO):
            def read(self, size: int | None = -1) -> bytes:
                if self.tell() + (size or 0) > 10 * MIB:
                    raise BadZipFile("broken")
                return super().read(size)

        with pytest.raises(BadZipFile, match="broken"):
            objects.put_stream("part", Broken(bytes(20 * MIB)), 20 * MIB)
        assert list(objects.list("")) == []

    def test_a_reader_may_leave_early(self, objects: ObjectStore) -> None:
        objects.put("big", bytes(5 * MIB))
        for _ in range(40):  # more often than a pool has connections
            with objects.open("big") as pieces:
                assert len(next(iter(pieces))) <= MIB
        assert objects.get("big") == bytes(5 * MIB)

    def test_a_file_that_is_not_there_is_the_callers_mistake(
        self, objects: ObjectStore, tmp_path: Path
    ) -> None:
        with pytest.raises(FileNotFoundError):
            objects.put_file("a", tmp_path / "nowhere")

    def test_listing_is_by_prefix_in_order_of_the_keys(self, objects: ObjectStore) -> None:
        # "-" sorts before "/", though a store that keeps folders lists the folder's contents together.
        for key in ("jobs/a/2", "jobs/a-b", "jobs/a/1", "jobs/b", "other"):
            objects.put(key, key.encode())
        assert list(objects.list("jobs/")) == [
            ObjectInfo("jobs/a-b", 8),
            ObjectInfo("jobs/a/1", 8),
            ObjectInfo("jobs/a/2", 8),
            ObjectInfo("jobs/b", 6),
        ]
        assert [found.key for found in objects.list("jobs/a")] == ["jobs/a-b", "jobs/a/1", "jobs/a/2"]
        assert list(objects.list("nothing/")) == []

    def test_deleting_takes_what_is_under_the_prefix_and_nothing_else(self, objects: ObjectStore) -> None:
        for key in ("jobs/1/a", "jobs/1/b/c", "jobs/10/a", "jobs/2"):
            objects.put(key, b"x")
        objects.delete_prefix("jobs/1/")
        assert [found.key for found in objects.list("")] == ["jobs/10/a", "jobs/2"]
        objects.delete_prefix("jobs/1/")

    def test_deleting_by_key_takes_these_alone(self, objects: ObjectStore) -> None:
        for key in ("a", "ab", "b"):
            objects.put(key, b"x")
        objects.delete(["a", "missing"])
        assert [found.key for found in objects.list("")] == ["ab", "b"]


class TestS3:
    def test_a_long_listing_has_everything(self, object_store: S3ObjectStore) -> None:
        # S3 answers with at most 1000 keys at a time, and deletes as many.
        for number in range(1005):
            object_store.put(f"many/{number:04d}", b"")
        assert [found.key for found in object_store.list("many/")] == [f"many/{n:04d}" for n in range(1005)]
        object_store.delete_prefix("many/")
        assert list(object_store.list("")) == []

    @pytest.mark.parametrize("in_folders", [True, False])
    def test_a_listing_in_either_order_is_read_a_child_at_a_time(self, in_folders: bool) -> None:
        # Servers that keep objects in folders have a/… before a-b; others go by the bytes of the keys.
        children = [("a/1", "a/2", "a-b", "a.c/1", "ab"), ("b/x/1", "b/x-y"), ("c",)]
        ordered = [sorted(keys) for keys in children]
        num_given = 0

        class Client:
            def list_objects(self, *_: object, **__: object) -> Iterator[Object]:
                nonlocal num_given
                for keys in children if in_folders else ordered:
                    for key in keys:
                        num_given += 1
                        yield Object("bucket", f"jobs/{key}", size=1)

        listed = S3ObjectStore(cast("Minio", Client()), "bucket").list("jobs/")
        assert num_given <= len(children[0]) + 1  # The first child, and where the second begins.
        assert [info.key for info in listed] == [f"jobs/{key}" for keys in ordered for key in keys]

    def test_a_large_file_is_never_held_in_memory(self, object_store: S3ObjectStore, tmp_path: Path) -> None:
        before_kib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        size = 120 * MIB
        with (tmp_path / "large").open("wb") as file:
            file.truncate(size)
        object_store.put_file("large", tmp_path / "large")
        with object_store.open("large") as pieces:
            assert sum(len(piece) for piece in pieces) == size
        grown_mib = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before_kib) / 1024
        assert grown_mib < 60

    def test_an_upload_that_never_ended_is_removed_once_it_is_old(self, object_store: S3ObjectStore) -> None:
        killed = "jobs/1/imported/hash/a b.msgpack"
        begun = [begin_upload(object_store, key) for key in (killed, "models/hash/source", "of/others")]
        object_store.put_stream("jobs/1/whole", io.BytesIO(bytes(9 * MIB)), 9 * MIB)
        now = datetime.now(UTC)
        assert object_store.end_uploads("jobs/", now - timedelta(minutes=5)) == 0
        assert unfinished(object_store) == set(begun)
        # The store's clock says whole seconds.
        assert object_store.end_uploads("jobs/", now + timedelta(seconds=2)) == 1
        assert unfinished(object_store) == set(begun[1:])
        assert object_store.end_uploads("jobs/", now + timedelta(seconds=2)) == 0
        assert [found.key for found in object_store.list("")] == ["jobs/1/whole"]

    def test_the_bucket_may_be_there_already(self, object_store: S3ObjectStore) -> None:
        object_store.put("a", b"x")
        object_store.ensure_bucket()
        assert object_store.get("a") == b"x"

    @pytest.mark.parametrize(
        ("access_key", "secret_key", "bucket", "setting"),
        [
            ("", "wrong-secret", "", "GAITWAY_S3_SECRET_KEY"),
            ("nobody", "", "", "GAITWAY_S3_ACCESS_KEY"),
            ("", "", "no-such-bucket", "GAITWAY_S3_BUCKET"),
        ],
    )
    def test_a_refusal_names_the_setting(
        self, weed: Weed, access_key: str, secret_key: str, bucket: str, setting: str
    ) -> None:
        client = connect_s3(
            weed.endpoint,
            access_key or weed.access_key,
            secret_key or weed.secret_key,
            secure=False,
            region=REGION,
        )
        store = S3ObjectStore(client, bucket or weed.bucket)
        with pytest.raises(StorageUnavailable, match=setting):
            store.get("a")
        with pytest.raises(StorageUnavailable, match=setting):
            list(store.list(""))

    def test_every_call_says_within_seconds_that_the_store_is_gone(self, tmp_path: Path) -> None:
        with Weed(tmp_path) as server:
            store = store_of(server)
            store.put("a", bytes(8 * MIB))
            reading = store.open("a")
            server.stop()
        (tmp_path / "file").write_bytes(b"x")
        calls = [
            lambda: store.put("a", b"x"),
            lambda: store.put_file("a", tmp_path / "file"),
            lambda: store.get("a"),
            lambda: store.open("a"),
            lambda: store.info("a"),
            lambda: store.list("a"),
            lambda: store.delete_prefix("a"),
            lambda: store.end_uploads("a", datetime.now(UTC)),
            store.ensure_bucket,
            lambda: read_all(reading),
        ]
        for call in calls:
            began = time.monotonic()
            with pytest.raises(StorageUnavailable, match="GAITWAY_S3_ENDPOINT"):
                call()
            assert time.monotonic() - began < 5


def begin_upload(store: S3ObjectStore, key: str) -> str:
    """Upload the first part of an object, as a process that was killed then."""
    client: Any = store._client
    upload = client._create_multipart_upload(store._bucket, key, {})
    client._upload_part(store._bucket, key, bytes(5 * MIB), {}, upload, 1)
    return key


def unfinished(store: S3ObjectStore) -> set[str]:
    client: Any = store._client
    return {upload.object_name for upload in client._list_multipart_uploads(store._bucket).uploads}


def store_of(server: Weed) -> S3ObjectStore:
    client = connect_s3(server.endpoint, server.access_key, server.secret_key, secure=False, region=REGION)
    return S3ObjectStore(client, server.bucket)


def read_all(reading: object) -> None:
    with reading as pieces:  # type: ignore[attr-defined]
        for _ in pieces:
            pass
