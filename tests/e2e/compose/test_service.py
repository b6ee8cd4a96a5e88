"""`docker compose up` as its users live with it: jobs, disturbances, a second machine, a back-up."""

import json
import secrets
import shutil
import time
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import av
import httpx
import pytest

from gaitway.client import Client
from gaitway.schema import JobView
from gaitway.views import Event
from tests.e2e.compose.conftest import Figure
from tests.e2e.compose.project import BASE, CommandFailed, Project, removing, run, run_for_bytes, size_mb

# Ten checkpoints in some twenty seconds of training, so that it can be disturbed in the middle.
ANT: dict[str, Any] = {
    "kind": "train",
    "environment": "ant",
    "algorithm": {"num_timesteps": 204_800, "num_evals": 2, "num_eval_envs": 8},
    "checkpoints": {"every_steps": 20_480, "keep": 100},
    "video": {"width": 320, "height": 240, "seconds": 2},
    "seed": 7,
}
SERVICES = ("postgres", "valkey", "objects", "api", "reconciler", "worker")
ROLLOUT = {"kind": "rollout", "environment": "ant", "policy": {"kind": "zero"}, "num_steps": 20}


@pytest.fixture(scope="module")
def client(project: Project) -> Iterator[Client]:
    with project.client() as found:
        yield found


@pytest.fixture(scope="module")
def undisturbed(client: Client) -> JobView:
    """The job, left in peace."""
    job = client.wait(client.submit(ANT).id, timeout=300)
    assert job.succeeded, job.message
    return job


def until_checkpoint(client: Client, job: JobView) -> None:
    """Return once the job has stored its first checkpoint."""
    for event in client.events(job.id):
        if event.kind == "artifact" and event.data["role"] == "checkpoint":
            return
    raise AssertionError(f"The job ended without a checkpoint: {client.get(job.id)}")


def final_checkpoint(job: JobView) -> tuple[int | None, str]:
    found = job.newest("checkpoint")
    assert found is not None
    return found.step, found.sha256


def reached_again(client: Client, job: JobView, timeout_s: float = 60) -> None:
    """Return once the service answers for this job."""
    deadline = time.monotonic() + timeout_s
    while True:
        try:
            httpx.get(f"{client.base_url}/jobs/{job.id}", timeout=5).raise_for_status()
            return
        except httpx.HTTPError:
            assert time.monotonic() < deadline
            time.sleep(0.2)  # There is nothing to await before somebody listens.


def test_everything_becomes_healthy(project: Project, report: list[Figure]) -> None:
    started = time.monotonic()
    project.compose("up", "--detach", "--wait")
    report.append(Figure("up again, to everything healthy", time.monotonic() - started, "s"))
    for service in SERVICES:
        (container,) = project.containers(service)
        health = run("docker", "inspect", "--format", "{{.State.Health.Status}}", container)
        assert health.strip() == "healthy", service


def test_only_the_apis_port_is_open_and_on_loopback(project: Project) -> None:
    services = [json.loads(line) for line in project.compose("ps", "--format", "json").splitlines()]
    open_ports = {
        (one["Service"], publisher["URL"], publisher["PublishedPort"])
        for one in services
        for publisher in one["Publishers"] or ()
        if publisher["PublishedPort"]
    }
    assert open_ports == {("api", "127.0.0.1", project.port)}


def test_no_secret_is_in_the_configuration_or_in_a_list_of_processes(project: Project) -> None:
    keys = json.loads(project.compose("run", "--rm", "-T", "setup", "cat", "/run/gaitway/keys.json"))
    password = project.exec("postgres", "cat", "/run/database/password")
    containers = project.compose("ps", "--quiet").split()
    shown = [project.compose("config"), project.compose("top"), run("docker", "inspect", *containers)]
    for secret in (*keys.values(), password):
        assert secret
        assert not any(secret in text for text in shown)


def test_every_process_is_confined(project: Project) -> None:
    for service in SERVICES:
        described = json.loads(run("docker", "inspect", *project.containers(service)))[0]
        assert described["HostConfig"]["ReadonlyRootfs"], service
        assert described["HostConfig"]["CapDrop"] == ["ALL"], service
        user = "999" if service == "postgres" else "10001"
        assert project.exec(service, "id", "-u").strip() == user, service
    assert project.exec("worker", "cat", "/proc/1/comm").strip() == "tini"


