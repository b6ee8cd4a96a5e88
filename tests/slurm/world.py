"""A service whose workers are Slurm's: Slurm, `gaitway up --workers 0`, and `gaitway cluster slurm`."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Self

from gaitway.client import Client
from gaitway.schema import JobView
from gaitway.service.embedded.processes import free_ports
from tests.compiling import compiling_quickly
from tests.faults.bench import SPEC
from tests.slurm.local_slurm import LocalSlurm

# Enough for a worker to start, and for a training to be compiled, on a busy machine.
PATIENCE_S = 300.0


class World:
    """Everything runs from entry to exit. kill_wait_s, grace_s: as `LocalSlurm` has them."""

    def __init__(self, folder: Path, *, kill_wait_s: int = 30, grace_s: int = 20) -> None:
        self.folder = folder
        self.slurm = LocalSlurm(folder / "slurm", kill_wait_s=kill_wait_s, grace_s=grace_s)
        self.data = folder / "data"
        self.port = free_ports(1)[0]
        self.client = Client(f"http://127.0.0.1:{self.port}")
        self._up: subprocess.Popen[str] | None = None
        self._cluster: subprocess.Popen[bytes] | None = None
        self._options = ""

    def __enter__(self) -> Self:
        self.slurm.__enter__()
        try:
            command = [*_UP, "--workers", "0", "--data", str(self.data), "--port", str(self.port)]
            with (self.folder / "up.log").open("wb") as log:
                self._up = subprocess.Popen(
                    command, stdout=subprocess.PIPE, stderr=log, stdin=subprocess.DEVNULL, text=True
                )
            assert self._up.stdout is not None
            assert self._up.stdout.readline(), (self.folder / "up.log").read_text()
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.end_cluster()
        self.slurm.command("scancel", "--user=root", check=False)
        self.client.close()
        if self._up is not None:
            self._up.send_signal(signal.SIGTERM)
            self._up.communicate(timeout=60)
        self.slurm.__exit__()

    # ---- what keeps workers ----------------------------------------------------------------------

    def keep_workers(self, options: str) -> None:
        """Start `gaitway cluster slurm` with this TOML; end the one before."""
        self.end_cluster()
        file = self.folder / "slurm.toml"
        file.write_text(options)
        command = [*GAITWAY, "cluster", "slurm", "--data", str(self.data), "--config", str(file)]
        with (self.folder / "cluster.log").open("ab") as log:
            self._cluster = subprocess.Popen(
                command,
                stdout=log,
                stderr=log,
                stdin=subprocess.DEVNULL,
                env={**os.environ, **compiling_quickly()},
            )

    def restart_cluster(self, signal_number: signal.Signals) -> None:
        """End `gaitway cluster slurm` by a signal, and start it again with the same options."""
        assert self._cluster is not None
        self._cluster.send_signal(signal_number)
        self._cluster.wait(60)
        self._cluster = None
        self.keep_workers((self.folder / "slurm.toml").read_text())

    def end_cluster(self) -> None:
        if self._cluster is not None:
            self._cluster.send_signal(signal.SIGTERM)
            self._cluster.wait(60)
            (self.folder / "cluster.log").write_text("")
            self._cluster = None

    def cluster_status(self) -> int:
        """The exit status of `gaitway cluster slurm`, which ends by itself."""
        assert self._cluster is not None
        return self._cluster.wait(60)

    def said(self) -> str:
        """What `gaitway cluster slurm` has printed so far."""
        return (self.folder / "cluster.log").read_text()

    def worker_logs(self) -> dict[str, str]:
        """The output of each allocation that there ever was, by its id."""
        return {file.stem: file.read_text() for file in (self.data / "cluster" / "logs").glob("*.log")}

    def allocations(self) -> list[tuple[str, str, str]]:
        """Id, state and node of each allocation that has not ended."""
        return [
            (job, state, node) for job, state, node, name in self.slurm.jobs() if name.startswith("gaitway-")
        ]

    # ---- jobs ------------------------------------------------------------------------------------

    def submit(self, steps: int, seed: int = 0, **fields: Any) -> str:
        """A small training on a CPU, without a video."""
        algorithm = {**SPEC["algorithm"], "num_timesteps": steps}
        spec = {
            **SPEC,
            "algorithm": algorithm,
            "seed": seed,
            "video": None,
            "resources": {"accelerator": "cpu"},
            "max_attempts": 20,
            **fields,
        }
        return self.client.submit(spec).id

    def wait_for(
        self, job_id: str, is_true: Callable[[JobView], object], timeout_s: float = PATIENCE_S
    ) -> JobView:
        """The job once that is true of it. Raises TimeoutError."""
        deadline = time.monotonic() + timeout_s
        while not is_true(job := self.client.get(job_id)):
            if time.monotonic() > deadline or (job.is_final and not is_true(job)):
                raise TimeoutError(
                    f"{job.status} {job.reason} {job.message}; {self.said()}; {self.worker_logs()}"
                )
            time.sleep(0.1)
        return job

    def trains(self, job_id: str, steps: int = 1) -> JobView:
        """The job once it has trained for these steps."""
        return self.wait_for(job_id, lambda job: job.status == "running" and job.progress.step >= steps)

    def ended(self, job_id: str, timeout_s: float = PATIENCE_S) -> JobView:
        return self.wait_for(job_id, lambda job: job.is_final, timeout_s)


def where(job: JobView) -> Mapping[str, str]:
    """What Slurm calls the allocation of the job's newest attempt."""
    return job.attempts[-1].details["allocation"]


def result(job: JobView) -> Mapping[str, str]:
    """The hashes of what a training leaves and another one with the same seed leaves as well."""
    assert job.status == "succeeded", (job.reason, job.message)
    return {
        file.name: file.sha256
        for file in job.artifacts
        if file.role == "policy" or (file.role == "checkpoint" and file.step == job.progress.step)
    }


_UP = (sys.executable, "-m", "gaitway.service.embedded.up")
GAITWAY = (sys.executable, "-c", "from gaitway.cli import main; main()")
