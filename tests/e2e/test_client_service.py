"""The client and the CLI against the real service, over real sockets."""

import json
import re
import threading
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import pytest
from typer.testing import CliRunner, Result

from core.environments.mjcf.archive import examine
from core.jobs.job import Progress
from core.jobs.spec import RolloutSpec, TrainSpec
from core.jobs.status import JobStatus
from core.reasons import Reason
from core.storage import keys
from core.sweeps.controller import SweepController
from gaitway import Client, Conflict, NotFound, NotReady, Rejected, WaitTimeout
from gaitway.cli.main import app
from gaitway.cli.models import what_it_waits_for
from gaitway.cli.submit import JOB_FIELDS
from gaitway.schema import WorkerView
from tests.api.conftest import ARTIFACT, Attempt, Stack, job, quiet, server, stack
from tests.api.test_clips import DESCRIPTION as CLIPS
from tests.api.test_clips import FILE as CLIPS_FILE
from tests.api.test_clips import worker as clips_worker
from tests.api.test_models import DESCRIPTION
from tests.api.test_models import worker as validating_worker
from tests.api.test_previews import announced, drawing_worker
from tests.models import identity
from tests.unit.environments.mjcf.probe import XML
from tests.unit.environments.mjcf.test_archive import zipped

__all__ = ["quiet", "server", "stack"]  # fixtures


@pytest.fixture
def client(stack: Stack) -> Any:
    with Client(f"http://127.0.0.1:{stack.port}") as client:
        yield client


def gaitway(stack: Stack, *arguments: str, stdin: str | None = None) -> Result:
    return CliRunner().invoke(app, ["--url", f"http://127.0.0.1:{stack.port}", *arguments], input=stdin)


def test_a_job_is_submitted_read_listed_cancelled_and_deleted(client: Client) -> None:
    first = client.submit(environment="ant", labels={"project": "a b=c"})
    second = client.submit({"kind": "train", "environment": {"id": "ant"}}, seed=3)
    assert client.get(second.id).spec["seed"] == 3
    assert [found.id for found in client.list()] == [second.id, first.id]
    assert [found.id for found in client.list(labels={"project": "a b=c"}, status="queued")] == [first.id]
    assert client.page(limit=1).next is not None
    assert client.cancel(first.id).status == "cancelled"
    client.delete(first.id)
    with pytest.raises(NotFound):
        client.get(first.id)
    with pytest.raises(Conflict):
        client.delete(second.id)


def test_the_client_takes_last_and_parts_of_ids(client: Client) -> None:
    with pytest.raises(NotFound, match="There is no job yet"):
        client.get("last")
    first, second = client.submit(environment="ant"), client.submit(environment="ant")
    assert client.get("last").id == second.id
    assert client.get(first.id[-6:]).id == first.id
    assert client.specification("last")["environment"]["id"] == "ant"
    with pytest.raises(NotFound, match="fits 2 jobs"):
        client.cancel(first.id[:4])
    assert client.cancel("last").id == second.id
    client.delete(second.id[-8:])
    assert client.get("last").id == first.id


def test_a_rollout_of_a_job_takes_its_environment_and_the_first_hour_has_its_commands(stack: Stack) -> None:
    trained = Attempt(stack, job(environment={"id": "ant", "options": {"healthy_reward": 0.5}}))
    trained.keep("checkpoint-10", role="checkpoint", step=10)
    told = gaitway(stack, "rollout", "last", "--episodes", "3", "--no-video", "--record")
    rollout = told.stdout.strip()
    assert f"/#/jobs/{rollout}" in told.stderr
    spec = stack.http.get(f"/jobs/{rollout}").json()["spec"]
    assert spec["environment"] == {"id": "ant", "options": {"healthy_reward": 0.5}}
    assert (spec["policy"]["job"], spec["num_episodes"], spec["video"]) == (trained.id, 3, None)
    assert spec["recording"] == {}
    shown = gaitway(stack, "show", trained.id).output
    assert "settings:\n    environment.options.healthy_reward  0.5\n  filled in:\n" in shown
    assert re.search(r"^    algorithm\.learning_rate +\d", shown, re.MULTILINE)
    assert gaitway(stack, "workers").output == "No worker is running.\n"
    assert gaitway(stack, "--version").output.startswith("gaitway ")
    asked = gaitway(stack, "delete", rollout)
    assert (asked.exit_code, "--yes" in asked.output) == (2, True)
    gaitway(stack, "cancel", rollout)
    assert gaitway(stack, "delete", rollout, "--yes").stdout == f"Job {rollout} is deleted.\n"


