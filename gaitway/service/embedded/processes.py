"""Child processes that end with their launcher, and free ports for them."""

import fcntl
import os
import secrets
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import IO

from core.errors import Unavailable

# Runs first, then becomes the server. PR_SET_PDEATHSIG is 1; a launcher already gone would never signal.
_END_WITH_PARENT = """
import ctypes, os, signal, sys
if sys.platform == "linux":
    ctypes.CDLL(None).prctl(1, signal.SIGKILL, 0, 0, 0)
    if os.getppid() != int(sys.argv[1]):
        sys.exit("the launcher has gone")
os.execv(sys.argv[2], sys.argv[2:])
"""
LOCK_TIMEOUT_S = 5.0
_FIRST_PORT, _LAST_PORT = 20_000, 32_000  # below the range of outgoing connections


class ServerFailed(Exception):
    """A server did not start or keep running; the message ends with the last lines of its log."""


class ServerProcess:
    """One child in a session of its own: Ctrl-C in a terminal reaches only the launcher.

    On Linux the kernel kills it when the *thread* that started it ends: start it from one that stays.
    """

    def __init__(self, name: str, folder: Path, *, stop_signal: signal.Signals = signal.SIGTERM) -> None:
        self.name = name
        self._folder = folder
        self._stop_signal = stop_signal
        self._log = folder / f"{name}.log"
        self._child: subprocess.Popen[bytes] | None = None

    @property
    def pid(self) -> int | None:
        return self._child.pid if self._child is not None and self._child.poll() is None else None

    @property
    def status(self) -> int | None:
        """Its exit status once it has ended; negative: the signal that ended it."""
        return self._child.poll() if self._child is not None else None

    def start(
        self,
        command: Sequence[str],
        environment: Mapping[str, str],
        *,
        takes_input: bool = False,
        prefix: Sequence[str] = (),
        prepare: Callable[[int], object] = lambda lock: None,
    ) -> None:
        """Start it; a second one in the same folder raises ServerFailed.

        takes_input: its standard input comes from `send_input`; otherwise it is empty.
        prefix: a command that changes the user and then runs the command after it.
        prepare: runs once the folder is locked; a child that inherits the descriptor keeps the lock.
        """
        wrapper = [sys.executable, "-I", "-S", "-c", _END_WITH_PARENT, str(os.getpid())]
        with _locked(self._folder / "lock", self.name) as lock, self._log.open("wb") as log:
            prepare(lock.fileno())
            # The child inherits the lock, so it is held until the last byte is written.
            # The prefix comes first: the kernel forgets PR_SET_PDEATHSIG when a process changes its user.
            self._child = subprocess.Popen(
                [*prefix, *wrapper, *command],
                cwd=self._folder,
                env=dict(environment),
                stdin=subprocess.PIPE if takes_input else subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                pass_fds=[lock.fileno()],
            )

    def send_input(self, words: str) -> None:
        """Write its whole standard input; does nothing if it has ended."""
        if self._child is not None and self._child.stdin is not None:
            with suppress(BrokenPipeError), self._child.stdin as pipe:
                pipe.write(words.encode())

    def check(self) -> None:
        """Raises ServerFailed where it has ended."""
        if self._child is None:
            raise ServerFailed(f"{self.name} was not started.")
        if (status := self._child.poll()) is not None:
            raise ServerFailed(f"{self.name} ended with status {status}.\n{self.last_lines()}")

    def wait_until(self, ready: Callable[[], object], timeout_s: float = 60.0) -> None:
        """Return when `ready` no longer raises Unavailable. Raises ServerFailed."""
        deadline = time.monotonic() + timeout_s
        while True:
            self.check()
            try:
                ready()
            except Unavailable as unavailable:
                if time.monotonic() > deadline:
                    raise ServerFailed(f"{self.name}: {unavailable.detail}\n{self.last_lines()}") from None
                time.sleep(0.02)
            else:
                return

    def log(self) -> str:
        """Its output since its start."""
        return self._log.read_text(errors="replace") if self._log.exists() else ""

    def log_from(self, offset: int) -> bytes:
        """The complete lines of its output from byte `offset` on."""
        with self._log.open("rb") as log:
            log.seek(offset)
            said = log.read()
        return said[: said.rfind(b"\n") + 1]

    def last_lines(self, count: int = 15) -> str:
        return "\n".join(self.log().splitlines()[-count:])

    def stop(self, grace_s: float) -> None:
        """Its stop signal, then SIGKILL to its whole group; returns when it has ended."""
        if self._child is None:
            return
        try:
            if self._child.poll() is None:
                self._child.send_signal(self._stop_signal)
                with suppress(subprocess.TimeoutExpired):
                    self._child.wait(grace_s)
        finally:  # an impatient second Ctrl-C leaves nothing running either
            with suppress(ProcessLookupError):
                os.killpg(self._child.pid, signal.SIGKILL)
            self._child.wait()
            if self._child.stdin is not None:
                self._child.stdin.close()
            self._child = None


def free_ports(count: int) -> list[int]:
    """`count` different ports at which nothing on the loopback interface listens now."""
    ports: set[int] = set()
    while len(ports) < count:
        # Not `random`: processes that seed it alike would choose the same ports.
        port = _FIRST_PORT + secrets.randbelow(_LAST_PORT - _FIRST_PORT)
        if are_free([port]):
            ports.add(port)
    return list(ports)


def are_free(ports: Sequence[int]) -> bool:
    """Whether nothing on the loopback interface listens at any of them now."""
    return all(_is_free(port) for port in ports)


def claim(ports: Sequence[int]) -> list[socket.socket] | None:
    """What keeps these ports from other launchers of ours until it is closed; None if one of them is taken.

    A server listens only a moment after its ports were chosen, and another could choose them meanwhile. So
    its launcher holds the UDP ports of the same numbers.
    """
    with ExitStack() as claims:
        held = [claims.enter_context(socket.socket(type=socket.SOCK_DGRAM)) for _ in ports]
        try:
            for one, port in zip(held, ports, strict=True):
                one.bind(("127.0.0.1", port))
        except OSError:
            return None
        if not are_free(ports):
            return None
        claims.pop_all()
    return held


def _is_free(port: int) -> bool:
    with socket.socket() as probe:
        # As servers do, so that a lingering connection of the last run does not matter.
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", port))
        except OSError:
            return False
        return True


def _locked(path: Path, name: str) -> IO[bytes]:
    lock = path.open("ab")
    deadline = time.monotonic() + LOCK_TIMEOUT_S
    while True:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            if time.monotonic() > deadline:
                lock.close()
                raise ServerFailed(
                    f"Another {name} uses {path.parent}; stop it, or choose another folder."
                ) from None
            time.sleep(0.05)  # the one before may be about to end
        else:
            return lock
