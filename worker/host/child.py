"""Starts and ends the worker's child processes; the training process as its supervisor sees it."""

import os
import re
import select
import selectors
import signal
import site
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import IO, TYPE_CHECKING, cast

import structlog
from pydantic import ValidationError

from core.variables import variable
from worker.host.memory import sacrifice
from worker.host.processes import PARENT
from worker.protocol import LONGEST_MESSAGE, MESSAGE, Message
from worker.stopping import DRAIN_SIGNAL, STOP_SIGNAL, Stop

if TYPE_CHECKING:  # The training process, which starts children too, would load all settings.
    from core.settings import Confinement

log = structlog.get_logger()

TRAINING = (sys.executable, "-m", "worker.training")
_CODE = Path(__file__).resolve().parents[2]
_LONGEST_LINE = 4000
_LONGEST_OUTPUT = 2**20  # bytes
# By this the embedded stack finds its left-over processes.
_PASSED_ON = ("GAITWAY_STACK_ID",)
# Other programs' settings of stores and accounts, and names that suggest a secret.
_OTHERS_ACCOUNTS = re.compile(
    r"(AWS|AZURE|GCP|GOOGLE|DOCKER|GH|GIT|GITHUB|GITLAB|HF|KUBE|MC|MINIO|PG|POSTGRES|RCLONE|REDIS|S3|SSH|VALKEY|"
    r"VAULT|WANDB|WEED)[A-Z0-9]*_|PG[A-Z]+$|REDIS|DATABASE"
)
_SECRET = re.compile(
    r"SECRET|PASS(WOR|PHR|WD|$)|TOKEN|CREDENTIAL|COOKIE|AUTH(?!OR)|API_?KEY|(^|_)(KEY|PAT|DSN)(_|$)"
)
# By these the outer environment could give a process more of a GPU than its part.
_OF_XLA = ("XLA_PYTHON_CLIENT_ALLOCATOR", "XLA_PYTHON_CLIENT_MEM_FRACTION")
_WITH_PASSWORD = re.compile(r"\w://[^/\s]*:[^/\s]*@")


def launch(  # noqa: PLR0913 # Popen's own, where callers differ.
    command: Sequence[str],
    variables: Mapping[str, str],
    *,
    stdout: int | IO[bytes] | None,
    stderr: int | None = subprocess.STDOUT,
    stdin: int = subprocess.DEVNULL,
    cwd: Path | None = None,
    fds: Sequence[int] = (),
    in_own_session: bool = True,
) -> subprocess.Popen[bytes]:
    """Start a program of this package, which calls `die_with_parent`: it ends with the calling thread.

    variables: its whole environment, apart from our process id. fds: what it inherits besides its standard
    streams. in_own_session: no Ctrl-C reaches it, and `kill` ends all that it started; otherwise it belongs
    to our own process group, and ends with that.
    """
    return subprocess.Popen(
        command,
        env={**variables, PARENT: str(os.getpid())},
        cwd=cwd,
        stdin=stdin,
        stdout=stdout,
        stderr=stderr,
        pass_fds=fds,
        start_new_session=in_own_session,
    )


def collect(child: subprocess.Popen[bytes], timeout_s: float) -> tuple[str, str]:
    """The child's output on each pipe until it ends, at most the last MiB; then it is killed for certain.

    Raises subprocess.TimeoutExpired.
    """
    deadline = time.monotonic() + timeout_s
    stdout, stderr = cast("IO[bytes]", child.stdout).fileno(), cast("IO[bytes]", child.stderr).fileno()
    written = {stdout: b"", stderr: b""}
    try:
        with selectors.DefaultSelector() as pipes:
            for pipe in written:
                pipes.register(pipe, selectors.EVENT_READ)
            while pipes.get_map() and (left_s := deadline - time.monotonic()) > 0:
                for key, _ in pipes.select(left_s):
                    piece = os.read(key.fd, 2**16)
                    written[key.fd] = (written[key.fd] + piece)[-_LONGEST_OUTPUT:]
                    if not piece:
                        pipes.unregister(key.fd)
        child.wait(max(0.0, deadline - time.monotonic()))
    finally:
        kill(child)
    return written[stdout].decode(errors="replace"), written[stderr].decode(errors="replace")


def kill(child: subprocess.Popen[bytes], timeout_s: float = 10.0) -> None:
    """End it, and everything in its own group; returns when nothing is left, or after `timeout_s`."""
    deadline = time.monotonic() + timeout_s
    while child.poll() is None or _group_lives(child.pid):
        if time.monotonic() > deadline:
            log.error("processes_left", process_group=child.pid)
            return
        child.kill()
        with suppress(ProcessLookupError):
            os.killpg(child.pid, signal.SIGKILL)
        time.sleep(0.01)


def tail(file: IO[bytes], num_bytes: int) -> str:
    """The last bytes of a file that a child wrote to, as text."""
    file.seek(max(0, file.seek(0, os.SEEK_END) - num_bytes))
    return file.read(num_bytes).decode(errors="replace")