def test_jobs_are_changed_and_many_are_cancelled_and_deleted(stack: Stack) -> None:
    ids = [gaitway(stack, "submit", "ant", "--label", "sweep=3").stdout.strip() for _ in range(3)]
    attempt = Attempt(stack, job(labels={"sweep": "3"}))
    changes = ("--name", "knees", "--label", "team=legs", "--without-label", "sweep", "--note", "Too\nstiff.")
    assert gaitway(stack, "change", ids[0], *changes).exit_code == 0
    shown = gaitway(stack, "show", ids[0]).output
    assert all(words in shown for words in ("knees", "labels:    team=legs", "Too\n             stiff."))
    assert gaitway(stack, "change", ids[0]).exit_code == 2
    for names in ((), ("last", "--kind", "train")):
        assert "not both" in gaitway(stack, "delete", *names).output
    assert "No job matches" in gaitway(stack, "delete", "--label", "sweep=4").output
    asked = gaitway(stack, "cancel", "--label", "sweep=3")
    assert (asked.exit_code, "Cancel 3 jobs?" in asked.output) == (2, True)
    told = gaitway(stack, "cancel", "--label", "sweep=3", "--yes").stdout
    assert set(told.splitlines()) == {"2 jobs are cancelled.", "1 job is cancelling."}
    told = gaitway(stack, "delete", *ids, attempt.id, "--yes")
    assert (told.exit_code, told.stderr.count("is queued"), told.stderr.count("is cancelling")) == (1, 1, 1)
    assert "2 jobs are deleted.\n" in told.stdout
    told = gaitway(stack, "delete", "--label", "sweep=3", "--yes")
    assert "Left out: 1 job, which has not ended." in told.stderr
    assert len(stack.http.get("/jobs").json()["items"]) == 2


def test_a_file_is_sent_by_f_and_an_option_has_the_same_name_for_submit_and_preview(stack: Stack) -> None:
    assert "gaitway submit -f x.json" in gaitway(stack, "submit", "x.json").output
    tried = gaitway(stack, "submit", "ant", "--set", "seed=3", "--dry-run")
    assert (json.loads(tried.stdout)["seed"], stack.is_empty()) == (3, True)
    sent = gaitway(stack, "submit", "ant", "--set", "healthy_reward=0.5", "--set", "seed=3")
    spec = stack.http.get(f"/jobs/{sent.stdout.strip()}").json()["spec"]
    assert (spec["environment"]["options"], spec["seed"]) == ({"healthy_reward": 0.5}, 3)
    fields = {name for one in (TrainSpec, RolloutSpec) for name in one.model_fields}
    assert fields == JOB_FIELDS


def test_the_same_key_with_another_specification_is_a_conflict(client: Client) -> None:
    first = client.submit(environment="ant", idempotency_key="k")
    assert client.submit(environment="ant", idempotency_key="k").id == first.id
    with pytest.raises(Conflict):
        client.submit(environment="ant", seed=1, idempotency_key="k")


def test_a_rejection_names_the_place(client: Client) -> None:
    with pytest.raises(Rejected) as caught:
        client.submit(environment="ant", algorithm={"kind": "ppo", "learning_rat": 1})
    assert [error.pointer for error in caught.value.errors] == ["/algorithm/learning_rat"]
    assert "/algorithm/learning_rat" in str(caught.value)


