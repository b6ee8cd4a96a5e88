"""Runs all checks, one after the other, even if some fail."""

import os
import tempfile
from collections.abc import Callable, Generator, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from gaitway.service.doctor import machine, services, settings
from gaitway.service.doctor.check import Check
from gaitway.service.doctor.machine import confinement
from gaitway.service.doctor.plugins import plugins

Checks = Mapping[str, Callable[[], Check]]


def examine(data: Path, *, embedded: bool = False) -> Iterator[Check]:
    """Each check's finding as soon as it is made. embedded: check servers that are started for this."""
    worker = settings.of_a_worker()
    folder = worker.data_dir if worker else data
    yield from _made(
        {
            "interpreter": machine.interpreter,
            "jax": machine.jax_devices,
            "physics": machine.physics,
            "plugins": plugins,
            "renderer": machine.renderer,
            "encoder": machine.encoder,
            "disk": lambda: machine.disk(folder),
            "device": lambda: machine.device(worker),
            "users' models": lambda: confinement(folder),
            "embedded servers": lambda: machine.embedded_servers(needed=not settings.of_the_stores()),
        }
    )
    yield from _embedded() if embedded else _services()
    yield from _made({"api": services.api})


def guarded(name: str, check: Callable[[], Check]) -> Check:
    """The check's finding; an error in the check is a finding, too."""
    try:
        return check()
    except Exception as error:
        return Check(
            name, "fail", f"the check itself broke: {type(error).__name__}: {error}", "Please report this."
        )


def _made(checks: Checks) -> Iterator[Check]:
    for name, check in checks.items():
        yield guarded(name, check)


def _services() -> Iterator[Check]:
    stores = settings.of_the_stores()
    return _made(
        {
            "settings": settings.settings,
            "postgresql": lambda: services.postgresql(stores),
            "redis": lambda: services.redis(stores),
            "object store": lambda: services.object_store(stores),
            "clock": lambda: services.clock(stores),
        }
    )


def _embedded() -> Iterator[Check]:
    from gaitway.service.embedded.servers import EmbeddedServers

    with tempfile.TemporaryDirectory(prefix="gaitway-doctor-") as folder:
        try:
            servers = EmbeddedServers(Path(folder)).start()
        except Exception as error:
            yield Check(
                "start of embedded servers", "fail", str(error), "Read its log; `gaitway up` keeps one."
            )
            return
        try:
            with _environment(servers.environment()):
                yield from _services()
        finally:
            servers.stop()


@contextmanager
def _environment(variables: Mapping[str, str]) -> Generator[None]:
    """Run with these settings and no others."""
    from core.configuration import SECRETS_DIR, names

    before = dict(os.environ)
    for name in names() | {SECRETS_DIR}:
        os.environ.pop(name, None)
    os.environ.update(variables)
    try:
        yield
    finally:
        os.environ.clear()
        os.environ.update(before)
