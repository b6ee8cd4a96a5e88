"""`python -m api`: the service under uvicorn."""

import argparse
import ipaddress
import socket
from collections.abc import Sequence
from types import FrameType

import structlog
import uvicorn
from fastapi import FastAPI

from api.app import from_environment
from core.configuration import stopping_if_misconfigured
from core.errors import Misconfigured
from core.telemetry import configure_logging

log = structlog.get_logger()

_OPEN_DOOR = (
    "Whoever reaches this address may submit, cancel and delete jobs: there are no accounts. Listen at "
    "127.0.0.1 (--host, or GAITWAY_ADDRESS under Docker Compose), or put a proxy with accounts before it."
)
# Long enough for a file's piece or a submission on its way; streams close by themselves.
_GRACE_S = 5


class Server(uvicorn.Server):
    """uvicorn, which tells open streams that the end has come."""

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

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        self._service.stopping = True
        super().handle_exit(sig, frame)


def listen(host: str, port: int) -> socket.socket:
    """A bound socket; port 0 takes a free one. Raises Misconfigured."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        return socket.create_server((host, port), family=family, backlog=512)
    except OSError as error:
        raise Misconfigured(
            f"The API cannot listen at {host} port {port} ({error.strerror}); see --host and --port."
        ) from error


def main(arguments: Sequence[str] | None = None) -> None:
    """Serve until SIGTERM or SIGINT."""
    parser = argparse.ArgumentParser(prog="python -m api", description="Gaitway's HTTP service.")
    parser.add_argument("--host", default="127.0.0.1", help="default: %(default)s, this machine only")
    parser.add_argument("--port", type=int, default=8000, help="0 takes a free one; default: %(default)s")
    chosen = parser.parse_args(arguments)
    configure_logging("api")
    _serve(chosen.host, chosen.port)


@stopping_if_misconfigured()
def _serve(host: str, port: int) -> None:
    with listen(host, port) as listener:
        app = from_environment()
        host, port = listener.getsockname()[:2]
        outside = app.state.service.settings.published or host
        if not _is_loopback(outside):
            log.warning("service_exposed", address=outside, advice=_OPEN_DOOR)
        log.info("service_listens", host=host, port=port)
        Server(app).run(sockets=[listener])


def _is_loopback(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"