def test_a_job_is_followed_to_its_end_and_its_files_are_fetched(
    stack: Stack, client: Client, tmp_path: Path
) -> None:
    attempt = Attempt(stack, job())
    with pytest.raises(NotReady):
        client.video(attempt.id, tmp_path)
    events = client.events(attempt.id)
    assert next(events).kind == "status"

    def work() -> None:
        attempt.say("metrics", step=7, values={"eval/episode_reward": 2.5})
        attempt.print("hello")
        attempt.keep("video.mp4", step=7)
        attempt.end()

    thread = threading.Thread(target=work)
    thread.start()
    rest = list(events)
    thread.join()
    assert (rest[-1].kind, rest[-1].data["status"]) == ("status", "succeeded")
    done = client.wait(attempt.id, timeout=10)
    assert done.succeeded
    assert client.video(attempt.id, tmp_path).read_bytes() == ARTIFACT
    assert client.download(attempt.id, "video.mp4", tmp_path / "b.mp4").read_bytes() == ARTIFACT
    assert [(row.step, row.values) for row in client.metrics(attempt.id)] == [
        (7, {"eval/episode_reward": 2.5})
    ]
    assert list(client.logs(attempt.id)) == list(client.logs(attempt.id, follow=True)) == ["hello"]
    with pytest.raises(NotFound, match="policy"):
        client.load_policy(attempt.id)
    with pytest.raises(NotFound):
        client.poster(attempt.id, tmp_path)


def test_the_catalog_the_workers_and_the_health_are_read(client: Client) -> None:
    assert "ant" in [environment.id for environment in client.environments()]
    assert list(client.workers()) == []
    assert client.health() == {"status": "ok"}


def test_the_cli_submits_what_its_options_say(stack: Stack, client: Client) -> None:
    done = gaitway(
        stack,
        *(
            "submit",
            "ant",
            "--num-timesteps",
            "1000000",
            "--set",
            "algorithm.learning_rate=3e-4",
            "--seed",
            "1",
        ),
        *("--name", "first", "--label", "project=vnl", "--camera", "track", "--camera", "0", "--json"),
        *("--priority", "low", "--preemptible"),
    )
    assert done.exit_code == 0, done.output
    spec = client.get(json.loads(done.stdout)["id"]).spec
    assert spec["algorithm"] == {"kind": "ppo", "num_timesteps": 1_000_000, "learning_rate": 3e-4}
    assert (spec["seed"], spec["name"], spec["labels"]) == (1, "first", {"project": "vnl"})
    assert spec["video"] == {"cameras": ["track", 0]}
    assert (spec["priority"], spec["preemptible"]) == ("low", True)


def test_the_cli_says_what_a_video_shows_or_that_there_is_none(stack: Stack, client: Client) -> None:
    shown = gaitway(
        stack, "submit", "ant", "--episodes", "4", "--show", "joints", "--show", "contacts", "--json"
    )
    without = gaitway(stack, "submit", "ant", "--no-video", "--json")
    first, second = (client.get(json.loads(done.stdout)["id"]).spec for done in (shown, without))
    assert first["video"] == {"episodes": 4, "show": ["joints", "contacts"]}
    assert second["video"] is None


def test_the_cli_shows_the_numbers_of_one_environment(stack: Stack) -> None:
    done = gaitway(stack, "environments", "corridor", "--set", "num_next_obstacles=1")
    assert done.exit_code == 0, done.output
    assert "observation: 30 numbers" in done.stdout  # 27 of the ant, and three of the obstacle
    assert "   27     1  obstacle_1  m  -∞ to 10  begins ahead\n" in done.stdout
    assert "    0     1  walker/front_left_hip  1  -1 to 1\n" in done.stdout
    star = json.loads(gaitway(stack, "environments", "brittle_star", "--json").stdout)
    assert star["observation"][0]["name"] == "joint_position"


