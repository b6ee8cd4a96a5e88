"""The process behind `gaitway cluster slurm`: keeps as many workers on Slurm as the queue wants.

It runs as the user who starts it, on a machine that has sbatch and reaches the stores, and may be ended and
started again at any moment: its allocations are found by their names. Composition root.
"""

import fcntl
import getpass
import json
import os
import secrets
import shlex
import signal
import socket
import sys
import time
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from pydantic import SecretStr

from core.adapters.wiring import job_store
from core.configuration import read
from core.errors import Misconfigured, Unavailable
from core.jobs.slots import SlotKind, wanted_slots
from core.jobs.store import JobStore
from core.settings import StoreSettings
from core.variables import variable
from worker.cluster.checks import problems
from worker.cluster.launcher import Allocation, Launcher, LaunchRefused, SchedulerAway
from worker.cluster.options import SlurmOptions, Tunnel
from worker.cluster.scale import Decision, Limits, Memory, Seen, decide, lost, refused, unknown
from worker.cluster.script import Place, script_of
from worker.cluster.slurm import Slurm, name_of
from worker.cluster.stores import StoresThere, is_local, through_tunnel, write_settings

# `gaitway up` leaves it in its data folder as long as it runs.
STORES = "stores.json"
_LOOK_EVERY_S = 1.0
# How often the scheduler is asked at most; while something is on its way; and otherwise. Many users ask it.
_ASK_EVERY_S, _ASK_WHILE_COMING_S, _ASK_AT_REST_S = 2.0, 5.0, 30.0

Say = Callable[[str], None]


def stores_here(data: Path) -> StoreSettings:
    """The settings of the stores: GAITWAY_… of the environment, or of the service that runs on this data
    folder. Raises Misconfigured."""
    if os.environ.get(variable("database_url")) or os.environ.get("GAITWAY_SECRETS_DIR"):
        return read(StoreSettings)
    try:
        said: dict[str, str] = json.loads((data / STORES).read_text())
    except (OSError, ValueError):
        raise Misconfigured(
            f"No service runs on {data.absolute()}: start `gaitway up --workers 0` on this machine, name its "
            "folder by --data, or set GAITWAY_DATABASE_URL and what else docs/settings.md lists for stores."
        ) from None
    fields = {name.removeprefix("GAITWAY_").lower(): value for name, value in said.items()}
    return StoreSettings.model_validate(fields)


def variables_of(settings: StoreSettings) -> dict[str, str]:
    """The settings as variables, with their secrets."""
    return {
        variable(name): text
        for name in settings.__class__.model_fields
        if (text := _text(getattr(settings, name)))
    }


def _text(value: Any) -> str:
    match value:
        case None:
            return ""
        case SecretStr():
            return value.get_secret_value()
        case bool():
            return str(value).lower()
        case _:
            return str(value)


def with_tunnel(options: SlurmOptions, stores: Mapping[str, str]) -> SlurmOptions:
    """The options with a tunnel to this machine, where the stores listen for it alone and none is named."""
    if options.tunnel is None and is_local(stores):
        return options.model_copy(update={"tunnel": Tunnel(host=name_of_this_machine(), port=22)})
    return options


def name_of_this_machine() -> str:
    """As nodes know it: where /etc/hosts gives its own address the name `localhost`, without a domain."""
    name = socket.getfqdn()
    return socket.gethostname() if name.split(".")[0] == "localhost" else name


def place_of(folder: Path, options: SlurmOptions, stores: Mapping[str, str]) -> Place:
    """Write what allocations need into the folder. Raises Misconfigured."""
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    there = StoresThere(dict(stores))
    if isinstance(options.tunnel, Tunnel):
        there = through_tunnel(there)
    write_settings(folder / "settings", there.settings)
    logs = folder / "logs"
    logs.mkdir(exist_ok=True)
    return Place(folder / "settings", logs, command_here(), there.forwards, there.ports)


def command_here() -> str:
    """How a node that sees this installation starts a worker."""
    code = os.environ.get("PYTHONPATH", "")
    path = os.pathsep.join(filter(None, (str(Path(__file__).resolve().parents[2]), code)))
    return f"env PYTHONPATH={shlex.quote(path)} {shlex.quote(sys.executable)} -P -m worker.main"


