"""The object store as the place where machines of one kind find what another compiled.

One object a file, whole or not there at all; its key tells machine, environment, and when it came. There is
no index that two writers could spoil, and nothing here that may not be lost.
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

# What one job brings at most, the newest first: a large store is no reason to fill a laptop.
_MOST_FETCHED_BYTES = 2**28
# Warp makes a hundred small files for a body, and a store may be far away.
_AT_ONCE = 8


@dataclass(frozen=True)
class SharedCache:
    """What machines with one fingerprint compiled for one environment.

    Every method raises StorageUnavailable when the store cannot be reached, and OSError where the disk fails.
    """

    objects: ObjectStore
    machine: str
    environment: str

    def fetch(self, kept: Path, room: Path) -> int:
        """Bring into `kept` what it lacks; how many files. room: a folder of that disk to write them in."""
        here, left = names(kept), _MOST_FETCHED_BYTES
        lacking: list[tuple[str, ObjectInfo]] = []
        for name, info in self._newest_first().items():
            if name not in here and (left := left - info.size) >= 0:
                lacking.append((name, info))

        def fetch(number: int) -> bool:
            name, info = lacking[number]
            # What a file is shows in the end of its name, here as there.
            return self._fetch(info, room / f"fetched-{number}-{Path(name).name[-6:]}", kept / name)

        with ThreadPoolExecutor(_AT_ONCE) as pool:
            return sum(pool.map(fetch, range(len(lacking))))

    def store(self, kept: Path, new: Sequence[str], now: datetime) -> int:
        """Show others these files of `kept`, unless somebody already has; how many that were."""
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
        """Remove the oldest, whatever it is of, until the rest has no more than so many bytes."""
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
        """Whether it is there now: what does not arrive whole is left out."""
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
