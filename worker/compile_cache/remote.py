"""The compile cache in the object store, which machines of one kind share.

Each file is one object, whole or not there at all; its key holds machine, environment and time. There is no
index that two writers could spoil, and everything here may be lost.
"""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from core.errors import ObjectNotFound
from core.storage import keys
from core.storage.objects import ObjectInfo, ObjectStore
from worker.compile_cache.local import is_whole, names, write_out

# One job downloads at most so many, the newest files first: a large store must not fill a laptop.
_MAX_FETCHED_BYTES = 2**28
# Warp makes a hundred small files for a body, and a store may be far away.
_AT_ONCE = 8


@dataclass(frozen=True)
class SharedCache:
    """The compiled programs that machines with one fingerprint share, for one environment.

    Every method raises StorageUnavailable when the store cannot be reached, and OSError where the disk fails.
    """

    objects: ObjectStore
    machine: str
    environment: str

    def fetch(self, kept: Path, room: Path) -> int:
        """Download what `kept` lacks and count the files. room: a folder on that disk to write them to."""
        here, left = names(kept), _MAX_FETCHED_BYTES
        lacking: list[tuple[str, ObjectInfo]] = []
        for name, info in self._newest_first().items():
            if name not in here and (left := left - info.size) >= 0:
                lacking.append((name, info))

        def fetch(number: int) -> bool:
            name, info = lacking[number]
            # The end of a name says what kind of file it is, so the temporary name keeps it.
            return self._fetch(info, room / f"fetched-{number}-{Path(name).name[-6:]}", kept / name)

        with ThreadPoolExecutor(_AT_ONCE) as pool:
            return sum(pool.map(fetch, range(len(lacking))))

    def store(self, kept: Path, new: Sequence[str], now: datetime) -> int:
        """Upload these files of `kept`, unless they are there already; returns how many were uploaded."""
        there = self._newest_first()

        def store(name: str) -> bool:
            key = keys.cached(self.machine, self.environment, f"{now:%Y%m%dT%H%M%SZ}", name)
            try:
                self.objects.put_file(key, kept / name)
            except FileNotFoundError:  # Gone already, to make room.
                return False
            return True

        with ThreadPoolExecutor(_AT_ONCE) as pool:
            return sum(pool.map(store, [name for name in new if name not in there]))

    def keep_within(self, max_bytes: int) -> None:
        """Remove the oldest files, of any machine and environment, until the rest has at most `max_bytes`."""
        found = sorted(self.objects.list(keys.caches()), key=lambda info: _when_and_name(info.key))
        excess = sum(info.size for info in found) - max_bytes
        for info in found:
            if excess <= 0:
                return
            self.objects.delete_prefix(info.key)
            excess -= info.size

    def _newest_first(self) -> dict[str, ObjectInfo]:
        found = list(self.objects.list(keys.cache_of(self.machine, self.environment)))
        found.sort(key=lambda info: _when_and_name(info.key), reverse=True)
        newest: dict[str, ObjectInfo] = {}
        for info in found:
            newest.setdefault(_when_and_name(info.key)[1], info)
        return {name: info for name, info in newest.items() if ".." not in Path(name).parts}

    def _fetch(self, info: ObjectInfo, beside: Path, target: Path) -> bool:
        """Download a file; returns whether it arrived whole."""
        try:
            with self.objects.open(info.key) as pieces, beside.open("wb") as file:
                file.writelines(pieces)
            if beside.stat().st_size != info.size or not is_whole(beside):
                return False
            write_out(beside)
            target.parent.mkdir(parents=True, exist_ok=True)
            beside.replace(target)
            return True
        except ObjectNotFound:  # Somebody made room.
            return False
        finally:
            beside.unlink(missing_ok=True)


def _when_and_name(key: str) -> tuple[str, str]:
    _, _, _, when, name = key.split("/", 4)
    return when, name
