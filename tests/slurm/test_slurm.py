"""Workers that a real Slurm starts, stops, preempts and loses: every job ends once, with the bytes of an
undisturbed run."""

import json
import os
import re
import shutil
import signal
import subprocess
import time
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from pathlib import Path

import pytest

from gaitway.service.embedded.processes import free_ports
from tests.slurm.conftest import OPTIONS
from tests.slurm.local_slurm import wait_until
from tests.slurm.world import GAITWAY, World, result, where

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]

# Some 20 s of training on a machine that does nothing else, with a checkpoint every few seconds.
STEPS = 1_600_000


@pytest.fixture(scope="session")
def undisturbed(world: World) -> Mapping[str, str]:
    world.keep_workers(OPTIONS)
    job = world.ended(world.submit(STEPS))
    assert len(job.attempts) == 1
    return result(job)


def test_twenty_jobs_share_the_allocations_and_an_empty_queue_holds_none(workers: World) -> None:
    jobs = [workers.ended(job) for job in [workers.submit(16_000, seed % 5) for seed in range(20)]]
    assert [len(job.attempts) for job in jobs] == [1] * 20
    for seed in range(5):
        assert len({tuple(sorted(result(job).items())) for job in jobs[seed::5]}) == 1
    assert {job.attempts[0].details["allocation"]["partition"] for job in jobs} == {"low"}
    assert len({where(job)["id"] for job in jobs}) <= 4
    wait_until(lambda: not workers.allocations(), 60)


