"""A real Slurm on this machine: slurmctld, two slurmd with two pretended GPUs each, and munge.

It is made of what the system has (Debian: `slurm-wlm munge`), and needs root, as slurmd does. Partitions:
`low`, whose jobs `high` preempts by requeueing them, and `down`. Nodes n1 and n2 are this machine twice.

By hand: `python -m tests.slurm.local_slurm FOLDER` starts one, prints its SLURM_CONF, and stays.
"""

import os
import pwd
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Self

PROGRAMS = ("slurmctld", "slurmd", "munged", "sbatch", "scontrol")
_MUNGE_SOCKET = Path("/run/munge/munge.socket.2")
_CONF = """ClusterName=test
SlurmctldHost={host}(127.0.0.1)
SlurmUser=root
SlurmdUser=root
AuthType=auth/munge
StateSaveLocation={folder}/ctl
SlurmdSpoolDir={folder}/%n
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/%n.pid
SlurmctldLogFile={folder}/slurmctld.log
SlurmdLogFile={folder}/%n.log
SlurmctldPort={ports[0]}
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SchedulerType=sched/backfill
SchedulerParameters=bf_interval=1,sched_interval=2
SelectType=select/cons_tres
SelectTypeParameters=CR_Core_Memory
SlurmdParameters=config_overrides
ReturnToService=2
KillWait={kill_wait_s}
MessageTimeout=5
SlurmdTimeout=10
InactiveLimit=0
OverTimeLimit=0
PreemptType=preempt/partition_prio
PreemptMode=REQUEUE
GresTypes=gpu
NodeName=n1 NodeHostname={host} NodeAddr=127.0.0.1 Port={ports[1]} CPUs=4 RealMemory=8000 Gres=gpu:2
NodeName=n2 NodeHostname={host} NodeAddr=127.0.0.1 Port={ports[2]} CPUs=4 RealMemory=8000 Gres=gpu:2
PartitionName=low Nodes=n1,n2 Default=YES MaxTime=60 PriorityTier=1 PreemptMode=REQUEUE GraceTime={grace_s}
PartitionName=high Nodes=n1,n2 MaxTime=60 PriorityTier=10 PreemptMode=OFF
PartitionName=down Nodes=n1 MaxTime=60 State=DOWN
"""


def missing() -> str | None:
    """A sentence if none can run here."""
    lacks = [name for name in PROGRAMS if shutil.which(name) is None]
    if lacks:
        return f"There is no Slurm here: {lacks[0]} is not installed (Debian: slurm-wlm munge)."
    if os.getuid() != 0:
        return "A Slurm of one's own needs root, as slurmd does."
    return None


class LocalSlurm:
    """Runs from entry to exit. It sets SLURM_CONF for this process and what it starts.

    kill_wait_s: from SIGTERM to SIGKILL at a job's end. grace_s: the same when a job is preempted.
    """

    def __init__(self, folder: Path, *, kill_wait_s: int = 30, grace_s: int = 20) -> None:
        self.folder = folder.absolute()
        self._times = {"kill_wait_s": kill_wait_s, "grace_s": grace_s}
        self._processes = dict[str, subprocess.Popen[bytes]]()
        self._munge: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> Self:
        host = socket.gethostname().partition(".")[0]
        for name in ("ctl", "n1", "n2"):
            (self.folder / name).mkdir(parents=True, exist_ok=True)
        conf = _CONF.format(host=host, folder=self.folder, ports=_free_ports(3), **self._times)
        (self.folder / "slurm.conf").write_text(conf)
        (self.folder / "gres.conf").write_text(
            "".join(f"NodeName=n{number} Name=gpu File=/dev/null,/dev/zero\n" for number in (1, 2))
        )
        os.environ["SLURM_CONF"] = str(self.folder / "slurm.conf")
        try:
            self._start_munge()
            self.start("slurmctld")
            self.start("n1")
            self.start("n2")
            wait_until(lambda: self.count_idle() == 2, 60)
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        if "slurmctld" in self._processes:
            self.command("scancel", "--user=root", check=False)
            # Without the controller nobody would end what is left of them.
            with suppress(TimeoutError):
                wait_until(lambda: not self.jobs(), self._times["kill_wait_s"] + 10)
        for name in list(self._processes):
            self.stop(name)
        if self._munge is not None:
            self._munge.terminate()
            self._munge.wait(10)
        os.environ.pop("SLURM_CONF", None)

    def start(self, name: str) -> None:
        """Start slurmctld, or the slurmd of a node."""
        command = ["slurmctld", "-D"] if name == "slurmctld" else ["slurmd", "-D", "-N", name]
        with (self.folder / f"{name}.out").open("ab") as out:
            self._processes[name] = subprocess.Popen(
                command, stdout=out, stderr=out, stdin=subprocess.DEVNULL, start_new_session=True
            )

    def stop(self, name: str, signal_number: signal.Signals = signal.SIGTERM) -> None:
        """End one of them; the jobs' own processes go on."""
        process = self._processes.pop(name)
        process.send_signal(signal_number)
        try:
            process.wait(20)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait(10)

    def command(self, *command: str, check: bool = True) -> str:
        """What a Slurm program prints."""
        answer = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
        if check and answer.returncode != 0:
            raise RuntimeError(f"{' '.join(command)}: {answer.stderr.strip()}")
        return answer.stdout

    def count_idle(self) -> int:
        """The number of nodes that are idle."""
        return int(
            self.command("sinfo", "-h", "-p", "low", "-t", "idle", "-o", "%D", check=False).strip() or 0
        )

    def jobs(self) -> list[tuple[str, str, str, str]]:
        """Id, state, node and name of every job that has not ended."""
        lines = self.command("squeue", "-h", "-o", "%i|%T|%N|%j", check=False).splitlines()
        return [tuple(line.split("|")) for line in lines]  # pyright: ignore[reportReturnType]

    def _start_munge(self) -> None:
        if _MUNGE_SOCKET.exists() and _answers_munge():
            return
        user = pwd.getpwnam("munge")
        _MUNGE_SOCKET.parent.mkdir(exist_ok=True)
        for folder in (_MUNGE_SOCKET.parent, Path("/var/log/munge"), Path("/var/lib/munge")):
            if folder.exists():
                os.chown(folder, user.pw_uid, user.pw_gid)
        self._munge = subprocess.Popen(
            ["munged", "--foreground", "--force"],
            user=user.pw_uid,
            group=user.pw_gid,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        wait_until(_answers_munge, 20)


def _answers_munge() -> bool:
    return subprocess.run(["munge", "-n"], capture_output=True, timeout=10, check=False).returncode == 0


def wait_until(is_true: Callable[[], object], timeout_s: float) -> None:
    """Poll it: what happens in other programs tells nobody. Raises TimeoutError."""
    deadline = time.monotonic() + timeout_s
    while not is_true():
        if time.monotonic() > deadline:
            raise TimeoutError(f"Not within {timeout_s:g} s.")
        time.sleep(0.1)


def _free_ports(number: int) -> list[int]:
    sockets = [socket.create_server(("127.0.0.1", 0)) for _ in range(number)]
    ports = [one.getsockname()[1] for one in sockets]
    for one in sockets:
        one.close()
    return ports


def main() -> None:
    if (sentence := missing()) is not None:
        sys.exit(sentence)
    told: list[int] = []
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda number, _: told.append(number))
    with LocalSlurm(Path(sys.argv[1])):
        print(f"export SLURM_CONF={os.environ['SLURM_CONF']}", flush=True)
        while not told:
            time.sleep(0.2)


if __name__ == "__main__":
    main()