def test_an_ant_is_trained_and_its_video_fetched(
    client: Client, undisturbed: JobView, tmp_path: Path
) -> None:
    video = client.video(undisturbed.id, tmp_path / "ant.mp4")
    with av.open(str(video)) as container:
        stream = container.streams.video[0]
        assert (stream.width, stream.height) == (320, 240)
        assert sum(1 for _ in container.decode(stream)) == 60


def test_a_cancelled_job_keeps_its_work(client: Client) -> None:
    job = client.submit({**ANT, "algorithm": {"num_timesteps": 20_000_000}})
    until_checkpoint(client, job)
    client.cancel(job.id)
    ended = client.wait(job.id, timeout=90)
    assert (ended.status, ended.reason) == ("cancelled", "user_cancelled")
    assert {a.role for a in ended.artifacts} >= {"checkpoint", "policy", "video"}


def test_a_killed_container_costs_no_work(
    project: Project, client: Client, undisturbed: JobView, report: list[Figure]
) -> None:
    job = client.submit(ANT)
    until_checkpoint(client, job)
    (container,) = project.containers("worker")
    run("docker", "kill", container)
    killed = time.monotonic()
    project.compose("up", "--detach", "worker")
    ended = client.wait(job.id, timeout=300)
    report.append(Figure("a killed worker's job: from the kill to its end", time.monotonic() - killed, "s"))
    assert ended.succeeded, ended.message
    assert [attempt.reason for attempt in ended.attempts] == ["worker_lost", "completed"]
    assert final_checkpoint(ended) == final_checkpoint(undisturbed)


@pytest.mark.parametrize("service", ["postgres", "valkey", "objects"])
def test_a_restarted_store_changes_nothing(
    service: str, project: Project, client: Client, undisturbed: JobView
) -> None:
    job = client.submit(ANT)
    until_checkpoint(client, job)
    project.compose("restart", service)
    reached_again(client, job)
    ended = client.wait(job.id, timeout=300)
    assert ended.succeeded, ended.message
    assert final_checkpoint(ended) == final_checkpoint(undisturbed)
    assert len(ended.attempts) == 1


def test_an_emptied_valkey_loses_no_queued_job(project: Project, client: Client) -> None:
    project.compose("stop", "worker")
    try:
        before = client.submit(ROLLOUT)
        project.compose("rm", "--stop", "--force", "valkey")
        meanwhile = client.submit(ROLLOUT)
    finally:
        project.compose("up", "--detach")
    for job in (before, meanwhile):
        ended = client.wait(job.id, timeout=120)
        assert ended.succeeded, ended.message
        assert [attempt.reason for attempt in ended.attempts] == ["completed"]


def test_two_workers_work_at_once(project: Project, client: Client) -> None:
    project.compose("up", "--detach", "--wait", "--scale", "worker=2", "--no-recreate")
    try:
        jobs = [client.submit({**ANT, "seed": seed}) for seed in (1, 2)]
        ended = [client.wait(job.id, timeout=300) for job in jobs]
    finally:
        project.compose("up", "--detach", "--no-recreate")
    assert all(job.succeeded for job in ended)
    first, second = (job.attempts[0] for job in ended)
    assert first.worker != second.worker
    assert second.started_at is not None
    assert first.ended_at is not None
    assert second.started_at < first.ended_at


def progress(events: list[Event]) -> list[int]:
    return [int(event.data["step"]) for event in events if event.kind == "progress"]


def test_stop_drains_and_start_goes_on(
    project: Project, client: Client, undisturbed: JobView, report: list[Figure]
) -> None:
    job = client.submit(ANT)
    until_checkpoint(client, job)
    started = time.monotonic()
    project.compose("stop")
    report.append(Figure("stop, with a job in progress", time.monotonic() - started, "s"))
    started = time.monotonic()
    project.compose("start")
    reached_again(client, job)
    report.append(Figure("start, to the service's answer", time.monotonic() - started, "s"))
    ended = client.wait(job.id, timeout=300)
    assert ended.succeeded, ended.message
    assert [attempt.reason for attempt in ended.attempts] == ["worker_drained", "completed"]
    assert final_checkpoint(ended) == final_checkpoint(undisturbed)
    steps = progress(list(client.events(job.id)))
    lost = max(earlier - later for earlier, later in pairwise(steps))
    report.append(Figure("steps told before the stop and done again after it", max(lost, 0), "steps", 0))
    assert lost <= 0


@pytest.fixture
def second_machine(checkout: Path, tmp_path: Path, project: Project) -> Iterator[Project]:
    """A clone of its own; its user writes `.env` there."""
    clone = shutil.copytree(checkout, tmp_path / "clone")
    with removing(Project(clone, project.settings)) as found:
        yield found