def test_the_cli_submits_a_job_of_another_algorithm(stack: Stack, client: Client) -> None:
    options = ("--num-timesteps", "1000000", "--set", "algorithm.kind=sac", "--set", "algorithm.n_step=1")
    done = gaitway(stack, "submit", "ant", *options, "--json")
    assert done.exit_code == 0, done.output
    spec = client.get(json.loads(done.stdout)["id"]).spec
    assert spec["algorithm"] == {"kind": "sac", "num_timesteps": 1_000_000, "n_step": 1}


def test_the_cli_reads_a_job_from_a_file_and_from_stdin(stack: Stack, client: Client, tmp_path: Path) -> None:
    text = '{"kind": "rollout", "environment": "ant", "policy": {"kind": "zero"}}'
    file = tmp_path / "job.json"
    file.write_text(text)
    submitted = gaitway(stack, "submit", "--file", str(file))
    assert submitted.exit_code == 0
    # Nobody works for this service.
    assert ": no worker is running." in submitted.stderr
    assert "no worker" not in submitted.stdout
    assert gaitway(stack, "submit", "--file", "-", "--seed", "5", stdin=text).exit_code == 0
    assert [(found.kind, found.spec.get("seed")) for found in client.list()] == [
        ("rollout", 5),
        ("rollout", None),
    ]


@pytest.mark.parametrize(
    "arguments",
    [
        ["submit"],
        ["submit", "ant", "--set", "nonsense"],
        ["submit", "ant", "--num-timesteps", "1000", "--set", "algorithm.kind=q_learning"],
        ["submit", "ant", "--no-video", "--episodes", "2"],
        ["environments", "--set", "walker=rodent"],
        ["submit", "ant", "--seed", "-1"],
        ["submit", "--file", "/nowhere/job.json"],
        ["submit", "ant", "--set", "seed.x=1", "--seed", "1"],
        ["show", "last"],
        ["show", "abc"],
        ["no-such-command"],
    ],
)
def test_wrong_usage_is_a_sentence_and_exit_code_2(stack: Stack, arguments: list[str]) -> None:
    done = gaitway(stack, *arguments)
    assert done.exit_code == 2
    assert "Traceback" not in done.output
    assert done.stderr.strip()
    assert stack.is_empty()


def test_watching_shows_the_end_and_its_exit_code_tells_failure(stack: Stack) -> None:
    good, bad = Attempt(stack, job()), Attempt(stack, job("019aa3c2f0b2-5be0c1d2e4"))
    good.end()
    bad.end(JobStatus.FAILED, Reason.DIVERGED)
    assert gaitway(stack, "watch", good.id).exit_code == 0
    done = gaitway(stack, "watch", "last")
    assert done.exit_code == 1
    assert "failed (diverged): It came to its end." in done.stdout


def test_jobs_are_listed_shown_and_found_by_a_part_of_their_id(stack: Stack) -> None:
    attempt = Attempt(stack, job())
    attempt.keep("video.mp4")
    table = gaitway(stack, "jobs").stdout
    assert attempt.id in table
    assert "running" in table
    assert json.loads(gaitway(stack, "jobs", "--json").stdout)[0]["id"] == attempt.id
    assert gaitway(stack, "jobs", "--status", "failed").stdout == "No job matches.\n"
    for name in (attempt.id, attempt.id[:15], attempt.id[-4:], "last"):
        assert "video.mp4" in gaitway(stack, "show", name).stdout


def test_the_cli_draws_a_body_from_each_camera_or_from_one(stack: Stack, tmp_path: Path) -> None:
    with drawing_worker(stack) as drawn:
        all_of_them = gaitway(stack, "preview", "ant", "-o", str(tmp_path), "--set", "healthy_reward=2")
        one = gaitway(
            stack, "preview", "brax/ant", "-o", str(tmp_path), "--camera", "0", "--size", "64x48", "--json"
        )
    assert {file.name: file.read_bytes() for file in tmp_path.iterdir()} == {
        "ant-track.png": b"track",
        "ant-0.png": b"0",
        "brax-ant-0.png": b"0",
    }
    assert all_of_them.stdout.replace("\n", "").endswith("ant-0.png")
    assert json.loads(one.stdout) == {"0": str(tmp_path / "brax-ant-0.png")}
    assert drawn[0].options["healthy_reward"] == 2.0
    assert (drawn[1].width, drawn[1].height) == (64, 48)
    assert gaitway(stack, "preview", "ant", "--size", "big").exit_code == 2
    refused = gaitway(stack, "preview", "ant", "--camera", "nose")
    assert (refused.exit_code, "known are track" in refused.stderr) == (2, True)


