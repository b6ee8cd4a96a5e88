"""Compiled programs in the object store, on each store in turn."""

import zlib
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import pytest

from core.errors import StorageUnavailable
from core.jobs.job import utc_now
from core.storage import keys
from core.storage.objects import ObjectStore
from worker.compile_cache import remote
from worker.compile_cache.local import names
from worker.compile_cache.remote import SharedCache

NOW = utc_now()


class Machine:
    """One machine's folder."""

    def __init__(
        self, folder: Path, objects: ObjectStore, kind: str = "cpu-1", environment: str = "ant"
    ) -> None:
        self.kept, self.room = folder / "cache", folder / "spool"
        self.kept.mkdir(parents=True)
        self.room.mkdir()
        self.shared = SharedCache(objects, kind, environment)

    def has(self, **bodies: bytes) -> "Machine":
        for name, body in bodies.items():
            (self.kept / name).write_bytes(body)
        return self

    def stores(self, *new: str, at: datetime = NOW) -> int:
        return self.shared.store(self.kept, new, at)

    def fetches(self) -> dict[str, bytes]:
        """All that it has then."""
        self.shared.fetch(self.kept, self.room)
        assert list(self.room.iterdir()) == []
        return {name: (self.kept / name).read_bytes() for name in names(self.kept)}


@pytest.fixture
def first(tmp_path: Path, objects: ObjectStore) -> Machine:
    return Machine(tmp_path / "first", objects)


@pytest.fixture
def second(tmp_path: Path, objects: ObjectStore) -> Machine:
    return Machine(tmp_path / "second", objects)


def test_what_one_stores_the_other_fetches(first: Machine, second: Machine) -> None:
    (first.kept / "warp" / "wp_a").mkdir(parents=True)
    (first.kept / "warp" / "wp_a" / "a.meta").write_bytes(b"{}")
    assert first.has(a=b"A").stores("a", "warp/wp_a/a.meta") == 2
    assert second.has(b=b"B").fetches() == {"a": b"A", "b": b"B", "warp/wp_a/a.meta": b"{}"}
    assert second.stores("a", "b") == 1  # Of a there is one already.


def test_what_cannot_be_used_is_not_fetched(first: Machine, tmp_path: Path, objects: ObjectStore) -> None:
    first.has(a=b"A").stores("a")
    assert Machine(tmp_path / "gpu", objects, kind="gpu-1").fetches() == {}
    assert Machine(tmp_path / "other", objects, environment="humanoid").fetches() == {}


def test_what_made_room_meanwhile_is_passed_over(first: Machine) -> None:
    assert first.has(a=b"A").stores("a", "gone") == 1


def test_the_newest_come_first_and_not_too_many(
    first: Machine, second: Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    first.has(old=b"12345", new=b"12345", newest=b"12345")
    for age, name in enumerate(["newest", "new", "old"]):
        first.stores(name, at=NOW - timedelta(hours=age))
    monkeypatch.setattr(remote, "_MAX_FETCHED_BYTES", 10)
    assert set(second.fetches()) == {"new", "newest"}


def test_the_oldest_make_room_whatever_they_are_of(
    first: Machine, tmp_path: Path, objects: ObjectStore
) -> None:
    objects.put(keys.artifact("x", 1, "0" * 64, "video.mp4"), b"is no business of the cache")
    Machine(tmp_path / "outdated", objects, kind="cpu-0").has(z=b"12345").stores(
        "z", at=NOW - timedelta(days=9)
    )
    first.has(a=b"12345", b=b"12345").stores("b", at=NOW - timedelta(hours=1))
    first.stores("a")
    first.shared.keep_within(15)
    assert len(list(objects.list(keys.caches()))) == 3
    first.shared.keep_within(14)
    assert [info.key[-2:] for info in objects.list(keys.caches())] == ["/b", "/a"]
    first.shared.keep_within(5)
    assert [info.key[-2:] for info in objects.list("")] == ["/a", "p4"]


class Breaking:
    """A store whose answers stop half-way."""

    def __init__(self, objects: ObjectStore) -> None:
        self._objects = objects

    def __getattr__(self, name: str) -> Any:
        return getattr(self._objects, name)

    def open(self, key: str) -> AbstractContextManager[Iterator[bytes]]:
        @contextmanager
        def half() -> Iterator[Iterator[bytes]]:
            yield self._pieces(self._objects.get(key))

        return half()

    def _pieces(self, body: bytes) -> Iterator[bytes]:
        yield body[: len(body) // 2]
        raise StorageUnavailable("The test cut the line.")


def test_what_arrives_in_half_is_never_seen(first: Machine, tmp_path: Path, objects: ObjectStore) -> None:
    first.has(a=b"a whole program").stores("a")
    cut_off = Machine(tmp_path / "cut_off", Breaking(objects))  # pyright: ignore[reportArgumentType]
    with pytest.raises(StorageUnavailable):
        cut_off.fetches()
    assert names(cut_off.kept) == set()
    assert names(cut_off.room) == set()


def test_what_was_stored_damaged_is_left_there(first: Machine, second: Machine) -> None:
    body = zlib.compress(b"a program")
    first.has(**{"f-cache": body[:-2], "g-cache": body}).stores("f-cache", "g-cache")
    assert second.fetches() == {"g-cache": body}


def test_a_name_that_leads_out_of_the_folder_is_passed_over(second: Machine) -> None:
    class Odd:
        def list(self, prefix: str) -> Iterator[Any]:
            return iter([remote.ObjectInfo(f"{prefix}20261121T091500Z/../../out", 1)])

    assert SharedCache(Odd(), "cpu-1", "ant").fetch(second.kept, second.room) == 0  # pyright: ignore[reportArgumentType]