# Ends with 0 where each store wants TLS, and shows a certificate that only our authority has signed.
NO_DOOR_WITHOUT_TLS = """
import sys
from core.adapters.wiring import connect_redis, job_store, object_store
from core.adapters.redis.errors import reaching_redis
from core.configuration import read
from core.errors import RecordsRefuse, RecordsUnavailable, StorageRefuses
from core.settings import StoreSettings

def refuses(store, **changed):
    settings = trusting_us.model_copy(update=changed)
    try:
        with reaching_redis():
            store(settings)
    except (RecordsRefuse, RecordsUnavailable, StorageRefuses) as error:
        print(store.__name__, error.detail)
    else:
        sys.exit(f"{store.__name__} lets {list(changed)} in")

def postgresql(settings):
    job_store(settings, pool_size=0).ping()

def redis(settings):
    connect_redis(settings.redis_url.get_secret_value(), retries=0).ping()

def objects(settings):
    list(object_store(settings, retries=0).list("jobs/"))

def queue(address):
    return {"redis_url": type(trusting_us.redis_url)(address)}

def database(address):
    return {"database_url": type(trusting_us.database_url)(address)}

trusting_us = read(StoreSettings)
for store in (postgresql, redis, objects):
    store(trusting_us)
postgres_url, _, _ = trusting_us.database_url.get_secret_value().partition("?")
redis_url, _, _ = trusting_us.redis_url.get_secret_value().partition("?")
refuses(postgresql, **database(postgres_url + "?sslmode=disable"))
refuses(redis, **queue(redis_url.replace("rediss:", "redis:")))
refuses(objects, s3_secure=False)
refuses(postgresql, **database(postgres_url + "?sslmode=verify-full"))
refuses(redis, **queue(redis_url))
refuses(objects, tls_ca=None)
"""


def test_a_second_machine_joins_over_tls(
    project: Project, checkout: Path, second_machine: Project, client: Client
) -> None:
    """The commands of docs/install.md."""
    # Where this host is reached from any container: the near end of the project's network.
    network = json.loads(run("docker", "network", "inspect", f"{project.name}_default"))[0]
    gateway = network["IPAM"]["Config"][0]["Gateway"]
    sharing = {
        "COMPOSE_FILE": f"{checkout}/docker-compose.yml:{checkout}/deploy/share.yml",
        "GAITWAY_SHARE": gateway,
        "GAITWAY_WORKERS": "0",
    }
    shared = Project(checkout, {**project.settings, **sharing}, project.name, project.port)
    project.compose("stop", "worker")  # While it can: the stores go for a moment, and come back shared.
    shared.compose("up", "--detach")
    try:
        told = shared.compose("run", "--rm", "-T", "setup", "python", "-m", "gaitway.service.compose", "join")
        (second_machine.checkout / ".env").write_text(told)
        with pytest.raises(CommandFailed, match=r"ca\.pem"):
            second_machine.compose("up", "--detach", "--no-deps", "worker")
        trusted = shared.compose("run", "--rm", "-T", "setup", "cat", "/run/gaitway/ca.pem")
        (second_machine.checkout / "ca.pem").write_text(trusted)
        second_machine.compose("up", "--detach", "--no-deps", "worker")
        # The API was started again with the stores' addresses.
        job = client.wait(shared.wait_until_it_accepts(ROLLOUT, 60), timeout=120)
        assert job.succeeded, job.message
        (container,) = second_machine.containers("worker")
        assert (job.attempts[0].worker or "").startswith(container[:12])
        second_machine.exec("worker", "python", "-c", NO_DOOR_WITHOUT_TLS)
        # The same stores, with an API and a reconciler of its own.
        files = [f"deploy/own-{name}.yml" for name in ("ca", "postgres", "redis", "s3")]
        own = f"COMPOSE_FILE=docker-compose.yml:{':'.join(files)}\n"
        (second_machine.checkout / ".env").write_text(told + own)
        second_machine.compose("up", "--detach")
        assert set(second_machine.compose("ps", "--services").split()) == {"api", "reconciler", "worker"}
        with second_machine.client() as elsewhere:
            reached_again(elsewhere, job)
    finally:
        project.compose("up", "--detach", "--wait")


WITH_PASSWORD = "PGPASSWORD=$(cat /run/database/password)"
AS = "--host=127.0.0.1 --username=gaitway --dbname=gaitway"