def test_the_cli_brings_a_body_and_shows_what_is_in_it(stack: Stack, tmp_path: Path) -> None:
    file = tmp_path / "ball.xml"
    file.write_bytes(XML)
    found = DESCRIPTION.model_copy(update={"complete": False, "notes": ["It fell 20 m."]})
    with validating_worker(stack, status="ready", description=found):
        added = gaitway(stack, "models", "add", str(file)).stdout
    model, _, name = added.splitlines()[0].split()
    assert name == "ball.xml"
    engines = (
        "native, as it is: runs it",
        "mjx, as it is: does not run it: Ellipsoids",
        "being tried: warp;",
    )
    for said in ("nu 1", "keyframes: raised", *engines, "It fell"):
        assert said in added
    assert gaitway(stack, "models", "show", model).stdout == added
    assert gaitway(stack, "models", "show", "ball.xml").stdout == added
    assert gaitway(stack, "models", "list").stdout == f"{model}  ready  {len(XML):,} bytes  ball.xml\n"
    assert model in gaitway(stack, "models", "list", "--limit", "1").stdout
    assert model in gaitway(stack, "models", "delete", "ball.xml").stdout
    assert gaitway(stack, "models", "list").stdout == "No models.\n"


def test_a_job_may_name_its_model_as_people_do(stack: Stack, client: Client, tmp_path: Path) -> None:
    file, other = tmp_path / "ball.xml", tmp_path / "other.xml"
    file.write_bytes(XML)
    other.write_bytes(XML + b"\n")
    with validating_worker(stack, status="ready", description=DESCRIPTION):
        for one in (file, other):
            gaitway(stack, "models", "add", str(one), "--name", "my ball")
    last = identity(XML + b"\n")
    sent = gaitway(stack, "submit", "mjcf", "--set", "environment.options.model=my ball")
    assert f"this is the last one that was sent, {last}" in sent.stderr
    assert client.get(sent.stdout.split()[0]).spec["environment"]["options"] == {"model": last}
    unknown = gaitway(stack, "environments", "mjcf", "--set", "model=my bell")
    assert (unknown.exit_code, "No model is called 'my bell'" in unknown.stderr) == (2, True)
    assert json.loads(gaitway(stack, "environments", "mjcf", "--set", "model=my ball", "--json").stdout)[
        "action"
    ]


def test_a_job_may_name_its_clips_as_people_do(stack: Stack, client: Client, tmp_path: Path) -> None:
    (file := tmp_path / "walks.csv").write_bytes(CLIPS_FILE)
    with clips_worker(stack, status="ready", description=CLIPS):
        gaitway(stack, "clips", "add", str(file), "--body", "rodent", "--rate", "50")
    [clips] = client.clip_files()
    asked = [
        "--set",
        "task=imitate",
        "--set",
        'reference={"clips": [{"file": "walks.csv", "names": ["walk"]}]}',
    ]
    sent = gaitway(stack, "submit", "rodent", *asked)
    options = client.get(sent.stdout.split()[0]).spec["environment"]["options"]
    assert options["reference"] == {"clips": [{"file": clips.id, "names": ["walk"]}]}
    unknown = gaitway(stack, "submit", "rodent", *(text.replace("walks", "strolls") for text in asked))
    assert (unknown.exit_code, "No clips are called 'strolls.csv'" in unknown.stderr) == (2, True)


