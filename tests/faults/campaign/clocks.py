"""The time of day as each process sees it: moved by a library of ours that is loaded before the C library.

libfaketime does more and leaves shared memory behind whenever a process is killed, which the next process of
that id trips over. This one needs a C compiler; without it there are no such clocks.
"""

import shutil
import struct
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from gaitway.service.embedded.processes import ServerProcess

_SOURCE = Path(__file__).with_name("clock.c")


class Clocks:
    """A clock for each name, in a folder that every user may read."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._names: set[str] = set()
        self._library: Path | None = None
        if (compiler := shutil.which("cc")) is not None:
            folder.mkdir(mode=0o755)
            self._library = folder / "clock.so"
            command = [compiler, "-O2", "-shared", "-fPIC", "-o", str(self._library), str(_SOURCE), "-ldl"]
            subprocess.run(command, check=True)

    def __bool__(self) -> bool:
        """Whether they can be set."""
        return self._library is not None

    def environment(self, name: str) -> Mapping[str, str]:
        """The environment of a process that goes by this clock."""
        if self._library is None:
            return {}
        self.set(name, 0)
        return {"LD_PRELOAD": str(self._library), "CAMPAIGN_CLOCK": str(self._folder / name)}

    def set(self, name: str, seconds: float) -> None:
        """So far from the machine's own, from this moment on."""
        self._names.add(name)
        path = self._folder / name
        if not path.exists():
            path.write_bytes(bytes(8))
        with path.open("r+b") as file:
            file.write(struct.pack("=q", int(seconds * 1e9)))

    def heal(self) -> None:
        for name in self._names:
            self.set(name, 0)


class ClockedProcess(ServerProcess):
    """A server that goes by a clock of its own."""

    clock: Mapping[str, str] = {}

    def start(self, command: Sequence[str], environment: Mapping[str, str], **more: Any) -> None:
        super().start(command, {**environment, **self.clock}, **more)
