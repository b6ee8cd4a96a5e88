"""Runs shown elsewhere: what arrives, and that nothing of it ever costs a job anything."""

import io
import json
import os
import signal
import socket
import subprocess
import sys
import tarfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import psutil
import pytest
from pydantic import SecretStr
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from core.adapters.postgres.store import PostgresJobStore
from core.jobs.job import Job
from core.jobs.status import JobStatus
from core.settings import WorkerSettings
from tests.faults.bench import Bench, wait_until
from tests.faults.wandb_server import WandbServer, wandb_server
from worker.supervision import tracking
from worker.tracking import live

pytestmark = pytest.mark.extra

KEY = "0123456789abcdef0123456789abcdef01234567"
ONLINE = {"wandb": {"project": "vnl"}}
OFFLINE = {"wandb": {"project": "vnl", "mode": "offline"}}
LABELS = {"task_name": "run"}


@pytest.fixture
def bench(tmp_path: Path, job_store: PostgresJobStore, monkeypatch: pytest.MonkeyPatch) -> Iterator[Bench]:
    monkeypatch.setenv("PROBE_WAITS_FOR", str(tmp_path / "go"))
    yield Bench(tmp_path, job_store)
    assert left_overs(tmp_path) == []


@pytest.fixture
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """The end of a job waits as long as a busy machine needs to send a run."""
    for limit in ("_FINISH_S", "_OPEN_S"):
        monkeypatch.setattr(live, limit, 60.0)


def left_overs(folder: Path) -> list[str]:
    """Processes that were started for somebody who works in this folder."""
    found: list[str] = []
    for process in psutil.process_iter():
        try:
            if process.environ().get("HOME", "").startswith(str(folder)):
                found.append(" ".join(process.cmdline()))
        except psutil.Error:
            continue
    return found


def that_lead_to(url: str, settings: WorkerSettings) -> WorkerSettings:
    """These settings with a Weights & Biases server."""
    return settings.model_copy(update={"wandb_api_key": SecretStr(KEY), "wandb_base_url": url})


def speaks_to(bench: Bench, url: str) -> None:
    bench.settings = that_lead_to(url, bench.settings)


@contextmanager
def going(bench: Bench, job: Job, behaviour: str) -> Iterator[None]:
    """An attempt that goes on as soon as the block is left; after that, it has ended."""
    flag = bench.settings.data_dir / "go"
    flag.unlink(missing_ok=True)
    thread = threading.Thread(target=bench.supervisor(job, behaviour).run)
    thread.start()
    try:
        yield
    finally:
        flag.touch()
        thread.join(60)
    assert not thread.is_alive()


def notes(bench: Bench, job: Job) -> list[str]:
    return [entry.data["text"] for entry in bench.feed(job, "events", kind="note")]


def body(bench: Bench, job: Job, role: Any) -> bytes:
    artifact = bench.store.get(job.id).newest(role)
    assert artifact is not None
    return bench.objects.get(artifact.key)


def measured(rows: list[dict[str, Any]]) -> list[tuple[int, float]]:
    name = "eval/episode_reward"
    return [(row["num_steps"], row[name]) for row in rows if name in row]


def assert_has_what_a_notebook_sends(server: WandbServer, job: Job) -> None:
    """Name, axis, flat configuration, video and policy: the same whether it was sent at once or later."""
    assert server.upserts[0]["displayName"] == f"ant_run_ppo_{job.id[-10:]}"
    config = {name: entry["value"] for name, entry in json.loads(server.upserts[-1]["config"]).items()}
    names = {"env_name": "ant", "task_name": "run", "algo_name": "ppo", "learning_rate": 0.25, "job": job.id}
    assert {name: config[name] for name in names} == names
    # Beside the whole specification, with the hyperparameters as they were resolved.
    assert (config["environment"]["id"], config["labels"], config["seed"]) == ("ant", LABELS, 0)
    assert config["algorithm"]["learning_rate"] == 0.25
    # W&B's keys: 1 and 2 are a metric's name, or pattern; 5 is the number of its axis, from 1.
    axis, everything = config["_wandb"]["m"]
    assert (axis["1"], everything["2"], everything["5"]) == ("num_steps", "*", 1)
    (shown,) = (row for row in server.rows() if "video" in row)
    assert (shown["num_steps"], shown["video"]["_type"]) == (20, "video-file")
    assert server.uploads[shown["video"]["path"]] == b"film"
    (policy,) = server.artifacts.created
    assert (policy["artifactCollectionName"], policy["artifactTypeName"]) == (f"policy-{job.id}", "model")
    about = {"env_name": "ant", "task_name": "run", "algo_name": "ppo", "num_steps": 20}
    assert json.loads(policy["metadata"]) == about
    assert server.artifacts.whole == {0}
    assert server.uploads["artifacts/0/policy"] == b"weights"