@dataclass
class Loop:
    """Looks at the queue and at the scheduler, and starts and calls off workers.

    store: reaches the record as it is now; it may have moved. clock: seconds that never go back.
    """

    launcher: Launcher
    store: Callable[[], JobStore]
    limits: Limits
    say: Say
    clock: Callable[[], float] = time.monotonic
    memory: Memory = field(default_factory=Memory)
    _asked_at: float = field(default=-1e9, init=False)
    _wanted_then: object = field(default=None, init=False)
    _is_coming: bool = field(default=False, init=False)
    _said: set[str] = field(default_factory=set[str], init=False)

    def run_once(self) -> None:
        """One look. An outage of the record or of the scheduler is said, and nothing is started meanwhile."""
        try:
            store = self.store()
            wanted = wanted_slots(store.queue_counts())
            queued = tuple((one.kind, one.queued) for one in wanted if one.queued)
            if not self._is_due(queued):
                return
            allocations = self.launcher.what_runs()
            now = store.now()
            workers = [(one, (now - one.seen_at).total_seconds()) for one in store.workers()]
        except Unavailable as error:
            self._say_once(f"The record is away; allocations stay as they are. {error.detail}")
            return
        except SchedulerAway as error:
            self._asked_at = self.clock()
            self._say_once(f"Slurm is away; nothing is started meanwhile. {error}")
            return
        self._asked_at, self._wanted_then = self.clock(), queued
        seen = Seen(self.clock(), wanted, allocations, workers)
        self._explain(lost(seen, self.memory))
        decision, self.memory = decide(seen, self.memory, self.limits)
        self._tell(decision)
        self._do(decision)
        self._is_coming = bool(decision.starts) or any(one.id not in self.memory.heard for one in allocations)
        if not decision.unserved and not self.memory.failures:
            self._said.clear()

    def _explain(self, ended: Sequence[Allocation]) -> None:
        """Say why they failed, and let their kinds pause. What Slurm or a person has ended did not fail."""
        failed = [(one, why) for one in ended if (why := self.launcher.explain(one)) is not None]
        for one, why in failed:
            where = f" on {one.node}" if one.node else ""
            self.say(
                f"Slurm job {one.id} ({name_of(one.kind)}) ended{where} before its worker had begun. {why}"
            )
        for kind in {one.kind for one, _ in failed}:
            self.memory = refused(self.memory, kind, self.clock())

    def _is_due(self, queued: object) -> bool:
        silence_s = self.clock() - self._asked_at
        if queued != self._wanted_then:
            return silence_s >= _ASK_EVERY_S
        return silence_s >= (_ASK_WHILE_COMING_S if queued or self._is_coming else _ASK_AT_REST_S)

    def _tell(self, decision: Decision) -> None:
        for slots in decision.unserved:
            self._say_once(
                f"Jobs of the kind {name_of(slots.kind)} wait: {slots.queued}. The options name only "
                f"{', '.join(map(name_of, self.limits.kinds))}: add it, or let a worker elsewhere take them."
            )

    def _do(self, decision: Decision) -> None:
        try:
            if decision.stops:
                self.launcher.stop(decision.stops)
                named = ", ".join(decision.stops)
                self.say(f"Called off Slurm jobs {named}: no job wants them, or Slurm holds them back.")
        except SchedulerAway as error:
            self._say_once(f"Slurm is away. {error}")
        for kind, number in decision.starts.items():
            try:
                self.launcher.start(kind, number)
                self.say(f"Asked Slurm for {number} worker{'s' if number > 1 else ''} ({name_of(kind)}).")
            except LaunchRefused as refusal:
                self.memory = refused(self.memory, kind, self.clock())
                pause_s = self.memory.paused_until_s[kind] - self.clock()
                self.say(
                    f"Slurm refuses a worker ({name_of(kind)}), tried again in {pause_s:.0f} s: {refusal}"
                )
            except SchedulerAway as error:
                self.memory = unknown(self.memory, kind, self.clock())
                self._say_once(
                    f"Slurm is away; whether it has started a worker shows when it is back. {error}"
                )

    def _say_once(self, sentence: str) -> None:
        if sentence not in self._said:
            self._said.add(sentence)
            self.say(sentence)


