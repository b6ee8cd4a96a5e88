"""Slurm as a launcher: sbatch, squeue and scancel, each with a time limit.

A job's name carries the token of its service, so that another process of the same service finds it. An answer
that does not come is an outage, which is waited for: nothing is started again because of it.
"""

import getpass
import json
import os
import re
import secrets
import subprocess
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from core.errors import Misconfigured
from core.jobs.slots import SlotKind
from worker.cluster.launcher import Allocation, AllocationState, LaunchRefused, SchedulerAway

_TIMEOUT_S = 20.0
# Words of a Slurm client whose controller does not answer: what it asked may have been done.
_AWAY = re.compile(
    r"unable to contact slurm controller|socket timed out|connection (refused|reset|timed out)|"
    r"communication connection failure|zero bytes were transmitted|controller not responding|"
    r"controller .*standby|resource temporarily unavailable|unexpected message received|"
    r"slurm backend is not|transport endpoint is not connected|unable to establish con",
    re.IGNORECASE,
)
_STATES: dict[str, AllocationState] = {
    "PENDING": "pending",
    "CONFIGURING": "pending",
    "REQUEUED": "pending",
    "REQUEUE_FED": "pending",
    "REQUEUE_HOLD": "pending",
    "SPECIAL_EXIT": "pending",
    "RUNNING": "running",
    "SUSPENDED": "running",
    "STOPPED": "running",
    "RESIZING": "running",
    "SIGNALING": "running",
    "STAGE_OUT": "ending",
    "COMPLETING": "ending",
}
# A node where a worker could not start is left out for so long.
_EXCLUDED_S = 3600.0
_MOST_EXCLUDED = 20
# Of the sentence with which a worker refuses a device that is not there (worker/host/device.py).
_NO_GPU = "NVIDIA GPU"

# Why a job waits that has run already, or cannot run: Slurm lets one that is requeued wait for minutes, and
# holds one that it could not start on a node.
_STUCK = re.compile("BeginTime|held|NeverSatisfied|BadConstraints", re.IGNORECASE)

Script = Callable[[SlotKind, str, Sequence[str]], str]


def name_of(kind: SlotKind) -> str:
    """A kind in a job's name: `cpu`, `gpu4`, `gpu8x2`."""
    hosts = f"x{kind.hosts}" if kind.hosts > 1 else ""
    return f"{kind.accelerator}{kind.gpus or ''}{hosts}"


class Slurm:
    """A Launcher. token: of the service; script: the batch script of a kind, by name and excluded nodes.

    logs: the folder of the scripts' output.
    """

    def __init__(
        self,
        token: str,
        kinds: Collection[SlotKind],
        script: Script,
        logs: Path,
        timeout_s: float = _TIMEOUT_S,
    ) -> None:
        self._prefix = f"gaitway-{token}-"
        self._kinds = {name_of(kind): kind for kind in kinds}
        self._script = script
        self._logs = logs
        self._timeout_s = timeout_s
        self._excluded = dict[str, float]()

    def start(self, kind: SlotKind, number: int) -> None:
        now = time.monotonic()
        excluded = sorted(node for node, until in self._excluded.items() if until > now)
        for _ in range(number):
            name = f"{self._prefix}{name_of(kind)}-{secrets.token_hex(3)}"
            asked = self._asked("sbatch", "--parsable", stdin=self._script(kind, name, excluded))
            if asked.returncode != 0:
                raise LaunchRefused(sentence(asked.stderr))

    def what_runs(self) -> Sequence[Allocation]:
        answer = self._asked("squeue", "--noheader", f"--user={getpass.getuser()}", "--format=%i|%T|%N|%r|%j")
        if answer.returncode != 0:
            raise SchedulerAway(sentence(answer.stderr))
        found = (self._allocation(line) for line in answer.stdout.splitlines())
        return [one for one in found if one is not None]

    def stop(self, ids: Collection[str]) -> None:
        # One that has begun meanwhile, and may have a job, is not called off.
        answer = self._asked("scancel", "--state=PENDING", *sorted(ids))
        if answer.returncode != 0 and _AWAY.search(answer.stderr):
            raise SchedulerAway(sentence(answer.stderr))

    def explain(self, allocation: Allocation) -> str | None:
        log = self._logs / f"{allocation.id}.log"
        words = last_words(log)
        if _was_cancelled(log) or not (allocation.node or log.exists()):  # Perhaps before it had begun.
            return None
        told = (
            f"Its last line: {words}" if words else f"It printed nothing ({self._logs / allocation.id}.log)."
        )
        if allocation.node and _NO_GPU in words:
            self._leave_out(allocation.node)
            told += f" Nothing is started on {allocation.node} for an hour: mend its driver, or drain it."
        return told

    def _leave_out(self, node: str) -> None:
        """The oldest of many comes back earlier."""
        self._excluded.pop(node, None)
        self._excluded[node] = time.monotonic() + _EXCLUDED_S
        while len(self._excluded) > _MOST_EXCLUDED:
            del self._excluded[next(iter(self._excluded))]

    def _allocation(self, line: str) -> Allocation | None:
        parts = line.split("|", 4)
        if len(parts) != 5 or not parts[4].startswith(self._prefix):
            return None
        job, state, node, reason, name = parts
        kind = self._kinds.get(name.removeprefix(self._prefix).rpartition("-")[0])
        if kind is None:  # Another configuration of this service has started it.
            return None
        now = _STATES.get(state, "ending")
        is_stuck = now == "pending" and _STUCK.search(reason) is not None
        return Allocation(job, kind, "stuck" if is_stuck else now, node, reason)

    def _asked(self, *command: str, stdin: str = "") -> subprocess.CompletedProcess[str]:
        return ask(command, stdin, self._timeout_s)


