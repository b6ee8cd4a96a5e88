"""uvicorn, configured for this service."""

import gc
import socket
from types import FrameType

import uvicorn
from fastapi import FastAPI

from core.errors import Misconfigured

BACKLOG = 512
# Long enough for a piece of a file or a submission; streams close on their own.
_GRACE_S = 5


class Server(uvicorn.Server):
    """uvicorn's server, which tells open streams to end when it stops."""

    def __init__(self, app: FastAPI) -> None:
        super().__init__(
            uvicorn.Config(
                app,
                access_log=False,
                log_config=None,
                lifespan="off",
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
        super().run(sockets)

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        self._service.stopping = True
        super().handle_exit(sig, frame)


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