def test_a_backup_is_restored_elsewhere(
    project: Project, checkout: Path, undisturbed: JobView, tmp_path: Path, client: Client
) -> None:
    """The commands of docs/operations.md."""
    dumping = project.command("exec", "-T", "postgres", "sh", "-c", f"{WITH_PASSWORD} pg_dump {AS} -Fc")
    record = run_for_bytes(*dumping, **project.environment())
    project.compose("stop")
    try:
        archiving = project.command("run", "--rm", "-T", "setup", "tar", "-C", "/volumes", "-c", "objects")
        backup = run_for_bytes(*archiving, **project.environment())
    finally:
        project.compose("start")
    with removing(Project(checkout, project.settings)) as other:
        other.compose("run", "--rm", "-T", "setup", "tar", "-C", "/volumes", "-x", stdin=backup)
        other.compose("up", "--detach", "--wait", "postgres", "valkey", "objects")
        restoring = f"{WITH_PASSWORD} pg_restore {AS} --clean --if-exists --no-owner --no-privileges"
        other.compose("exec", "-T", "postgres", "sh", "-c", restoring, stdin=record)
        checking = ("run", "--rm", "-T", "--no-deps", "reconciler", "gaitway", "check")
        assert "the bucket lacks" not in other.compose(*checking)
        other.compose("up", "--detach")
        with other.client() as elsewhere:
            reached_again(elsewhere, undisturbed)
            assert final_checkpoint(elsewhere.get(undisturbed.id)) == final_checkpoint(undisturbed)
            copy = elsewhere.video(undisturbed.id, tmp_path / "copy.mp4").read_bytes()
            again = elsewhere.submit({**ROLLOUT, "policy": {"kind": "checkpoint", "job": undisturbed.id}})
            assert elsewhere.wait(again.id, timeout=120).succeeded
    reached_again(client, undisturbed)
    assert copy == client.video(undisturbed.id, tmp_path / "original.mp4").read_bytes()


def test_down_and_up_keep_everything(
    project: Project, client: Client, undisturbed: JobView, tmp_path: Path
) -> None:
    project.compose("down")
    assert not project.containers("api", stopped=True)
    project.compose("up", "--detach")
    reached_again(client, undisturbed)
    assert client.get(undisturbed.id) == undisturbed
    assert client.video(undisturbed.id, tmp_path / "ant.mp4").stat().st_size > 0


# Ends with 0 where a store still lets the secrets in that its arguments name.
OLD_SECRETS_WORK = """
import sys
from core.adapters.wiring import connect_redis
from core.adapters.s3.connection import connect_s3
redis_url, access_key, secret_key = sys.argv[1:]
try:
    connect_s3("objects:8333", access_key, secret_key, secure=False, region="us-east-1").list_buckets()
except Exception:
    connect_redis(redis_url).ping()
"""


def test_a_changed_secret_shuts_the_old_one_out(
    project: Project, client: Client, undisturbed: JobView
) -> None:
    """The commands of docs/operations.md."""
    names = ("redis_url", "s3_access_key", "s3_secret_key")
    old = [project.exec("api", "cat", f"/run/gaitway/gaitway_{name}") for name in names]
    project.exec("api", "python", "-c", OLD_SECRETS_WORK, *old)
    project.compose("down")
    project.compose("run", "--rm", "-T", "setup", "rm", "/run/gaitway/keys.json")
    project.compose("up", "--detach")
    reached_again(client, undisturbed)
    with pytest.raises(CommandFailed, match="AuthenticationError"):
        project.exec("api", "python", "-c", OLD_SECRETS_WORK, *old)
    assert client.wait(client.submit(ROLLOUT).id, timeout=120).succeeded


def log_in(project: Project, password: str) -> None:
    """Raises CommandFailed where PostgreSQL does not let the password in."""
    look = "import sys; from core.adapters.wiring import connect_postgres as c; c(sys.argv[1]).connect()"
    url = f"postgresql://gaitway:{password}@postgres:5432/gaitway"
    project.exec("api", "python", "-c", look, url)


def test_a_changed_password_of_the_database_shuts_the_old_one_out(
    project: Project, client: Client, undisturbed: JobView
) -> None:
    """The commands of docs/operations.md."""
    old, new = project.exec("postgres", "cat", "/run/database/password"), secrets.token_hex(24)
    log_in(project, old)
    changing = ("exec", "-T", "postgres", "sh", "-c", f"{WITH_PASSWORD} psql {AS}")
    project.compose(*changing, stdin=f"ALTER USER gaitway PASSWORD '{new}'".encode())
    writing = ("run", "--rm", "-T", "setup", "sh", "-c", "cat > /volumes/database-password/password")
    project.compose(*writing, stdin=new.encode())
    project.compose("up", "--detach", "--force-recreate")
    reached_again(client, undisturbed)
    log_in(project, new)
    with pytest.raises(CommandFailed, match="password authentication failed"):
        log_in(project, old)
    assert client.wait(client.submit(ROLLOUT).id, timeout=120).succeeded


