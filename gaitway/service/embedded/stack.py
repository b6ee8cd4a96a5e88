"""The whole service on one machine: servers, reconciler, API and workers under one data folder."""

import fcntl
import json
import os
import signal
import socket
import sys
import time
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from http import HTTPStatus
from http.client import HTTPConnection, HTTPException
from pathlib import Path
from typing import IO, Self

from core.errors import EXIT_STATUS, Unavailable
from gaitway.service.embedded.folders import private_folder, write_private
from gaitway.service.embedded.interruption import Interruption
from gaitway.service.embedded.processes import ServerFailed, ServerProcess
from gaitway.service.embedded.servers import EmbeddedServers
from gaitway.service.embedded.stopped import StoppedProcesses
from gaitway.service.embedded.weed import Weed
from gaitway.service.installed import CODE, IS_WHEEL

LOOPBACK = "127.0.0.1"
_ANY_ADDRESS = ("0.0.0.0", "::")  # noqa: S104 # Compared, not bound.
FIRST_PORT = 8000
_PORTS_TRIED = 100
_GRACE_S = 30
_WORKER = "worker-"
# The settings of the stores, as long as they run; a file that only this user reads.
STORES = "stores.json"
_MAX_RESTARTS = 5  # within this time:
_RESTART_WINDOW_S = 60.0
_HEALTH_CHECK_EVERY_S = 1.0


@dataclass
class _Member:
    """A process of the stack, and how to start and stop it."""

    process: ServerProcess
    launch: Callable[[], object]
    stop: Callable[[], object]
    restarts: deque[float] = field(default_factory=lambda: deque[float](maxlen=_MAX_RESTARTS))
    due_at: float | None = None


class Stack:
    """Starts everything on entry, ends everything on exit. Use it from the main thread.

    host, port: of the API; by default 127.0.0.1 and 8000, or the next port that is free. accounts: whether
    users have them; None: as GAITWAY_ACCOUNTS says. prepare: what idle
    workers compile where GAITWAY_PREPARE is not set.
    report: takes each sentence for the user. Raises ServerFailed where something does not start.
    """

    def __init__(  # noqa: PLR0913 # All but the folder are named.
        self,
        data_dir: Path,
        *,
        host: str = LOOPBACK,
        port: int | None = None,
        num_workers: int = 1,
        accounts: bool | None = None,
        prepare: str = "",
        report: Callable[[str], None] = lambda sentence: None,
    ) -> None:
        self._host = host
        self._wanted_port = port
        self._accounts = accounts
        self._num_workers = num_workers
        self._prepare = prepare
        self._report = report
        self._servers: list[_Member] = []
        self._modules: list[_Member] = []  # They need the servers, and end before them.
        self._stopped = StoppedProcesses()
        self._looked_closer_at = time.monotonic()
        self._weed: Weed | None = None
        self._where_servers_are: str | None = None
        self._interruption = Interruption()
        self._folder = data_dir
        self._lock: IO[str] | None = None
        self.url = ""

    @property
    def data_dir(self) -> Path:
        """Where everything lives: a folder for each process, its log inside."""
        return self._folder

    @property
    def store_settings(self) -> Mapping[str, str]:
        """The variables under which a process finds the stores."""
        return {} if self._where_servers_are is None else json.loads(self._where_servers_are)

    @property
    def interruption(self) -> Interruption:
        """With this, a caller may let Ctrl-C end its own waits."""
        return self._interruption

    def __enter__(self) -> Self:
        self._interruption.__enter__()
        try:
            self._start()
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        try:
            self._stop()
        finally:
            if self._lock is not None:
                self._lock.close()
            self._interruption.__exit__(None, None, None)

    def watch(self) -> None:
        """Keep everything running until Interrupted; a process that ends unexpectedly is started again.

        Raises ServerFailed if it keeps ending.
        """
        while True:
            with self._interruption.allowed():
                time.sleep(0.2)
            self.mend()

    def mend(self) -> None:
        """Start again what has ended unexpectedly. Raises ServerFailed after five times in a minute.

        A process that a signal has stopped for half a minute is ended and started again. So is the object
        store, when its disk was full and has room again.
        """
        now = time.monotonic()
        if now - self._looked_closer_at >= _HEALTH_CHECK_EVERY_S:
            self._looked_closer_at = now
            self._end_what_hangs()
        for member in (*self._servers, *self._modules):
            if member.due_at is None and member.process.pid is None:
                member.due_at = now + self._delay_s(member, now)
            elif member.due_at is not None and now >= member.due_at:
                member.due_at = None
                member.process.stop(grace_s=0)  # ends what it has left in its group
                member.launch()

    def _end_what_hangs(self) -> None:
        for sentence in self._stopped.end():
            self._report(sentence)
        weed = self._weed
        if weed is not None and weed.process.pid is not None and weed.needs_restart():
            self._report(
                "A write of weed failed, and it would write no more until a restart: it is started again."
            )
            weed.stop()
            weed.launch()

    def _delay_s(self, member: _Member, now: float) -> float:
        name, lines = member.process.name, member.process.last_lines(8)
        if member.process.status == EXIT_STATUS:  # It is misconfigured: a restart would not help.
            raise ServerFailed(f"{name} cannot work.\n{lines}")
        while member.restarts and member.restarts[0] < now - _RESTART_WINDOW_S:
            member.restarts.popleft()
        if len(member.restarts) == _MAX_RESTARTS:
            raise ServerFailed(f"{name} ended {_MAX_RESTARTS + 1} times in a minute.\n{lines}")
        self._report(f"{name} has ended unexpectedly and is started again. Its last lines:\n{lines}")
        member.restarts.append(now)
        return 0.25 * 2 ** len(member.restarts)

    def _start(self) -> None:
        # Held until the API takes it: else a SeaweedFS may choose it, and that answers at /readyz, too.
        with _take_port(self._host, self._wanted_port) as held:
            port = held.getsockname()[1]
            self._folder = private_folder(self._folder)
            self._lock = lock_folder(self._folder)
            servers = EmbeddedServers(self._folder)
            self._weed = servers.weed
            # They import their modules while the servers start.
            reconciler = self._add_module("reconciler", "worker.reconciler")
            api = self._add_module("api", "api.main", "--host", self._host, "--port", str(port))
            # PostgreSQL last: its first launch returns only after it has made its files.
            for server in reversed(servers.all):
                self._servers.append(_Member(server.process, server.launch, server.stop))
                server.launch()
            with self._interruption.allowed():
                # Other processes would take a missing database or bucket for a wrong setting.
                servers.wait_ready()
        self._where_servers_are = json.dumps(servers.environment())
        # For `gaitway cluster`, which starts workers elsewhere.
        write_private(self._folder / STORES, self._where_servers_are)
        for process in (reconciler, api):
            process.send_input(self._where_servers_are)
        for number in range(1, self._num_workers + 1):
            self._add_module(f"{_WORKER}{number}", "worker.main")
        here = LOOPBACK if self._host in _ANY_ADDRESS else self._host
        self.url = f"http://{f'[{here}]' if ':' in here else here}:{port}"
        with self._interruption.allowed():
            api.wait_until(lambda: _check_ready(reconciler, here, port))

    def _add_module(self, name: str, *module: str) -> ServerProcess:
        """Start it; it runs once it is told where the servers are."""
        process = ServerProcess(name, private_folder(self._folder / name))
        command = [sys.executable, "-m", "gaitway.service.embedded.preload", "-m", *module]

        def launch() -> None:
            process.start(command, self._environment(), takes_input=True)
            if self._where_servers_are is not None:
                process.send_input(self._where_servers_are)

        # Workers have already had their grace period.
        stop = partial(process.stop, 0 if name.startswith(_WORKER) else 3)
        self._modules.append(_Member(process, launch, stop))
        launch()
        return process

    def _environment(self) -> dict[str, str]:
        leaks = ("PYTHONPATH", "PYTHONHOME")
        code = {"PYTHONPATH": str(CODE)} if IS_WHEEL else {}
        return {
            "GAITWAY_PREPARE": self._prepare,
            **{name: value for name, value in os.environ.items() if name not in leaks},
            **code,
            **({} if self._accounts is None else {"GAITWAY_ACCOUNTS": str(self._accounts).lower()}),
            "GAITWAY_DATA_DIR": str(self._folder),
            "GAITWAY_GRACE": f"PT{_GRACE_S}S",
            # It must not import modules from its working directory.
            "PYTHONSAFEPATH": "1",
            "PYTHONUNBUFFERED": "1",
        }

    def _stop(self) -> None:
        (self._folder / STORES).unlink(missing_ok=True)
        self._stop_processes()

    def _stop_processes(self) -> None:
        """Stop the workers first, all at once: they save their results. A second signal ends the wait."""
        signals_before = self._interruption.count
        workers = [m.process for m in self._modules if m.process.name.startswith(_WORKER)]
        for worker in workers:
            if worker.pid is not None:
                with suppress(ProcessLookupError):
                    os.kill(worker.pid, signal.SIGTERM)
        deadline = time.monotonic() + _GRACE_S + 5
        while any(worker.pid is not None for worker in workers):
            if time.monotonic() > deadline or self._interruption.count > signals_before:
                break
            time.sleep(0.02)
        for members in (self._modules, self._servers):
            for member in reversed(members):
                member.stop()
            members.clear()


