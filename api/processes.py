"""Several processes that serve one socket, supervised by uvicorn: one Python process uses one core."""

import os
import socket
import sys
import threading
from collections.abc import Callable
from multiprocessing import parent_process
from typing import Any

import uvicorn
from uvicorn.config import STARTUP_FAILURE
from uvicorn.supervisors import multiprocess

from api.app import from_environment
from api.server import BACKLOG, Server, reserve
from core.configuration import stopping_if_misconfigured
from core.telemetry import configure_logging

# Even a busy machine loads Gaitway's modules within this time.
_START_S = 30


class _Process(multiprocess.Process):
    """One of them. It ends with its supervisor, whose successor needs the socket's address."""

    @property
    def server(self) -> uvicorn.Server:
        if self._server is None:
            self._server = Server(from_environment())
        return self._server

    def target(self, sockets: list[socket.socket] | None = None) -> None:
        threading.Thread(target=_end_with_parent, daemon=True).start()
        configure_logging("api")
        try:
            with stopping_if_misconfigured():
                assert self.server  # noqa: S101 # Made before a second thread asks for it.
        except SystemExit:
            sys.exit(STARTUP_FAILURE)
        super().target([_own(sockets[0])] if sockets else None)


def _own(listener: socket.socket) -> socket.socket:
    """A listener at the same address.

    Linux spreads new connections over several listeners; from a shared one, the first to wake takes all.
    """
    if sys.platform != "linux":
        return listener
    own = reserve(*listener.getsockname()[:2])
    own.listen(BACKLOG)
    return own


def _end_with_parent() -> None:
    parent = parent_process()
    assert parent is not None  # noqa: S101
    parent.join()
    os._exit(1)


class _Watch(multiprocess.Multiprocess):
    """uvicorn's supervisor, which calls `on_ready` once the first processes answer."""

    def __init__(self, config: uvicorn.Config, listener: socket.socket, on_ready: Callable[[], None]) -> None:
        super().__init__(config, [listener])
        self._on_ready = on_ready

    def init_processes(self) -> None:
        super().init_processes()
        if all(process.wait_until_ready(_START_S) for process in self.processes):
            self._on_ready()


def serve(listener: socket.socket, number: int, on_ready: Callable[[], None]) -> None:
    """Run `number` processes until SIGTERM or SIGINT; one that dies or hangs is replaced.

    listener: this closes it. on_ready: called once they answer. Exits with a status other than 0 if one
    could not start.
    """
    if sys.platform == "linux":
        # This process keeps the address, but accepts no connections.
        address = listener.getsockname()[:2]
        listener.close()
        listener = reserve(*address)
    # uvicorn has no other way to name the class of its processes.
    replaced: Any = multiprocess
    replaced.Process = _Process
    config = uvicorn.Config(
        "api.app:from_environment",
        factory=True,
        workers=number,
        log_config=None,
        timeout_worker_healthcheck=_START_S,
    )
    watch = _Watch(config, listener, on_ready)
    watch.run()
    if any(process.exitcode == STARTUP_FAILURE for process in watch.processes):
        sys.exit(STARTUP_FAILURE)