def test_the_document_of_a_zip_that_is_the_model_can_be_named(stack: Stack, tmp_path: Path) -> None:
    file = tmp_path / "two.zip"
    file.write_bytes(zipped({"a.xml": XML, "b.xml": XML}))
    found = DESCRIPTION.model_copy(update={"main": "b.xml"})
    with validating_worker(stack, status="ready", description=found):
        said = gaitway(stack, "models", "add", str(file), "--main", "b.xml").stdout
    assert "read from b.xml" in said
    assert examine(stack.objects.get(keys.model_source(said.split()[0]))).main == "b.xml"


def test_who_sends_a_model_is_told_at_once_what_it_waits_for(stack: Stack, tmp_path: Path) -> None:
    file = tmp_path / "ball.xml"
    file.write_bytes(XML)
    told = list[str]()
    with validating_worker(stack, status="ready", description=DESCRIPTION):
        told.append(gaitway(stack, "models", "add", str(file)).stderr)
        announced(stack)
        told.append(gaitway(stack, "models", "add", str(file)).stderr)
    assert told == ["No worker runs; the model waits until one does.\n", ""]
    seen = {"started_at": datetime.now(UTC), "seen_at": datetime.now(UTC)}
    busy = WorkerView(name="gpu-1", job="j1", **seen)
    assert what_it_waits_for([busy]) == (
        "The only worker is busy (gpu-1 with job j1): a worker reads the model after its job, "
        "before those that wait."
    )
    assert "All 2 workers are busy (gpu-1 with job j1)" in str(what_it_waits_for([busy, busy]))
    assert what_it_waits_for([busy, WorkerView(name="gpu-2", **seen)]) is None


