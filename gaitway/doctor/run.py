"""All checks, one after the other; none keeps another from being made."""

import os
import tempfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

from gaitway.doctor import machine, services
from gaitway.doctor.check import Check

_SERVICES = {"redis": services.redis, "object store": services.object_store, "clock": services.clock}


def examine(data: Path, *, embedded: bool = False) -> Iterator[Check]:
    """Each check's finding as soon as it is made. embedded: with servers started for this."""
    checks: dict[str, Callable[[], Check]] = {
        "interpreter": machine.interpreter,
        "jax": machine.jax_devices,
        "physics": machine.physics,
        "renderer": machine.renderer,
        "encoder": machine.encoder,
        "disk": lambda: machine.disk(data),
        "embedded servers": machine.embedded_servers,
    }
    for name, check in checks.items():
        yield guarded(name, check)
    yield from _embedded() if embedded else _services(os.environ)


def guarded(name: str, check: Callable[[], Check]) -> Check:
    """The check's finding; that it broke is a finding, too."""
    try:
        return check()
    except Exception as error:
        return Check(
            name, "fail", f"the check itself broke: {type(error).__name__}: {error}", "Please report this."
        )


def _services(environ: Mapping[str, str]) -> Iterator[Check]:
    for name, check in _SERVICES.items():
        yield guarded(name, lambda check=check: check(environ))


def _embedded() -> Iterator[Check]:
    from gaitway.embedded.servers import EmbeddedServers

    with tempfile.TemporaryDirectory(prefix="gaitway-doctor-") as folder:
        try:
            servers = EmbeddedServers(Path(folder)).start()
        except Exception as error:
            yield Check(
                "start of embedded servers", "fail", str(error), "Read its log; `gaitway up` keeps one."
            )
            return
        try:
            yield from _services(servers.environment())
        finally:
            servers.stop()