def test_scalars_for_tensorboard_are_the_stored_metrics_of_all_attempts(bench: Bench, tmp_path: Path) -> None:
    job = bench.submit()
    with going(bench, job, "is_killed_after_a_measurement"):
        pass
    with going(bench, job, "is_filmed"):
        pass
    (tmp_path / "events.out.tfevents").write_bytes(body(bench, job, "tensorboard"))
    events = EventAccumulator(str(tmp_path / "events.out.tfevents")).Reload()
    rows = bench.feed(job, "events", kind="metrics")
    assert [row.data["step"] for row in rows] == [5, 10, 20]
    assert events.Tags()["scalars"] == ["eval/episode_reward"]
    # Sums of few powers of two are the same in the file's 32 bits.
    assert [(e.step, e.value, e.wall_time) for e in events.Scalars("eval/episode_reward")] == [
        (row.data["step"], row.data["values"]["eval/episode_reward"], row.time.timestamp()) for row in rows
    ]


def test_an_offline_run_is_an_artifact_that_wandb_can_sync(bench: Bench, tmp_path: Path) -> None:
    (tmp_path / "go").touch()
    job = bench.run("is_filmed", tracking=OFFLINE, labels=LABELS)
    assert (job.status, notes(bench, job)) == (JobStatus.SUCCEEDED, [])
    folder = tmp_path / "fetched"
    with tarfile.open(fileobj=io.BytesIO(body(bench, job, "wandb"))) as archive:
        # The filter came with Python 3.11.4.
        safely = {"filter": "data"} if hasattr(tarfile, "data_filter") else {}
        archive.extractall(folder, **safely)  # noqa: S202 - we have just written it
    (run,) = folder.iterdir()
    files = sorted(str(path.relative_to(run)) for path in run.rglob("*") if path.is_file())
    assert files[0].startswith("files/media/videos/video_")
    assert files[1:] == ["policy/policy", f"run-{job.id}.wandb"]
    with wandb_server() as server:
        # As a user would, elsewhere and with a key of one's own.
        surroundings = {"WANDB_API_KEY": KEY, "WANDB_BASE_URL": server.url, "HOME": str(tmp_path)}
        said = subprocess.run(
            [sys.executable, "-m", "wandb", "sync", run.name],
            env={**os.environ, **surroundings},
            cwd=folder,  # Where it looks for the policy.
            check=True,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
        )
        assert measured(server.rows()) == [(10, 2.5), (20, 5.0)], said.stdout.decode()
        assert_has_what_a_notebook_sends(server, job)


@pytest.mark.usefixtures("patient")
def test_a_run_is_shown_while_it_goes_on_and_a_second_attempt_continues_it(bench: Bench) -> None:
    with wandb_server() as server:
        speaks_to(bench, server.url)
        job = bench.submit(tracking=ONLINE, labels=LABELS)
        with going(bench, job, "is_killed_after_a_measurement"):
            wait_until(lambda: bool(server.upserts), 60)
        said = len(server.upserts)
        with going(bench, job, "is_filmed"):
            wait_until(lambda: len(server.upserts) > said, 60)
    assert measured(server.rows()) == [(5, 0.5), (10, 2.5), (20, 5.0)]
    runs = {(upsert["project"], upsert["name"]) for upsert in server.upserts}
    assert runs == {("vnl", job.id)}
    assert_has_what_a_notebook_sends(server, job)
    assert server.streams[-1]["exitcode"] == 0
    # The key was where it belongs, and is nowhere else.
    assert server.keys == {KEY}
    kept = b"".join(bench.objects.get(info.key) for info in bench.objects.list(""))
    ended = bench.store.get(job.id)
    feeds = [entry.data for entry in (*bench.feed(job, "events"), *bench.feed(job, "logs"))]
    assert KEY not in kept.decode(errors="replace") + ended.model_dump_json() + json.dumps(feeds)
    # All of it is there: no file is needed.
    assert (ended.status, ended.newest("wandb"), notes(bench, job)) == (JobStatus.SUCCEEDED, None, [])


