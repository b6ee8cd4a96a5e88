"""The training process as its supervisor sees it: a group of its own, a pipe of messages, a pipe of text."""

import os
import re
import select
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import IO, cast

import structlog
from pydantic import ValidationError

from core.settings import Confinement
from core.variables import variable
from worker.host.memory import sacrifice
from worker.protocol import MESSAGE, Message
from worker.stop_signals import DRAIN_SIGNAL, STOP_SIGNAL, Stop

log = structlog.get_logger()

TRAINING = (sys.executable, "-m", "worker.training")
_CODE = Path(__file__).resolve().parents[2]
_LONGEST_LINE = 4000
_LONGEST_MESSAGE = 2**20  # bytes
# Whose process this is, for whoever looks for left-overs.
_PASSED_ON = ("GAITWAY_STACK_ID",)
# Other programs' settings of stores and accounts, and whatever calls itself a secret.
_OTHERS_ACCOUNTS = re.compile(
    r"(AWS|AZURE|GCP|GOOGLE|DOCKER|GH|GIT|GITHUB|GITLAB|HF|KUBE|MC|MINIO|PG|POSTGRES|RCLONE|REDIS|S3|SSH|VALKEY|"
    r"VAULT|WANDB|WEED)[A-Z0-9]*_|PG[A-Z]+$|REDIS|DATABASE"
)
_SECRET = re.compile(
    r"SECRET|PASS(WOR|PHR|WD|$)|TOKEN|CREDENTIAL|COOKIE|AUTH(?!OR)|API_?KEY|(^|_)(KEY|PAT|DSN)(_|$)"
)
_WITH_PASSWORD = re.compile(r"\w://[^/\s]*:[^/\s]*@")


class TrainingProcess:
    """Started at once. `messages` and `lines` end when the process, and all it started, have ended.

    command: the program; it is given the spool, the descriptor to write messages to, and our process id.
    spool, data_dir: absolute, for it starts in the spool. models: whether it binds itself, with a user's
    model (worker/confinement/own_files.py).
    """

    def __init__(
        self,
        command: Sequence[str],
        spool: Path,
        data_dir: Path,
        device: str,
        slot_fds: Sequence[int],
        models: Confinement = "confined",
    ) -> None:
        read_end, write_end = os.pipe()
        self._messages: IO[bytes] = os.fdopen(read_end, "rb")
        self._child = subprocess.Popen(
            [*command, str(spool), str(write_end), str(os.getpid())],
            # MuJoCo writes its log where it stands; our own folder may be read-only.
            cwd=spool,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            start_new_session=True,
            pass_fds=(write_end, *slot_fds),
            env={**environment(device, data_dir, os.environ), variable("models"): models},
        )
        sacrifice(self._child.pid)
        os.close(write_end)

    @property
    def pid(self) -> int:
        return self._child.pid

    def messages(self) -> Iterator[Message]:
        """What it says, in order. A line cut short by its death is passed over."""
        with self._messages as pipe:
            for line in _lines(pipe, _LONGEST_MESSAGE):
                try:
                    yield MESSAGE.validate_json(line)
                except ValidationError:
                    log.warning("message_not_understood", line=line[:200])

    def lines(self) -> Iterator[str]:
        """What it and its libraries print, line by line, each cut to 4,000 characters."""
        with cast("IO[bytes]", self._child.stdout) as pipe:
            for line in _lines(pipe, 4 * _LONGEST_LINE):
                yield line.decode(errors="replace").rstrip("\n")[:_LONGEST_LINE]

    def poll(self, timeout_s: float) -> int | None:
        """Its exit status, waiting at most so long; negative: the signal that ended it."""
        if self._child.poll() is None:
            self._wait(timeout_s)
        return self._child.poll()

    def _wait(self, timeout_s: float) -> None:
        try:
            ended = os.pidfd_open(self._child.pid)
        except (AttributeError, OSError):  # Not a Linux, or an old one.
            with suppress(subprocess.TimeoutExpired):
                self._child.wait(timeout_s)
            return
        # `Popen.wait` with a time limit looks twenty times a second or more often; the training pays for it.
        poll = select.poll()
        poll.register(ended, select.POLLIN)
        poll.poll(1000 * timeout_s)
        os.close(ended)

    def stop(self, why: Stop) -> None:
        """Ask it, perhaps not for the first time, to keep what it has and exit.

        With a video, where the job will not go on.
        """
        self._signal_leader(DRAIN_SIGNAL if why is Stop.DRAIN else STOP_SIGNAL)

    def kill(self) -> None:
        """End it and everything it started, and see that nothing is left."""
        deadline = time.monotonic() + 10
        while _group_lives(self._child.pid) and time.monotonic() < deadline:
            try:
                os.killpg(self._child.pid, signal.SIGKILL)
            except ProcessLookupError:
                break
            self.poll(0.05)
        if _group_lives(self._child.pid):
            log.error("processes_left", process_group=self._child.pid)

    def _signal_leader(self, number: int) -> None:
        if self._child.poll() is None:
            self._child.send_signal(number)


def environment(device: str, data_dir: Path, base: Mapping[str, str]) -> dict[str, str]:
    """The variables of a process on this device: it sees that alone, and nobody's secrets."""
    kept = {name: value for name, value in base.items() if not _may_be_secret(name, value)}
    kept |= {"PYTHONUNBUFFERED": "1", "PYTHONSAFEPATH": "1", variable("data_dir"): str(data_dir)}
    kept |= _modules(base)
    kept |= {name: base[name] for name in _PASSED_ON if name in base}
    if device == "cpu":
        return {**kept, "JAX_PLATFORMS": "cpu", "CUDA_VISIBLE_DEVICES": ""}
    # In the order of their device files, which the slot's name stands on; CUDA's own is the fastest first.
    return {**kept, "CUDA_VISIBLE_DEVICES": device.partition(":")[2], "CUDA_DEVICE_ORDER": "PCI_BUS_ID"}


def _may_be_secret(name: str, value: str) -> bool:
    said = name.upper()
    return (
        said.startswith("GAITWAY_")
        or _OTHERS_ACCOUNTS.match(said) is not None
        or _SECRET.search(said) is not None
        or _WITH_PASSWORD.search(value) is not None
    )


def _modules(base: Mapping[str, str]) -> dict[str, str]:
    """Where Python finds these modules from any folder, also where they lie in a checkout."""
    if _CODE.name in ("site-packages", "dist-packages"):
        return {}
    return {"PYTHONPATH": os.pathsep.join(filter(None, (str(_CODE), base.get("PYTHONPATH"))))}


def _lines(pipe: IO[bytes], longest: int) -> Iterator[bytes]:
    """The lines, each cut to so many bytes: one without an end must not fill the memory."""
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
