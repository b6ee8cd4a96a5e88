"""Ports of one world: no other world takes them, not even while the server that listens there is dead."""

import fcntl
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

# Below those that `gaitway.service.embedded.processes.free_ports` draws from.
_FIRST, _OF_A_WORLD, _WORLDS = 12_000, 32, 250
_FOLDER = Path(tempfile.gettempdir(), f"gaitway-campaign-ports-{os.getuid()}")


class Ports:
    """The first block of ports that no living process has taken; it is free again when this process ends."""

    def __init__(self) -> None:
        _FOLDER.mkdir(exist_ok=True)
        self._ports = self._take()

    def take(self, count: int) -> list[int]:
        """So many that were not taken yet."""
        return [next(self._ports) for _ in range(count)]

    def _take(self) -> Iterator[int]:
        for number in range(_WORLDS):
            self._lock = (_FOLDER / str(number)).open("ab")
            try:
                fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                self._lock.close()
            else:
                first = _FIRST + number * _OF_A_WORLD
                return iter(range(first, first + _OF_A_WORLD))
        raise RuntimeError(f"{_WORLDS} worlds are there already.")