def last_words(log: Path) -> str:
    """The log's last line; a worker that cannot work writes its reason there. Empty without a log."""
    try:
        with log.open("rb") as file:
            file.seek(max(0, file.seek(0, os.SEEK_END) - 8192))
            lines = file.read().decode(errors="replace").splitlines()
    except OSError:
        return ""
    # Slurm's own lines come after the worker's.
    told = [line.strip() for line in lines if line.strip() and not line.startswith("slurmstepd")]
    for line in reversed(told):
        with suppress(ValueError, TypeError, KeyError):
            said = json.loads(line)
            if said["event"] == "misconfigured":
                return str(said["detail"])[:1000]
    return told[-1][:1000] if told else ""


def _was_cancelled(log: Path) -> bool:
    """Whether Slurm ended it: by scancel, for a time limit, a preemption or a node that failed."""
    try:
        return "CANCELLED AT" in log.read_text(errors="replace")[-8192:]
    except OSError:
        return False


def ask(
    command: Sequence[str], stdin: str = "", timeout_s: float = _TIMEOUT_S
) -> subprocess.CompletedProcess[str]:
    """A Slurm program's answer. Raises SchedulerAway where the controller does not answer; Misconfigured
    where the program is not installed."""
    try:
        answer = subprocess.run(
            command,
            input=stdin,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=timeout_s,
            check=False,
            env=environment(os.environ),
        )
    except FileNotFoundError:
        raise Misconfigured(
            f"{command[0]} is not installed here, or not in PATH: run this on a login node of the cluster."
        ) from None
    except PermissionError as error:
        raise Misconfigured(f"{command[0]} may not be run here: {error}.") from None
    except subprocess.TimeoutExpired:
        raise SchedulerAway(f"{command[0]} has not answered within {timeout_s:g} s.") from None
    if answer.returncode != 0 and _AWAY.search(answer.stderr):
        raise SchedulerAway(sentence(answer.stderr))
    return answer


def environment(base: Mapping[str, str]) -> dict[str, str]:
    """What sbatch sees, and keeps for the job: no settings of ours, and not those of a surrounding job."""
    kept = ("SLURM_CONF", "SLURM_CLUSTERS", "SLURM_JWT")
    return {
        name: value
        for name, value in base.items()
        if name in kept or not name.startswith(("GAITWAY_", "SLURM_", "SLURMD_"))
    }


def sentence(stderr: str) -> str:
    """A sentence of what a Slurm program complains of, without its own name."""
    lines = [re.sub(r"^\w+: (error: )?", "", line).strip() for line in stderr.splitlines() if line.strip()]
    text = " ".join(dict.fromkeys(lines)) or "it gave no reason"
    return text if text.endswith(".") else f"{text}."