class TrainingProcess:
    """Started at once. `messages` and `lines` end when the process, and all it started, have ended.

    command: the program; it is given the spool and the descriptor to write messages to. spool, data_dir:
    absolute, for it starts in the spool. slot_fds: of the device's locks, which it holds to its end. models:
    whether it confines itself when it loads a user's model (worker/confinement/own_files.py). gpu_part: as in
    `memory_variables`.
    """

    def __init__(  # noqa: PLR0913 # What a training is given.
        self,
        command: Sequence[str],
        spool: Path,
        data_dir: Path,
        device: str,
        slot_fds: Sequence[int],
        models: "Confinement" = "confined",
        gpu_part: float | None = None,
    ) -> None:
        read_end, write_end = os.pipe()
        self._messages: IO[bytes] = os.fdopen(read_end, "rb")
        self._child = launch(
            [*command, str(spool), str(write_end)],
            {
                **memory_variables(environment(device, data_dir, os.environ), gpu_part),
                variable("models"): models,
            },
            stdout=subprocess.PIPE,
            # MuJoCo writes its log to the working directory, and ours may be read-only.
            cwd=spool,
            fds=(write_end, *slot_fds),
        )
        sacrifice(self._child.pid)
        os.close(write_end)

    @property
    def pid(self) -> int:
        return self._child.pid

    def messages(self) -> Iterator[Message]:
        """Its messages, in order. A line that is none, such as one that its death cut short, is logged."""
        with self._messages as pipe:
            for line in _lines(pipe, LONGEST_MESSAGE):
                try:
                    yield MESSAGE.validate_json(line)
                except ValidationError:
                    log.warning("message_not_understood", line=line[:200])

    def lines(self) -> Iterator[str]:
        """The lines that it and its libraries print, each cut to 4,000 characters."""
        with cast("IO[bytes]", self._child.stdout) as pipe:
            for line in _lines(pipe, 4 * _LONGEST_LINE):
                yield line.decode(errors="replace").rstrip("\n")[:_LONGEST_LINE]

    def poll(self, timeout_s: float) -> int | None:
        """Its exit status, or None if it still runs after `timeout_s`; negative: the signal that ended it."""
        if self._child.poll() is None:
            self._wait(timeout_s)
        return self._child.poll()

    def _wait(self, timeout_s: float) -> None:
        try:
            ended = os.pidfd_open(self._child.pid)
        except (AttributeError, OSError):  # Not Linux, or an old kernel.
            with suppress(subprocess.TimeoutExpired):
                self._child.wait(timeout_s)
            return
        # `Popen.wait` with a timeout polls at least twenty times a second, at the training's expense.
        poll = select.poll()
        poll.register(ended, select.POLLIN)
        poll.poll(1000 * timeout_s)
        os.close(ended)

    def stop(self, why: Stop) -> None:
        """Ask it, perhaps again, to keep what it has and exit; with a video, unless the job continues."""
        self._signal_leader(DRAIN_SIGNAL if why is Stop.DRAIN else STOP_SIGNAL)

    def kill(self) -> None:
        """End it and everything it started."""
        kill(self._child)

    def _signal_leader(self, number: int) -> None:
        if self._child.poll() is None:
            self._child.send_signal(number)


def environment(device: str, data_dir: Path, base: Mapping[str, str]) -> dict[str, str]:
    """The variables of a process on this device: it sees no other device, and no secrets."""
    kept = {name: value for name, value in base.items() if not _may_be_secret(name, value)}
    kept |= {"PYTHONUNBUFFERED": "1", "PYTHONSAFEPATH": "1", variable("data_dir"): str(data_dir)}
    kept |= _modules(base)
    kept |= {name: base[name] for name in _PASSED_ON if name in base}
    return kept | device_variables(device)


def device_variables(device: str) -> dict[str, str]:
    """The variables by which a process sees this device, and no other."""
    if device == "cpu":
        return {"JAX_PLATFORMS": "cpu", "CUDA_VISIBLE_DEVICES": ""}
    # In the order of the device files, as in the locks' names; CUDA's default is the fastest first.
    return {"CUDA_VISIBLE_DEVICES": device.partition(":")[2], "CUDA_DEVICE_ORDER": "PCI_BUS_ID"}


def memory_variables(variables: Mapping[str, str], gpu_part: float | None) -> dict[str, str]:
    """These variables, for a process that may take a part of its GPU's memory, or all of it (None).

    XLA would otherwise take most of the memory at once; it fails beyond the part, and takes nobody else's.
    """
    if gpu_part is None:
        return dict(variables)
    kept = {name: value for name, value in variables.items() if name not in _OF_XLA}
    return kept | {"XLA_PYTHON_CLIENT_PREALLOCATE": "false", "XLA_CLIENT_MEM_FRACTION": f"{gpu_part:.6f}"}


def _may_be_secret(name: str, value: str) -> bool:
    said = name.upper()
    return (
        said.startswith("GAITWAY_")
        or _OTHERS_ACCOUNTS.match(said) is not None
        or _SECRET.search(said) is not None
        or _WITH_PASSWORD.search(value) is not None
    )


def _modules(base: Mapping[str, str]) -> dict[str, str]:
    """Lets Python find these modules from any folder, and with any home what the user has installed there."""
    own = {"PYTHONUSERBASE": site.getuserbase()} if site.ENABLE_USER_SITE else {}
    return {**own, "PYTHONPATH": os.pathsep.join(filter(None, (str(_CODE), base.get("PYTHONPATH"))))}


def _lines(pipe: IO[bytes], longest: int) -> Iterator[bytes]:
    """The lines, each cut to `longest` bytes: a line without an end must not fill the memory."""
    while line := pipe.readline(longest):
        rest = line
        while len(rest) == longest and not rest.endswith(b"\n"):
            rest = pipe.readline(longest)
        yield line


def _group_lives(group: int) -> bool:
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True
