"""`python -m api`: the service under uvicorn."""

import argparse
import ipaddress
from collections.abc import Sequence
from functools import partial

import structlog

from api import processes
from api.app import from_environment
from api.server import Server, listen
from core.configuration import stopping_if_misconfigured
from core.telemetry import configure_logging

log = structlog.get_logger()

_OPEN_DOOR = (
    "Anyone who reaches this address may submit, cancel and delete jobs: there are no accounts. Listen at "
    "127.0.0.1 (--host, or GAITWAY_ADDRESS under Docker Compose), or put a proxy with accounts in front."
)


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
        number = app.state.service.settings.num_processes
        announce = partial(log.info, "service_listens", host=host, port=port, processes=number)
        if number == 1:
            announce()
            Server(app).run(sockets=[listener])
        else:
            processes.serve(listener, number, on_ready=announce)


def _is_loopback(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"
