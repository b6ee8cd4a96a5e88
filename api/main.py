"""`python -m api`: the service under uvicorn.

Several processes may serve one socket, supervised by uvicorn, because one Python process uses one core.
"""

import argparse
import ctypes
import gc
import ipaddress
import os
import socket
import sys
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from multiprocessing import parent_process
from tempfile import TemporaryDirectory
from types import FrameType
from typing import Any

import structlog
import uvicorn
from fastapi import FastAPI
from uvicorn.config import STARTUP_FAILURE
from uvicorn.supervisors import multiprocess

from api.app import from_environment
from api.monitoring import SHARED_FOLDER
from core.configuration import stopping_if_misconfigured
from core.environments.catalog import PLUGINS
from core.environments.plugins import log_each
from core.errors import Misconfigured
from core.start_up import give_back_memory
from core.telemetry import configure_logging

BACKLOG = 512
# Of glibc's `mallopt`.
_M_ARENA_MAX = -8
# Long enough for a piece of a file or a submission; streams close on their own.
_GRACE_S = 5
# Even a busy machine loads Gaitway's modules within this time.
_START_S = 30
log = structlog.get_logger()
_IN_THE_CLEAR = (
    "Tokens and jobs cross the network unencrypted, unless something in front of this address speaks TLS: a "
    "proxy, or a private network."
)


class ApiServer(uvicorn.Server):
    """uvicorn's server, which tells open streams to end when it stops."""

    def __init__(self, app: FastAPI) -> None:
        super().__init__(
            uvicorn.Config(
                app,
                access_log=False,
                log_config=None,
                lifespan="off",
                # Anybody may send X-Forwarded-For; limits and the audit log go by the address.
                proxy_headers=False,
                server_header=False,
                timeout_graceful_shutdown=_GRACE_S,
                timeout_keep_alive=30,
                ws="none",
            )
        )
        self._service = app.state.service

    def run(self, sockets: list[socket.socket] | None = None) -> None:
        """Serve until SIGTERM or SIGINT."""
        # Loaded modules stay in memory. A full garbage collection over them blocks all requests for 0.1 s.
        gc.collect()
        gc.freeze()
        _share_heap()
        give_back_memory()  # What imports and schemas left took 3 MiB.
        super().run(sockets)
        self._service.audit_log.flush()

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        self._service.stopping = True
        super().handle_exit(sig, frame)


def _share_heap() -> None:
    """Let threads have no heaps of their own, which took 2 MB: they take turns anyway."""
    with suppress(OSError, AttributeError):  # glibc alone has it.
        ctypes.CDLL(None).mallopt(_M_ARENA_MAX, 1)


def reserve(host: str, port: int) -> socket.socket:
    """A socket bound to an address where child processes may listen, too."""
    reserved = socket.socket(_family(host))
    reserved.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    reserved.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)
    reserved.bind((host, port))
    return reserved


def listen(host: str, port: int) -> socket.socket:
    """A bound socket; port 0 takes a free one. Raises Misconfigured."""
    try:
        return socket.create_server((host, port), family=_family(host), backlog=BACKLOG)
    except OSError as error:
        raise Misconfigured(
            f"The API cannot listen at {host} port {port} ({error.strerror}); see --host and --port."
        ) from error


def _family(host: str) -> socket.AddressFamily:
    return socket.AF_INET6 if ":" in host else socket.AF_INET


class _Process(multiprocess.Process):
    """One of them. It ends with its supervisor, whose successor needs the socket's address."""

    @property
    def server(self) -> uvicorn.Server:
        if self._server is None:
            self._server = ApiServer(from_environment())
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
    with TemporaryDirectory(prefix="gaitway-metrics-") as folder:
        os.environ[SHARED_FOLDER] = folder
        watch.run()
    if any(process.exitcode == STARTUP_FAILURE for process in watch.processes):
        sys.exit(STARTUP_FAILURE)


def main(arguments: Sequence[str] | None = None) -> None:
    """Serve until SIGTERM or SIGINT."""
    parser = argparse.ArgumentParser(prog="python -m api", description="Gaitway's HTTP service.")
    parser.add_argument("--host", default="127.0.0.1", help="default: %(default)s, this machine only")
    parser.add_argument("--port", type=int, default=8000, help="0 takes a free one; default: %(default)s")
    chosen = parser.parse_args(arguments)
    configure_logging("api")
    log_each(PLUGINS)
    _serve(chosen.host, chosen.port)


@stopping_if_misconfigured()
def _serve(host: str, port: int) -> None:
    with listen(host, port) as listener:
        app = from_environment()
        host, port = listener.getsockname()[:2]
        settings = app.state.service.settings
        check_exposure(settings.published or host, has_accounts=settings.accounts)
        number = settings.num_processes
        announce = partial(log.info, "service_listens", host=host, port=port, processes=number)
        if number == 1:
            announce()
            ApiServer(app).run(sockets=[listener])
        else:
            serve(listener, number, on_ready=announce)


def check_exposure(address: str, *, has_accounts: bool) -> None:
    """Warn where others reach the service. Raises Misconfigured where they would do so without accounts."""
    if _is_loopback(address):
        return
    if not has_accounts:
        raise Misconfigured(
            f"The API would answer at {address} without accounts: anyone who reaches that address could "
            "read, cancel and delete everything. Turn accounts on (GAITWAY_ACCOUNTS=true; docs/teams.md), or "
            "let it listen at 127.0.0.1 and reach it by `ssh -L 8000:127.0.0.1:8000 thatmachine`."
        )
    log.warning("service_exposed", address=address, advice=_IN_THE_CLEAR)


def _is_loopback(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"
