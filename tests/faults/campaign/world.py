"""A service of real processes (servers, an API, a reconciler, two workers) with proxies between all."""

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self
from urllib.parse import quote

import httpx
import psutil
import psycopg
import redis

from core.adapters.s3.connection import connect_s3
from core.adapters.s3.objects import S3ObjectStore
from core.adapters.wiring import connect_redis
from gaitway.service.embedded.folders import private_folder, write_private
from gaitway.service.embedded.postgres import Postgres
from gaitway.service.embedded.valkey import Valkey
from gaitway.service.embedded.weed import REGION, Weed
from tests.faults.campaign.clocks import ClockedProcess, Clocks
from tests.faults.campaign.disks import Disk
from tests.faults.campaign.ports import Ports
from tests.faults.campaign.proxy import Proxies
from worker.host.processes import PARENT

PARTIES = ("api", "reconciler", "worker-1", "worker-2")
SERVERS = ("postgres", "valkey", "weed")
STORES = ("postgres", "valkey", "weed")
LEASE_S, HEARTBEAT_S, RECONCILE_S, GRACE_S = 3.0, 0.25, 0.25, 5.0
# Where what is kept, and how much of it, in MiB.
DISKS = {
    "postgres": ("pg", 512),
    "weed": ("s3", 512),
    "worker-1": ("worker-1", 64),
    "worker-2": ("worker-2", 64),
}
_MEMBER = ("-m", "tests.faults.campaign.member")
_SOCKET = ".s.PGSQL.5432"
_POLL_S = 0.05


@dataclass
class Member:
    """A process that is started again when it has ended, as a container engine does it."""

    name: str
    start: Callable[[], None]
    pid: Callable[[], int | None]
    starts: int = 0