def _take_port(host: str, wanted: int | None) -> socket.socket:
    """A listener at the API's port. Raises ServerFailed where it is in use."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    ports = [wanted] if wanted is not None else range(FIRST_PORT, FIRST_PORT + _PORTS_TRIED)
    for port in ports:
        with suppress(OSError):
            return socket.create_server((host, port), family=family)
    if wanted is not None:
        raise ServerFailed(f"Port {wanted} is in use; choose another, or none to take the next free one.")
    raise ServerFailed(f"No port from {FIRST_PORT} to {FIRST_PORT + _PORTS_TRIED - 1} is free; name one.")


def lock_folder(folder: Path) -> IO[str]:
    """The folder's lock, with this process's id in it, for a second one's message. Raises ServerFailed."""
    lock = (folder / "stack.lock").open("a+")
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        lock.seek(0)
        owner = lock.read().strip() or "unknown"
        lock.close()
        raise ServerFailed(f"Process {owner} already runs a service on {folder}; end it first.") from None
    lock.truncate(0)
    lock.write(f"{os.getpid()}\n")
    lock.flush()
    return lock


def _check_ready(reconciler: ServerProcess, host: str, port: int) -> None:
    """Raises Unavailable until the API says that it is ready; ServerFailed where it cannot become so."""
    reconciler.check()  # Without it there are no tables.
    connection = HTTPConnection(host, port, timeout=2)  # Importing httpx would take longer.
    try:
        connection.request("GET", "/readyz")
        answer = connection.getresponse()
        words = answer.read(300).decode(errors="replace")
    except (OSError, HTTPException) as error:
        raise Unavailable(f"The API does not answer: {error}") from error
    finally:
        connection.close()
    if answer.status != HTTPStatus.OK:
        raise Unavailable(f"The API answers {answer.status}: {words}")