def test_the_doctor_finds_nothing_wrong_in_the_worker(project: Project) -> None:
    checks = json.loads(project.exec("worker", "gaitway", "doctor", "--json"))["checks"]
    states = {check["name"]: check["state"] for check in checks}
    assert {name for name, state in states.items() if state == "fail"} == set()
    checked = ("jax", "physics", "renderer", "postgresql", "redis", "object store", "clock")
    assert {states[name] for name in checked} == {"pass"}


def test_a_port_in_use_is_said_and_its_owner_goes_on(
    project: Project, checkout: Path, client: Client
) -> None:
    taken = Project(checkout, project.settings, port=project.port)
    with removing(taken), pytest.raises(CommandFailed, match="port is already allocated"):
        taken.compose("up", "--detach")
    assert client.health() == {"status": "ok"}


def test_a_wrong_key_ends_in_a_sentence(project: Project, checkout: Path) -> None:
    settings = {
        **project.settings,
        "GAITWAY_S3_ENDPOINT": "objects:8333",
        "GAITWAY_S3_ACCESS_KEY": "wrong",
        "GAITWAY_S3_SECRET_KEY": "wrong",
        "GAITWAY_S3_SECURE": "false",
    }
    with removing(Project(checkout, settings)) as wrong:
        wrong.compose("up", "--detach")
        deadline = time.monotonic() + 60
        while not (found := [line for line in wrong.logs("worker") if line.get("event") == "misconfigured"]):
            assert time.monotonic() < deadline
            time.sleep(0.5)  # The container's log cannot be awaited.
        assert "GAITWAY_S3_ACCESS_KEY" in str(found[0]["detail"])
        with pytest.raises(CommandFailed) as failure:  # a worker that restarts cannot be entered
            wrong.compose("run", "--rm", "--no-deps", "-T", "worker", "gaitway", "doctor", "--json")
        assert str(found[0]["detail"]) in str(failure.value)


STORES = (
    "--env=GAITWAY_DATABASE_URL=postgresql:///none",
    "--env=GAITWAY_REDIS_URL=unix:///none",
    *(f"--env=GAITWAY_S3_{name}=x" for name in ("ENDPOINT", "ACCESS_KEY", "SECRET_KEY")),
)


def test_a_gpu_that_is_not_there_ends_in_a_sentence(images: str) -> None:
    with pytest.raises(CommandFailed, match=r"(?s)ended with 78.*GAITWAY_DEVICE") as failure:
        run("docker", "run", "--rm", "--env=GAITWAY_DEVICE=gpu:0", *STORES, f"gaitway-worker:{images}")
    assert "--profile gpu" in str(failure.value)


@pytest.mark.slow
def test_the_image_for_gpus_has_what_it_needs_and_says_that_there_is_none(
    checkout: Path, images: str, report: list[Figure]
) -> None:
    """7 GB, and minutes to build: `./run test compose -m compose` includes it."""
    started = time.monotonic()
    Project(checkout, {"GAITWAY_TAG": images}).compose("--profile", "gpu", "build", "worker-gpu")
    report.append(Figure("build of worker-cuda", time.monotonic() - started, "s"))
    image = f"gaitway-worker-cuda:{images}"
    report.append(Figure("worker-cuda image, over its base", size_mb(image) - size_mb(BASE), "MB"))
    run("docker", "run", "--rm", image, "python", "-c", "import jax_cuda12_plugin, mujoco.mjx, warp")
    assert "10_nvidia.json" in run("docker", "run", "--rm", image, "ls", "/usr/share/glvnd/egl_vendor.d")
    with pytest.raises(CommandFailed, match=r"(?s)ended with 78.*No NVIDIA GPU is visible here"):
        run("docker", "run", "--rm", *STORES, image)
    with pytest.raises(CommandFailed) as failure:
        run("docker", "run", "--rm", *STORES, image, "gaitway", "doctor", "--json")
    checks = json.loads(str(failure.value).partition("\n")[2])["checks"]
    assert {check["name"]: check["state"] for check in checks}["device"] == "fail"