def test_a_server_that_refuses_the_key_costs_a_note_and_leaves_the_run_as_a_file(bench: Bench) -> None:
    with wandb_server(status=401) as server:
        speaks_to(bench, server.url)
        job = bench.submit(tracking=ONLINE)
        with going(bench, job, "is_filmed"):
            wait_until(lambda: bool(notes(bench, job)), 60)
    (note,) = notes(bench, job)
    assert note.startswith("Weights & Biases accepted no more of this run: CommError")
    assert "401" in note
    assert bench.store.get(job.id).status == JobStatus.SUCCEEDED
    assert len(body(bench, job, "wandb")) > 1000


@pytest.mark.usefixtures("patient")
def test_a_server_that_refuses_the_policy_costs_a_note_and_leaves_the_run_as_a_file(bench: Bench) -> None:
    (bench.settings.data_dir / "go").touch()
    with wandb_server() as server:
        server.refused = "CreateArtifact"
        speaks_to(bench, server.url)
        job = bench.run("is_filmed", tracking=ONLINE)
    (note,) = notes(bench, job)
    assert note.startswith("Weights & Biases accepted no more of this run: ")
    assert "no CreateArtifact here" in note
    assert job.status == JobStatus.SUCCEEDED
    with tarfile.open(fileobj=io.BytesIO(body(bench, job, "wandb"))) as archive:
        assert any(name.endswith("/policy/policy") for name in archive.getnames())


def test_a_server_that_never_answers_delays_no_job(bench: Bench) -> None:
    with socket.create_server(("127.0.0.1", 0)) as silent:
        speaks_to(bench, f"http://127.0.0.1:{silent.getsockname()[1]}")
        (bench.settings.data_dir / "go").touch()
        began = time.monotonic()
        job = bench.run("is_filmed", tracking=ONLINE)
    # Two seconds of grace, and a few to write the files; wandb itself would try for minutes.
    assert time.monotonic() - began < 20
    assert job.status == JobStatus.SUCCEEDED
    assert notes(bench, job) == [
        "Weights & Biases was too slow: the job has ended, and does not wait for it."
    ]
    assert len(body(bench, job, "wandb")) > 1000


def test_a_worker_without_the_package_says_so_once(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tracking, "find_spec", lambda name: None)
    (bench.settings.data_dir / "go").touch()
    job = bench.run("is_filmed", tracking=ONLINE)
    (note,) = notes(bench, job)
    assert "uv sync --inexact --extra wandb" in note
    assert (job.status, job.newest("wandb")) == (JobStatus.SUCCEEDED, None)
    assert job.newest("tensorboard") is not None


# Stands for a supervisor: has a run opened, and is killed.
_SUPERVISOR = """
import sys, time
from pathlib import Path
from core.jobs.spec import JOB_SPEC
from tests.faults.bench import unused_servers
from tests.faults.test_tracking import that_lead_to
from worker.tracking.config import about_run
from worker.tracking.live import Live
folder = Path(sys.argv[1])
settings = that_lead_to(sys.argv[2], unused_servers(folder))
tracking = {"wandb": {"project": "vnl"}}
spec = JOB_SPEC.validate_python({"kind": "train", "environment": "ant", "tracking": tracking})
live = Live(about_run("019aa3c2f0b1-5be0c1d2e3", spec, folder), folder, settings, print)
time.sleep(600)
"""


def test_nothing_outlives_a_supervisor_that_is_killed(tmp_path: Path) -> None:
    with wandb_server() as server:
        command = [sys.executable, "-c", _SUPERVISOR, str(tmp_path), server.url]
        with subprocess.Popen(command, cwd=Path(__file__).parents[2]) as supervisor:
            wait_until(lambda: bool(server.upserts), 60)
            assert len(left_overs(tmp_path)) == 2  # our process, and wandb's own
            supervisor.send_signal(signal.SIGKILL)
        wait_until(lambda: not left_overs(tmp_path), 10)