def test_a_node_that_is_drained_and_taken_down_costs_only_time(
    workers: World, undisturbed: Mapping[str, str]
) -> None:
    first = workers.submit(STEPS)
    node = where(workers.trains(first, STEPS // 4))["node"]
    workers.slurm.command("scontrol", "update", f"nodename={node}", "state=drain", "reason=test")
    second = workers.submit(32_000, 1)
    assert where(workers.ended(second))["node"] != node or len(workers.client.get(first).attempts) == 1
    if not workers.client.get(first).is_final:
        workers.slurm.command("scontrol", "update", f"nodename={node}", "state=down", "reason=test")
    assert result(workers.ended(first)) == undisturbed


def test_a_node_that_is_taken_down_in_mid_training_gives_its_job_to_another(
    workers: World, undisturbed: Mapping[str, str]
) -> None:
    job = workers.submit(STEPS)
    node = where(workers.trains(job, STEPS // 4))["node"]
    workers.slurm.command("scontrol", "update", f"nodename={node}", "state=down", "reason=test")
    ended = workers.ended(job)
    # Slurm may have taken the node back meanwhile.
    assert (result(ended), len(ended.attempts)) == (undisturbed, 2)


def test_a_worker_that_is_cancelled_drains_and_another_one_goes_on(
    workers: World, undisturbed: Mapping[str, str]
) -> None:
    job = workers.submit(STEPS)
    workers.slurm.command("scancel", where(workers.trains(job, STEPS // 4))["id"])
    ended = workers.ended(job)
    assert [attempt.reason for attempt in ended.attempts] == ["worker_drained", "completed"]
    assert result(ended) == undisturbed


def test_hosts_that_share_a_job_start_together_drain_and_go_on_together(workers: World) -> None:
    # The nodes are one machine, which has no address by their names.
    coordinator = f"environment = {{GAITWAY_COORDINATOR = '127.0.0.1:{free_ports(1)[0]}'}}\n"
    workers.keep_workers(OPTIONS.replace("[cpu]", coordinator + "[cpu]\nhosts = [2]"))
    two = {"accelerator": "cpu", "hosts": 2}
    # On the two processors of one machine, the parts wait for each other at every update.
    alone = workers.ended(workers.submit(STEPS // 10, resources=two))
    job = workers.submit(STEPS // 10, resources=two)
    workers.slurm.command("scancel", where(workers.trains(job, STEPS // 50))["id"])
    ended = workers.ended(job)
    assert [attempt.reason for attempt in ended.attempts] == ["worker_drained", "completed"]
    assert result(ended) == result(alone)
    wait_until(lambda: not workers.allocations(), 90)


def test_a_preempted_worker_drains_and_another_one_goes_on(
    workers: World, undisturbed: Mapping[str, str]
) -> None:
    job = workers.submit(STEPS)
    workers.trains(job, STEPS // 4)
    for node in ("n1", "n2"):
        whole = ("-p", "high", "-w", node, "-n1", "-c4")
        workers.slurm.command("sbatch", *whole, "--output=/dev/null", "--wrap=sleep 5")
    ended = workers.ended(job)
    assert [attempt.reason for attempt in ended.attempts] == ["worker_drained", "completed"]
    assert result(ended) == undisturbed


def test_a_time_limit_in_mid_training_is_a_drain_before_it(workers: World) -> None:
    limited = OPTIONS.replace("[cpu]", "[cpu]\ntime = '1:00'")
    workers.keep_workers(limited)
    wait_until(lambda: not workers.allocations(), 90)  # One without a limit would take the job.
    job = workers.submit(STEPS, seed=7)
    ended = workers.ended(job, 600)
    reasons = [attempt.reason for attempt in ended.attempts]
    assert reasons[-1] == "completed"
    assert set(reasons[:-1]) == {"worker_drained"}
    assert "TIMEOUT" not in "".join(workers.worker_logs().values())
    workers.keep_workers(OPTIONS)
    assert result(workers.ended(workers.submit(STEPS, seed=7), 600)) == result(ended)


def test_a_slurmd_that_is_killed_loses_nothing(workers: World, undisturbed: Mapping[str, str]) -> None:
    job = workers.submit(STEPS)
    node = where(workers.trains(job, STEPS // 4))["node"]
    workers.slurm.stop(node, signal.SIGKILL)
    try:
        assert result(workers.ended(job)) == undisturbed
    finally:
        workers.slurm.start(node)
    wait_until(lambda: not workers.allocations(), 120)


def test_a_worker_that_is_killed_is_noticed_and_its_job_goes_on(
    workers: World, undisturbed: Mapping[str, str]
) -> None:
    job = workers.submit(STEPS)
    allocation = where(workers.trains(job, STEPS // 4))["id"]
    workers.slurm.command("scancel", "--signal=KILL", "--full", allocation)
    ended = workers.ended(job)
    # What was not killed at once still drains.
    assert [attempt.reason for attempt in ended.attempts][-1] == "completed"
    assert {attempt.reason for attempt in ended.attempts[:-1]} <= {"worker_lost", "worker_drained"}
    assert result(ended) == undisturbed


def test_a_worker_alone_that_is_killed_leaves_its_files_to_the_child_that_drains(
    workers: World, undisturbed: Mapping[str, str]
) -> None:
    job = workers.submit(STEPS)
    name = workers.trains(job, STEPS // 4).attempts[-1].worker
    (worker,) = [one for one in workers.client.workers() if one.name == name]
    os.kill(worker.pid, signal.SIGKILL)
    ended = workers.ended(job)
    assert [attempt.reason for attempt in ended.attempts] == ["worker_drained", "completed"]
    assert result(ended) == undisturbed


def test_while_slurmctld_is_away_nothing_is_started_and_afterwards_nothing_twice(
    workers: World, undisturbed: Mapping[str, str]
) -> None:
    first = workers.submit(STEPS)
    workers.trains(first, STEPS // 4)
    before = set(workers.worker_logs())
    workers.slurm.stop("slurmctld")
    second = workers.submit(STEPS, resources={"accelerator": "cpu"}, name="second")
    wait_until(lambda: "Slurm is away" in workers.said(), 60)
    workers.slurm.start("slurmctld")
    assert result(workers.ended(first)) == undisturbed
    assert result(workers.ended(second)) == undisturbed
    assert len(set(workers.worker_logs()) - before) <= 1


def test_one_that_is_started_again_finds_the_allocations_of_the_one_before(workers: World) -> None:
    job = workers.submit(STEPS)
    workers.trains(job)
    workers.end_cluster()
    queued = workers.submit(32_000, 3)
    before = set(workers.worker_logs())
    workers.keep_workers(OPTIONS.replace("max = 4", "max = 1"))
    assert len(workers.ended(job).attempts) == 1
    assert where(workers.ended(queued))["id"] == where(workers.client.get(job))["id"]
    assert set(workers.worker_logs()) == before


def test_a_node_without_a_driver_is_named_and_left_out(workers: World) -> None:
    on_gpus = OPTIONS.replace("[cpu]", "[gpu]")
    workers.keep_workers(on_gpus)
    job = workers.submit(32_000, resources={"accelerator": "gpu"})
    wait_until(lambda: "Nothing is started on" in workers.said(), 120)
    (sentence,) = re.findall(r"ended on n\d before its worker had begun\. Its last line: .*", workers.said())[
        :1
    ]
    assert "no NVIDIA GPU is visible here" in sentence
    assert workers.client.get(job).status == "queued"
    workers.client.cancel(job)
    wait_until(lambda: not workers.allocations(), 120)


def test_what_a_site_says_wrongly_is_refused_before_anything_is_started(world: World) -> None:
    for said, sentence in (
        ("[cpu]\npartition = 'nix'", "/cpu/partition: there is no partition 'nix'"),
        ("[gpu]\npartition = 'low'\ngpus = [4]", "/gpu/gpus: 4 GPUs of one node are wanted"),
        ("[cpu]\npartition = 'down'", "/cpu/partition: down is down"),
        (
            "[cpu]\ntime = '2:00:00'\ncpus = 2\nmem = '1G'",
            "/cpu/time: 2:00:00 is more than partition low allows",
        ),
        (
            "[cpu]\ncpus = 2\nmem = '1G'\noptions = ['--licenses=matlab']",
            "/cpu: Slurm refuses a job for cpu: ",
        ),
    ):
        world.keep_workers(f"tunnel = 'none'\n{said}")
        assert world.cluster_status() == 2
        assert sentence in world.said()


def test_from_a_post_without_a_worker_to_the_training_process_are_seconds(workers: World) -> None:
    wait_until(lambda: not workers.allocations(), 120)
    began = time.monotonic()
    job = workers.submit(32_000, seed=11)
    workers.wait_for(job, lambda job: job.progress.phase)
    assert time.monotonic() - began < 20
    workers.ended(job)


def test_nodes_reach_the_stores_by_ssh_alone(world: World, tmp_path: Path) -> None:
    with sshd(tmp_path) as tunnel:
        world.keep_workers(OPTIONS.replace('tunnel = "none"', "") + tunnel)
        job = world.ended(world.submit(32_000, seed=12))
        assert job.status == "succeeded"
        assert "They reach the stores by ssh to 127.0.0.1" in world.said()
        world.end_cluster()
        wait_until(lambda: not world.allocations(), 60)


def test_the_doctor_says_what_is_missing(world: World, tmp_path: Path) -> None:
    def doctor(*options: str) -> dict[str, tuple[str, str]]:
        command = [*GAITWAY, "doctor", "--slurm", "--json", "--data", str(world.data), *options]
        answer = subprocess.run(command, capture_output=True, text=True, timeout=200, check=False)
        return {one["name"]: (one["state"], one["detail"]) for one in json.loads(answer.stdout)["checks"]}

    good = doctor("--tunnel", "none", "--cpus", "2", "--mem", "1G", "--node")
    assert [state for state, _ in good.values()] == ["pass"] * 4
    assert good["a node (cpu)"][1].startswith("ready on ")
    assert doctor("--partition", "nix", "--cpus", "2", "--mem", "1G")["workers (cpu)"][0] == "fail"
    without_driver = doctor("--tunnel", "none", "--gpus", "1", "--cpus", "1", "--mem", "1G", "--node")
    assert "no NVIDIA GPU is visible here" in without_driver["a node (gpu1)"][1]
    unreachable = doctor("--tunnel", "127.0.0.1", "--cpus", "2", "--mem", "1G", "--node")
    assert re.search(r"has not forwarded the stores within 30 s: \S", unreachable["a node (cpu)"][1])
    from_here = doctor("--tunnel", "127.0.0.1", "--cpus", "2", "--mem", "1G")
    assert from_here["stores"][0] == "fail"
    assert from_here["stores"][1].startswith("ssh to 127.0.0.1 fails from here: ")
    with sshd(tmp_path) as tunnel:
        (tmp_path / "slurm.toml").write_text(f'[cpu]\ncpus = 2\nmem = "1G"\n{tunnel}')
        reached = doctor("--config", str(tmp_path / "slurm.toml"))
    assert reached["stores"] == ("pass", "nodes reach them by ssh to 127.0.0.1")


@contextmanager
def sshd(folder: Path) -> Generator[str]:
    """A real sshd on a free port, for the key of its folder; the options of a tunnel through it."""
    for name in ("host", "user"):
        subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", folder / name], check=True)
    (port,) = free_ports(1)
    # The key may forward, and nothing else.
    restricted = f'restrict,port-forwarding,command="/bin/false" {(folder / "user.pub").read_text()}'
    (folder / "authorized_keys").write_text(restricted)
    (folder / "known_hosts").write_text(f"[127.0.0.1]:{port} {(folder / 'host.pub').read_text()}")
    lines = (
        f"Port {port}",
        "ListenAddress 127.0.0.1",
        f"HostKey {folder}/host",
        f"AuthorizedKeysFile {folder}/authorized_keys",
        "StrictModes no",
        "PasswordAuthentication no",
        "UsePAM no",
        "PermitRootLogin yes",
        "PidFile none",
    )
    (folder / "config").write_text("\n".join(lines) + "\n")
    Path("/run/sshd").mkdir(exist_ok=True)
    program = shutil.which("sshd", path="/usr/sbin:/usr/local/sbin")
    if program is None:
        pytest.skip("There is no sshd here (Debian: openssh-server).")
    server = subprocess.Popen([program, "-D", "-e", "-f", folder / "config"], stderr=subprocess.DEVNULL)
    try:
        yield (
            f'[tunnel]\nhost = "127.0.0.1"\nport = {port}\nkey = "{folder}/user"\n'
            f'known_hosts = "{folder}/known_hosts"\n'
        )
    finally:
        server.terminate()
        server.wait(10)
