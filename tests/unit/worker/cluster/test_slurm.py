"""Slurm's programs that refuse, hang, or are not there; the real ones are in tests/slurm."""

import getpass
from collections.abc import Callable
from pathlib import Path

import pytest

from core.errors import Misconfigured
from core.jobs.slots import CPU, SlotKind
from worker.cluster.launcher import Allocation, LaunchRefused, SchedulerAway
from worker.cluster.slurm import Slurm

Program = Callable[[str, str], None]
FOUR = SlotKind("gpu", 4)


@pytest.fixture
def program(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Program:
    """Makes a program of this name the only one of the PATH, besides the system's."""
    folder = tmp_path / "bin"
    folder.mkdir()
    monkeypatch.setenv("PATH", f"{folder}:/usr/bin:/bin")

    def make(name: str, body: str) -> None:
        file = folder / name
        file.write_text(f"#!/bin/sh\n{body}\n")
        file.chmod(0o755)

    return make


@pytest.fixture
def slurm(tmp_path: Path) -> Slurm:
    def script(kind: SlotKind, name: str, exclude: object) -> str:
        return f"{name} without {exclude}\n"

    return Slurm("t0", [CPU, FOUR], script, tmp_path, timeout_s=0.5)


def test_a_job_is_named_after_service_and_kind(slurm: Slurm, program: Program, tmp_path: Path) -> None:
    program("sbatch", f"cat >>{tmp_path}/sent; env | grep -c GAITWAY_ >>{tmp_path}/sent; echo 7")
    slurm.start(FOUR, 2)
    names = [line.split()[0].rpartition("-")[0] for line in (tmp_path / "sent").read_text().splitlines()[::2]]
    assert names == ["gaitway-t0-gpu4", "gaitway-t0-gpu4"]
    assert (tmp_path / "sent").read_text().splitlines()[1::2] == ["0", "0"]


def test_a_refusal_says_what_slurm_says(slurm: Slurm, program: Program) -> None:
    program(
        "sbatch",
        "echo 'sbatch: error: Batch job submission failed: Invalid account or account/partition combination "
        "specified' >&2; exit 1",
    )
    with pytest.raises(
        LaunchRefused, match=r"^Batch job submission failed: Invalid account or .* specified\.$"
    ):
        slurm.start(CPU, 1)


@pytest.mark.parametrize(
    "body",
    [
        "echo 'sbatch: error: Batch job submission failed: Unable to contact slurm controller' >&2; exit 1",
        "echo 'sbatch: error: Batch job submission failed: Socket timed out on send/recv' >&2; exit 1",
        "exec sleep 60",
    ],
)
def test_a_controller_that_is_away_or_hangs_is_no_refusal(slurm: Slurm, program: Program, body: str) -> None:
    program("sbatch", body)
    program("squeue", body)
    program("scancel", body)
    for call in (lambda: slurm.start(CPU, 1), slurm.what_runs, lambda: slurm.stop(["1"])):
        with pytest.raises(SchedulerAway):
            call()


def test_a_machine_without_slurm_is_told_so(
    slurm: Slurm, program: Program, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", "/nowhere")
    with pytest.raises(Misconfigured, match="sbatch is not installed here, or not in PATH"):
        slurm.start(CPU, 1)


def test_only_allocations_of_this_service_are_its_own(slurm: Slurm, program: Program) -> None:
    rows = [
        "1|RUNNING|n1|None|gaitway-t0-cpu-ab12cd",
        "2|PENDING||Resources|gaitway-t0-gpu4-ab12cd",
        "3|COMPLETING|n2|None|gaitway-t0-cpu-ab12cd",
        "4|RUNNING|n2|None|gaitway-other-cpu-ab12cd",
        "5|RUNNING|n2|None|gaitway-t0-gpu2-ab12cd",
        "6|RUNNING|n2|None|somebody|else",
        "7|PENDING||BeginTime|gaitway-t0-cpu-ab12cd",
        "8|PENDING||launch failed requeued held|gaitway-t0-cpu-ab12cd",
    ]
    listed = "\\n".join(rows)
    program("squeue", f'[ "$2" = --user={getpass.getuser()} ] && printf "{listed}\\n"')
    assert slurm.what_runs() == [
        Allocation("1", CPU, "running", "n1", "None"),
        Allocation("2", FOUR, "pending", "", "Resources"),
        Allocation("3", CPU, "ending", "n2", "None"),
        Allocation("7", CPU, "stuck", "", "BeginTime"),
        Allocation("8", CPU, "stuck", "", "launch failed requeued held"),
    ]


def test_a_node_without_a_driver_is_left_out_and_named(
    slurm: Slurm, program: Program, tmp_path: Path
) -> None:
    sentence = "GAITWAY_DEVICE=gpu:0, but no NVIDIA GPU is visible here."
    (tmp_path / "9.log").write_text(
        f'{{"detail": "{sentence}", "event": "misconfigured"}}\nslurmstepd: error: it ended\n'
    )
    told = slurm.explain(Allocation("9", FOUR, "running", "n2"))
    assert (
        told
        == f"Its last line: {sentence} Nothing is started on n2 for an hour: mend its driver, or drain it."
    )
    program("sbatch", f"cat >>{tmp_path}/sent; echo 7")
    slurm.start(FOUR, 1)
    assert "without ['n2']" in (tmp_path / "sent").read_text()
    assert "It printed nothing" in str(slurm.explain(Allocation("10", CPU, "running", "n1")))
    (tmp_path / "11.log").write_text(
        "slurmstepd-n1: error: *** JOB 11 ON n1 CANCELLED AT 2026-11-27T19:55:11 ***"
    )
    assert slurm.explain(Allocation("11", CPU, "running", "n1")) is None