def shown(options: SlurmOptions, data: Path, folder: Path) -> str:
    """The batch script of each kind, as it would be sent. Raises Misconfigured."""
    current = Site(options, data, folder.absolute())
    return "\n".join(current.script(kind, f"gaitway-{name_of(kind)}", ()) for kind in options.kinds)


@contextmanager
def own_folder(folder: Path) -> Generator[str]:
    """The token of the folder's allocations, while no other process uses it. Raises Misconfigured."""
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    with (folder / "lock").open("a+") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise Misconfigured(
                f"Another `gaitway cluster slurm` keeps workers from {folder}; end it first."
            ) from None
        token = folder / "token"
        if not token.exists():
            token.write_text(secrets.token_hex(4))
        yield token.read_text().strip()


def limits_of(options: SlurmOptions) -> Limits:
    parts = {kind: options.part(kind).max for kind in options.kinds}
    return Limits(
        options.max,
        options.kinds,
        options.any_as,
        {kind: number for kind, number in parts.items() if number is not None},
    )


def serve(options: SlurmOptions, data: Path, folder: Path, say: Say) -> None:
    """Keep workers until SIGINT or SIGTERM. Raises Misconfigured."""
    folder = folder.absolute()
    told: list[int] = []
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        signal.signal(number, lambda number, _: told.append(number))
    with own_folder(folder) as token:
        current = Site(options, data, folder)
        launcher = Slurm(token, options.kinds, current.script, folder / "logs")
        try:
            if wrong := problems(options, current.script):
                raise Misconfigured(" ".join(wrong))
        except SchedulerAway as error:
            say(f"Slurm is away; it is waited for. {error}")
        loop = Loop(launcher, current.store, limits_of(options), say)
        say(
            f"Workers for {', '.join(map(name_of, options.kinds))}, at most {options.max} at once, as "
            f"{getpass.getuser()}; their logs are in {folder / 'logs'}."
        )
        if isinstance(current.options.tunnel, Tunnel):
            say(f"They reach the stores by ssh to {current.options.tunnel.host}.")
        while not told:
            loop.run_once()
            if not told:
                time.sleep(_LOOK_EVERY_S)
        say("Ended. Running workers go on, and end when they have had no job for a while.")


class Site:
    """The options, and the stores as they are now: `gaitway up` may have been started again with others.

    Raises Misconfigured.
    """

    def __init__(self, options: SlurmOptions, data: Path, folder: Path) -> None:
        self._options, self._data, self._folder = options, data, folder.absolute()
        self._variables: dict[str, str] = {}
        self._store: JobStore | None = None
        self.options = options
        self._look()

    def store(self) -> JobStore:
        """The record. Raises Unavailable."""
        try:
            self._look()
        except Misconfigured as error:
            raise Unavailable(error.detail) from None
        if self._store is None:
            raise Unavailable("There is no record.")
        return self._store

    @property
    def object_store(self) -> str:
        """HOST:PORT of the object store, as the tunnel's host reaches it."""
        return self._variables["GAITWAY_S3_ENDPOINT"]

    def script(self, kind: SlotKind, name: str, exclude: Sequence[str], module: str = "worker.main") -> str:
        """The batch script of a worker. module: what runs on the node in its place, by the same way."""
        swapped = replace(self._place, command=self._place.command.replace("worker.main", module))
        return script_of(kind, name, self.options, swapped, exclude)

    def _look(self) -> None:
        settings = stores_here(self._data)
        variables = variables_of(settings)
        if variables == self._variables:
            return
        self.options = with_tunnel(self._options, variables)
        self._place = place_of(self._folder, self.options, variables)
        script_of(self.options.kinds[0], "gaitway", self.options, self._place)
        self._store = job_store(settings, pool_size=1)
        self._variables = variables