@dataclass
class World:
    """Enter it to start everything; it may be used for many episodes. It ends with its process.

    has_own_mounts: of this process, so that each store can be given a disk that gets full. settings: of every
    process, in the place of the short times of this world.
    """

    folder: Path = field(default_factory=lambda: Path(tempfile.mkdtemp(prefix="gw-")))
    has_own_mounts: bool = False
    proxies: Proxies = field(default_factory=Proxies)
    settings: Mapping[str, str] = field(default_factory=dict[str, str])

    def __post_init__(self) -> None:
        self.folder.chmod(0o711)  # PostgreSQL may be another user, and reads its clock here.
        self.clocks = Clocks(self.folder / "clocks")
        self.disks: dict[str, Disk] = {}
        if self.has_own_mounts:
            for name, (folder, size_mib) in DISKS.items():
                (self.folder / folder).mkdir()
                self.disks[name] = Disk(self.folder / folder, size_mib)
        # Durable: without synchronous commits a killed server loses the last of them, as the checker sees.
        self.postgres = Postgres(self.folder / "pg")
        process = ClockedProcess("postgres", self.folder / "pg", stop_signal=signal.SIGINT)
        process.clock = self.clocks.environment("postgres")
        self.postgres.process = process
        self.valkey = Valkey(self.folder / "kv")
        self.ports = Ports()
        # As if it had chosen them the last time.
        write_private(private_folder(self.folder / "s3") / "ports.json", json.dumps(self.ports.take(10)))
        self.weed = Weed(self.folder / "s3")
        self.port, self.url = 0, ""
        self.members: dict[str, Member] = {}
        # Keys of objects that were lost or damaged on purpose: no reader need get their bytes.
        self.hurt = set[str]()
        # Promises that a fault itself saw broken, of this episode.
        self.broken: list[str] = []
        self._children: dict[str, subprocess.Popen[bytes]] = {}
        self._over = threading.Event()
        self._ready = threading.Event()
        self._failure: BaseException | None = None
        # The kernel ends what a thread has started when the thread ends: all is started by this one.
        self._keeper = threading.Thread(target=self._keep, name="keeper", daemon=True)

    def __enter__(self) -> Self:
        self._keeper.start()
        self._ready.wait(90)
        if self._failure is not None:
            raise self._failure
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._keeper.join(60)
        self.proxies.close()
        shutil.rmtree(self.folder, ignore_errors=True)

    # ---- what may be looked at and done from outside -----------------------------------------------

    def database(self) -> "psycopg.Connection[Any]":
        """A connection past the proxies."""
        return psycopg.connect(self.postgres.url, autocommit=True, connect_timeout=5)

    def redis(self) -> redis.Redis:
        """A client past the proxies."""
        return connect_redis(self.valkey.url)

    def objects(self) -> S3ObjectStore:
        """The object store, past the proxies."""
        weed = self.weed
        client = connect_s3(weed.endpoint, weed.access_key, weed.secret_key, secure=False, region=REGION)
        return S3ObjectStore(client, weed.bucket)

    @property
    def weed_data(self) -> Path:
        """Where the object store keeps its volumes."""
        return self.folder / "s3" / "data"

    def processes(self, name: str) -> Iterator[psutil.Process]:
        """A member and all below it."""
        pid = self.members[name].pid()
        if pid is not None:
            with suppress(psutil.Error):
                process = psutil.Process(pid)
                yield from (process, *process.children(recursive=True))

    def signal(self, name: str, number: signal.Signals, *, which: int | None = None) -> None:
        """To a member and all below it, or to one of them: 0 is the member itself, 1 its first child, ..."""
        found = list(self.processes(name))
        chosen = found if which is None else found[which : which + 1]
        for process in chosen:
            with suppress(psutil.Error):
                process.send_signal(number)

    def heal(self) -> None:
        """Proxies open, nobody stopped, room, the right time; what has ended is started by the keeper."""
        self.proxies.heal()
        self.clocks.heal()
        for disk in self.disks.values():
            disk.free()
        for name in self.members:
            self.signal(name, signal.SIGCONT)

    def logs(self, name: str) -> str:
        """A party's log since the world began, or a server's log since its last start."""
        servers = {"postgres": self.postgres, "valkey": self.valkey, "weed": self.weed}
        if name in servers:
            return servers[name].process.log()
        path = self.folder / f"{name}.log"
        return path.read_text(errors="replace") if path.exists() else ""

    def left_over(self) -> list[str]:
        """The processes of jobs, spools and locks, which an idle service has not."""
        found = [
            f"process {process.pid} {' '.join(process.cmdline()[-4:])}"
            for name in PARTIES
            for process in list(self.processes(name))[1:]
        ]
        for party in ("worker-1", "worker-2"):
            data = self.folder / party
            found += [str(path) for path in (data / "spool").glob("*")]
            found += [str(path) for path in (data / "locks").glob("*")]
        return found

    # ---- keeping it running -----------------------------------------------------------------------

    def _keep(self) -> None:
        try:
            self._start_all()
        except BaseException as error:
            self._failure = error
        finally:
            self._ready.set()
        while not self._over.wait(_POLL_S) and self._failure is None:
            if self.weed.process.pid is not None and self.weed.needs_restart():
                self.weed.stop()  # As the stack does it.
            for member in self.members.values():
                if member.pid() is None:
                    with suppress(Exception):  # Tried again at the next glance.
                        member.starts += 1
                        member.start()
        self._stop_all()

    def _start_all(self) -> None:
        for name, server in (("weed", self.weed), ("valkey", self.valkey), ("postgres", self.postgres)):
            server.launch()
            self.members[name] = Member(name, self._restart(server), lambda s=server: s.process.pid)
        for server in (self.postgres, self.valkey, self.weed):
            server.wait_ready()
        for party in PARTIES:
            self._add_proxies(party)
        [self.port] = self.ports.take(1)
        self.url = f"http://127.0.0.1:{self.port}"
        for party in ("api", "reconciler", "worker-1", "worker-2"):
            self.members[party] = Member(party, self._starter(party), self._pid_of(party))
            self.members[party].start()
        self.wait_ready()

    def wait_ready(self, timeout_s: float = 40.0) -> None:
        """Return when the API says that it is ready and both workers are there."""
        deadline = time.monotonic() + timeout_s
        # One client: each loads its certificates, which takes 28 ms of processor time.
        with httpx.Client(base_url=self.url, timeout=5, trust_env=False) as http:
            while time.monotonic() < deadline:
                with suppress(httpx.HTTPError):
                    workers = http.get("/workers", timeout=2)
                    ready = http.get("/readyz")
                    if ready.is_success and workers.is_success and len(workers.json()["items"]) >= 2:
                        return
                time.sleep(_POLL_S)
        logs = "\n".join(f"--- {party}\n{self.logs(party)[-1500:]}" for party in PARTIES)
        raise TimeoutError(f"the service was not ready within {timeout_s:g} s\n{logs}")

    def _restart(self, server: Any) -> Callable[[], None]:
        def start() -> None:
            server.process.stop(0)  # What is left of its group.
            if server is self.valkey:  # Restarted without its file: Redis may lose everything.
                for file in (self.folder / "kv").glob("*.rdb"):
                    file.unlink()
            server.launch()

        return start

    def _add_proxies(self, party: str) -> None:
        folder = self.folder / "p" / party
        folder.mkdir(parents=True)
        target = Path(psycopg.conninfo.conninfo_to_dict(self.postgres.url)["host"]) / _SOCKET  # type: ignore[arg-type]
        self.proxies.add(f"{party}/postgres", folder / _SOCKET, target)
        self.proxies.add(f"{party}/valkey", folder / "kv", Path(self.valkey.url.removeprefix("unix://")))
        port = int(self.weed.endpoint.rpartition(":")[2])
        [here] = self.ports.take(1)
        self.proxies.add(f"{party}/weed", here, port)

    def _starter(self, party: str) -> Callable[[], None]:
        modules = {"api": ["api", "--port", str(self.port)], "reconciler": ["worker.reconciler"]}
        module = modules.get(party, ["tests.faults.campaign.worker"])

        def start() -> None:
            before = self._children.get(party)
            if before is not None:
                before.wait()
            with (self.folder / f"{party}.log").open("ab") as log:
                self._children[party] = subprocess.Popen(
                    [sys.executable, *_MEMBER, sys.executable, "-m", *module],
                    env={**self._environment(party), PARENT: str(os.getpid())},
                    stdin=subprocess.DEVNULL,
                    stdout=log,
                    stderr=subprocess.STDOUT,
                    start_new_session=True,
                )

        return start

    def _pid_of(self, party: str) -> Callable[[], int | None]:
        def pid() -> int | None:
            child = self._children.get(party)
            return child.pid if child is not None and child.poll() is None else None

        return pid

    def _environment(self, party: str) -> dict[str, str]:
        proxy = self.proxies.all
        folder = self.folder / "p" / party
        kept = {name: value for name, value in os.environ.items() if not name.startswith("GAITWAY_")}
        database = self.postgres.url.partition("?")[0]
        return {
            **kept,
            **self.weed.environment(),
            **self.clocks.environment(party),
            "GAITWAY_DATABASE_URL": f"{database}?host={quote(str(folder), safe='')}",
            "GAITWAY_REDIS_URL": f"unix://{quote(str(folder / 'kv'))}",
            "GAITWAY_S3_ENDPOINT": f"127.0.0.1:{proxy[f'{party}/weed'].here}",
            "GAITWAY_DATA_DIR": str(self.folder / party),
            "GAITWAY_DEVICE": "cpu",
            # A machine of many cores has several: they would count as left behind.
            "GAITWAY_API_PROCESSES": "1",
            "GAITWAY_LEASE": str(LEASE_S),
            "GAITWAY_HEARTBEAT": str(HEARTBEAT_S),
            "GAITWAY_RECONCILE_EVERY": str(RECONCILE_S),
            "GAITWAY_GRACE": str(GRACE_S),
            "GAITWAY_SHARED_CACHE_MAX_BYTES": "0",
            **self.settings,
            "PYTHONPATH": str(Path(__file__).parents[3]),
            "PYTHONUNBUFFERED": "1",
        }

    def _stop_all(self) -> None:
        self.heal()
        for party in reversed(PARTIES):
            self.signal(party, signal.SIGKILL)
        for child in self._children.values():
            child.wait()
        for server in (self.postgres, self.valkey, self.weed):
            with suppress(Exception):
                server.stop()