def test_a_client_waits_for_its_stills_while_workers_are_busy(
    stack: Stack, client: Client, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("api.routes.previews._TIMEOUT_S", 0.0)
    monkeypatch.setattr("gaitway.client.catalog.POLL_S", 0.01)
    announced(stack)
    with pytest.raises(WaitTimeout, match="No worker has rendered it"):
        client.preview("hopper", tmp_path, timeout=0.0)
    with drawing_worker(stack):
        assert client.preview("hopper", tmp_path)["track"].read_bytes() == b"track"


def test_a_policy_is_exported_by_client_and_cli(stack: Stack, client: Client, tmp_path: Path) -> None:
    attempt = Attempt(stack, job())
    with pytest.raises(NotReady, match=r"has no policy.onnx yet"):
        client.export_policy(attempt.id, "onnx", tmp_path)
    attempt.keep("policy", b"own", role="policy")
    for name in ("policy.npz", "policy.onnx"):
        attempt.keep(name, name.encode(), role="export")
    attempt.end()
    fetched = client.export_policy(attempt.id, "onnx", tmp_path)
    assert (fetched.name, fetched.read_bytes()) == ("policy.onnx", b"policy.onnx")
    target = tmp_path / "walk.npz"
    done = gaitway(stack, "export", "last", "--format", "numpy", "-o", str(target))
    assert (done.exit_code, target.read_bytes()) == (0, b"policy.npz")
    with pytest.raises(Rejected, match="'numpy', 'onnx' or 'robot'"):
        client.export_policy(attempt.id, "tflite", tmp_path)  # pyright: ignore[reportArgumentType]
    assert gaitway(stack, "export", "last", "--format", "tflite").exit_code == 2


def test_the_cli_shares_and_exports_a_job(stack: Stack, tmp_path: Path) -> None:
    attempt = Attempt(stack, job(name="first steps"))
    page, archive = tmp_path / "run.html", tmp_path / "run.zip"
    assert gaitway(stack, "share", "last", "-o", str(page)).exit_code == 0
    assert "first steps" in page.read_text()
    assert gaitway(stack, "export", "last", "--format", "zip", "-o", str(archive)).exit_code == 0
    with ZipFile(archive) as opened:
        spec = opened.extract("spec.json", tmp_path)
    # What the zip's own README says.
    again = gaitway(stack, "submit", "--file", spec)
    assert again.exit_code == 0, again.output
    assert again.stdout.strip() != attempt.id
    assert gaitway(stack, "share", "019aa3c2f0b9-5be0c1d2e9").exit_code == 1
    brought = gaitway(stack, "import", str(archive))
    assert brought.exit_code == 0, brought.output
    shown = gaitway(stack, "show", brought.stdout.strip())
    assert f"job {attempt.id} of a service with Gaitway" in shown.stdout
    assert "exported_unfinished" in shown.stdout
    refused = gaitway(stack, "import", spec)
    assert (refused.exit_code, "not a zip file" in refused.stderr) == (2, True)


def test_an_import_sends_the_users_own_model_first(stack: Stack, client: Client, tmp_path: Path) -> None:
    file = tmp_path / "ball.xml"
    file.write_bytes(XML)
    with validating_worker(stack, status="ready", description=DESCRIPTION):
        model = client.add_model(file).id
        attempt = Attempt(stack, job(environment={"id": "mjcf", "options": {"model": model}}))
        attempt.end()
        archive = client.export(attempt.id, tmp_path)
        client.delete(attempt.id)
        client.delete_model(model)
        assert client.import_job(archive).succeeded
    assert [found.id for found in client.models()] == [model]


def test_the_cli_fetches_files_and_cancels(stack: Stack, tmp_path: Path) -> None:
    attempt = Attempt(stack, job())
    attempt.keep("video.mp4")
    target = tmp_path / "walk.mp4"
    assert gaitway(stack, "video", "last", "-o", str(target)).stdout.replace("\n", "") == str(target)
    assert target.read_bytes() == ARTIFACT
    assert gaitway(stack, "download", "last", "video.mp4", "-o", str(tmp_path)).exit_code == 0
    assert gaitway(stack, "download", "last", "absent").exit_code == 1
    assert "cancelling" in gaitway(stack, "cancel", "last").stdout


SWEEP = {
    "name": "seeds",
    "job": {"environment": "ant", "algorithm": {"num_timesteps": 1000}},
    "method": "grid",
    "parameters": {"seed": [1, 2, 3]},
}


def test_a_sweep_is_started_watched_cancelled_resumed_and_deleted(client: Client, stack: Stack) -> None:
    look = SweepController(stack.store, stack.queue, stack.objects).run_once
    sweep = client.sweep(SWEEP, budget={"parallel": 1})
    assert (sweep.status, sweep.is_final, sweep.metrics) == ("running", False, ["eval/episode_reward"])
    look()
    assert client.cancel_sweep(sweep.id).status == "cancelling"
    look()
    look()
    assert client.wait_for_sweep(sweep.id, timeout=5).status == "cancelled"
    assert client.resume_sweep(sweep.id, parallel=2).status == "running"
    with pytest.raises(WaitTimeout):
        client.wait_for_sweep(sweep.id, timeout=0)
    look()
    found = client.get_sweep(sweep.id)
    assert [trial.status for trial in found.trials] == ["cancelled", "queued", "queued"]
    assert [one.id for one in client.sweeps(status="running")] == [sweep.id]
    with pytest.raises(Conflict):
        client.delete_sweep(sweep.id)
    with pytest.raises(Rejected) as caught:
        client.sweep(SWEEP, parameters={})
    assert [error.pointer for error in caught.value.errors] == ["/parameters"]


def test_the_cli_shows_from_which_trial_another_one_resumed(stack: Stack, tmp_path: Path) -> None:
    file = tmp_path / "sweep.json"
    job = {"environment": "ant", "algorithm": {"num_timesteps": 10**8}}
    axes = {"algorithm.entropy_cost": [0.0, 0.1]}
    population = {"size": 2, "generations": 2}
    file.write_text(json.dumps({"job": job, "method": "pbt", "parameters": axes, "population": population}))
    sweep_id = gaitway(stack, "sweep", str(file)).output.strip()
    look = SweepController(stack.store, stack.queue, stack.objects).run_once
    look()
    for trial in stack.store.trials([sweep_id])[sweep_id]:
        attempt = Attempt(stack, stack.store.get(trial.job or ""), is_new=False)
        progress = Progress(step=5, metrics={"eval/episode_reward": 10.0 * trial.number})
        stack.store.record(attempt.id, attempt.claim.token, "events", [], progress, write_id="w")
        attempt.keep("checkpoint-5", role="checkpoint", step=5)
        attempt.end()
    look()
    header, *rows = gaitway(stack, "sweeps", "show", "last").output.splitlines()[1:]
    assert header.split()[:4] == ["TRIAL", "GEN", "FROM", "STATUS"]
    assert [row.split()[:4] for row in rows] == [
        ["1", "0", "succeeded", "10"],
        ["0", "0", "succeeded", "0"],
        ["2", "1", "1", "queued"],
        ["3", "1", "1", "queued"],
    ]


def test_the_cli_says_why_trials_have_no_result(stack: Stack, tmp_path: Path) -> None:
    file = tmp_path / "sweep.json"
    file.write_text(json.dumps({**SWEEP, "parameters": {"seed": [1, 2, 3]}}))
    sweep_id = gaitway(stack, "sweep", str(file)).output.strip()
    look = SweepController(stack.store, stack.queue, stack.objects).run_once
    look()
    for trial in stack.store.trials([sweep_id])[sweep_id]:
        attempt = Attempt(stack, stack.store.get(trial.job or ""), is_new=False)
        if trial.number:
            attempt.end(JobStatus.FAILED, Reason.DIVERGED)
        else:
            attempt.end()
    look()
    shown = gaitway(stack, "sweeps", "show", "last").output
    # The third says what the second does.
    assert [line for line in shown.splitlines() if " failed: " in line] == [
        "trial 1 failed: It came to its end."
    ]


def test_sweeps_by_the_cli(stack: Stack, tmp_path: Path) -> None:
    file = tmp_path / "sweep.json"
    file.write_text(json.dumps({**SWEEP, "name": "[red]seeds[/]"}))
    assert gaitway(stack, "sweeps").output == "No sweeps.\n"
    submitted = gaitway(stack, "sweep", str(file))
    assert submitted.exit_code == 0, submitted.output
    sweep_id = submitted.output.strip()
    controller = SweepController(stack.store, stack.queue, stack.objects)
    controller.run_once()
    for number, trial in enumerate(stack.store.trials([sweep_id])[sweep_id]):
        attempt = Attempt(stack, stack.store.get(trial.job or ""), is_new=False)
        progress = Progress(step=9, metrics={"eval/episode_reward": 10.0 * number})
        stack.store.record(attempt.id, attempt.claim.token, "events", [], progress, write_id="w")
        attempt.end()
    controller.run_once()
    [listed] = json.loads(gaitway(stack, "sweeps", "--json").output)
    assert (listed["id"], listed["status"]) == (sweep_id, "succeeded")
    shown = gaitway(stack, "sweeps", "show", "last").output
    rows = [line.split()[:4] for line in shown.splitlines() if "succeeded" in line.split()[1:2]]
    assert rows == [
        ["2", "succeeded", "20", "3"],
        ["1", "succeeded", "10", "2"],
        ["0", "succeeded", "0", "1"],
    ]
    [row] = gaitway(stack, "sweeps").output.splitlines()[1:]
    assert "3 of 3" in row
    assert row.endswith("[red]seeds[/]")  # Text, and no markup.
    assert gaitway(stack, "sweeps", "resume", sweep_id, "--jobs", "9").exit_code != 0
    assert gaitway(stack, "sweeps", "cancel", sweep_id[-6:]).exit_code != 0
    assert "its jobs stay" in gaitway(stack, "sweeps", "delete", sweep_id, "--yes").output
    assert gaitway(stack, "sweeps", "show", "nonsense").exit_code == 2
