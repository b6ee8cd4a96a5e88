"""One contract for both clients: every method against the real service, with the same results."""

import json
import sys
import threading
from collections.abc import AsyncIterator, Callable, Iterator
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from anyio.from_thread import BlockingPortal, start_blocking_portal

from core.algorithms.brax_training import init_normalizer
from core.algorithms.policy_file import write_policy
from core.algorithms.ppo.networks import init_params, make_networks
from core.algorithms.ppo.spec import PPOSpec
from core.sweeps.controller import SweepController
from gaitway import (
    AsyncClient,
    Client,
    Conflict,
    Job,
    MissingExtra,
    NotFound,
    Rejected,
    Retry,
    Unreachable,
    WaitTimeout,
)
from tests.api.conftest import ARTIFACT, Attempt, Stack, job, quiet, server, stack
from tests.api.test_clips import DESCRIPTION as CLIPS
from tests.api.test_clips import worker as clips_worker
from tests.api.test_models import DESCRIPTION
from tests.api.test_models import worker as validating_worker
from tests.api.test_previews import drawing_worker
from tests.exports import numpy_file_of
from tests.unit.environments.mjcf.probe import XML

__all__ = ["quiet", "server", "stack"]  # fixtures

METHODS = {name for name in dir(Client) if not name.startswith("_")} - {"base_url"}

_LISTINGS = {"list", "events", "logs", "sweeps", "models", "clip_files", "workers", "audit", "deliveries"}


class Either:
    """Calls the methods of a client of either kind in the same way. called: the names of those called."""

    def __init__(self, client: Client | AsyncClient, portal: BlockingPortal | None) -> None:
        self._client, self._portal = client, portal
        self.called = set[str]()

    def __getattr__(self, name: str) -> Callable[..., Any]:
        method = getattr(self._client, name)
        self.called.add(name)
        portal = self._portal
        if portal is None:
            return method
        if name in (
            "list",
            "events",
            "logs",
            "sweeps",
            "models",
            "clip_files",
            "workers",
            "audit",
            "deliveries",
        ):
            return lambda *args, **more: _items(method(*args, **more), portal)

        async def call(args: tuple[Any, ...], more: dict[str, Any]) -> Any:
            return await method(*args, **more)

        return lambda *args, **more: portal.call(call, args, more)


def _items(found: AsyncIterator[Any], portal: BlockingPortal) -> Iterator[Any]:
    async def following() -> Any:
        return await anext(found, None)

    while (item := portal.call(following)) is not None:
        yield item


def make(kind: type[Client] | type[AsyncClient], url: str, portal: BlockingPortal, **more: Any) -> Either:
    return Either(kind(url, **more), None if kind is Client else portal)


@pytest.fixture(scope="module")
def portal() -> Iterator[BlockingPortal]:
    with start_blocking_portal() as portal:
        yield portal


@pytest.fixture(params=[Client, AsyncClient])
def client(request: pytest.FixtureRequest, stack: Stack, portal: BlockingPortal) -> Iterator[Either]:
    client = make(request.param, f"http://127.0.0.1:{stack.port}", portal)
    yield client
    client.close()


def test_every_method_does_the_same(stack: Stack, client: Either, tmp_path: Path) -> None:
    _jobs(client)
    _following(stack, client)
    _files(stack, client, tmp_path)
    _bodies(stack, client, tmp_path)
    _sweeps(stack, client)
    _accounts(client)
    _quotas(client)
    _webhooks(client)
    _retention(client)
    assert client.health() == {"status": "ok"}
    assert client.called == METHODS - {"close"}  # the fixture calls it


def _jobs(client: Either) -> None:
    first = client.submit(environment="ant", labels={"project": "a b=c"})
    second = client.submit({"environment": "ant"}, seed=3, idempotency_key="k")
    assert client.submit({"environment": "ant"}, seed=3, idempotency_key="k").id == second.id
    assert client.get(second.id).spec["seed"] == 3
    assert [found.id for found in client.list()] == [second.id, first.id]
    assert [found.id for found in client.list(labels={"project": "a b=c"}, limit=1)] == [first.id]
    assert client.page(limit=1).next is not None
    assert client.specification(first.id)["algorithm"]["learning_rate"] > 0
    assert client.check({"environment": "ant"}, seed=3) == client.specification(second.id)
    changed = client.change(first.id, name="knees", labels={"project": None}, note="Too stiff.")
    assert (changed.name, changed.labels, changed.note) == ("knees", {}, "Too stiff.")
    assert client.cancel(first.id).status == "cancelled"
    client.delete(first.id)
    with pytest.raises(NotFound):
        client.get(first.id)
    many = [client.submit(environment="ant", labels={"many": "yes"}).id for _ in range(3)]
    assert {one.result for one in client.cancel_all([*many, first.id])} == {"cancelled", "refused"}
    outcomes = client.delete_all(labels={"many": "yes"})
    assert {one.job: one.result for one in outcomes} == dict.fromkeys(many, "deleted")
    with pytest.raises(Rejected) as caught:
        client.submit(environment="ant", algorithm={"kind": "ppo", "learning_rat": 1})
    assert [error.pointer for error in caught.value.errors] == ["/algorithm/learning_rat"]


def _following(stack: Stack, client: Either) -> None:
    attempt = Attempt(stack, job())
    with pytest.raises(WaitTimeout):
        client.wait(attempt.id, timeout=0.1)
    events = client.events(attempt.id)
    assert next(events).kind == "status"

    def work() -> None:
        attempt.say("metrics", step=7, values={"eval/episode_reward": 2.5, "training/loss": 1.0})
        attempt.print("hello")
        attempt.end()

    thread = threading.Thread(target=work)
    thread.start()
    rest = list(events)
    thread.join()
    assert (rest[-1].kind, rest[-1].data["status"]) == ("status", "succeeded")
    assert client.wait(attempt.id, timeout=10).succeeded
    assert list(client.logs(attempt.id)) == list(client.logs(attempt.id, follow=True)) == ["hello"]
    [row] = client.metrics(attempt.id)
    assert (row.step, row.values) == (7, {"eval/episode_reward": 2.5, "training/loss": 1.0})
    for points in (None, 10):
        [row] = client.metrics(attempt.id, names=["training/loss"], points=points)
        assert row.values == {"training/loss": 1.0}
    for kind in ("pandas", "polars"):
        frame = client.metrics(attempt.id, as_=kind)
        assert list(frame.columns) == ["step", "time", "eval/episode_reward", "training/loss"]
        assert list(frame["eval/episode_reward"]) == [2.5]
    card = client.card(client.get(attempt.id))
    assert (card.returns, card.video) == ([2.5], None)
    with pytest.raises(MissingExtra, match="in a notebook alone"):
        client.show(attempt.id)


# Two parts of one second each, in the first of which no body was seen.
BATTERY = {
    "passed": True,
    "over_time": {
        "joints": ["knee"],
        "bodies": ["shin"],
        "clips": [{"clip": "walk", "seconds": 2.0, "joints": [[0.25], [0.5]], "bodies": [[None], [0.1]]}],
    },
}


def _files(stack: Stack, client: Either, folder: Path) -> None:
    attempt = Attempt(stack, job("019aa3c2f0b2-5be0c1d2e4"))
    networks = make_networks(3, 2, PPOSpec.model_validate({"policy_hidden_layer_sizes": [4]}))
    params = init_params(networks, jax.random.PRNGKey(0))
    policy = write_policy((init_normalizer(3), params.policy, params.value))
    exported = numpy_file_of(policy)
    attempt.keep("policy", policy, role="policy")
    attempt.keep("policy.npz", exported, role="export")
    attempt.keep("step-5.ckpt", b"state", role="checkpoint", step=5)
    attempt.keep("video.mp4", step=5)
    attempt.keep("poster.png", b"still", role="poster")
    attempt.keep("recording.h5", b"HDF", role="recording", media_type="application/x-hdf5")
    attempt.keep("battery.json", json.dumps(BATTERY).encode(), role="battery")
    attempt.end()
    names = {found.name for found in client.artifacts(attempt.id)}
    pictures = {"video.mp4", "poster.png"}
    assert names == {"policy", "policy.npz", "step-5.ckpt", *pictures, "recording.h5", "battery.json"}
    assert client.recording(attempt.id, folder).read_bytes() == b"HDF"
    assert client.battery(attempt.id) == BATTERY
    errors = client.clip_errors(attempt.id)
    assert errors.loc["walk", "joints"]["knee"].to_dict() == {0.5: 0.25, 1.5: 0.5}
    assert np.isnan(errors.loc[("walk", 0.5), ("bodies", "shin")])
    with pytest.raises(Rejected) as caught:  # Its body follows no commands.
        client.test_policy(attempt.id)
    assert [error.pointer for error in caught.value.errors] == ["/battery"]
    assert [found.step for found in client.checkpoints(attempt.id)] == [5]
    assert client.download(attempt.id, "step-5.ckpt", folder).read_bytes() == b"state"
    assert client.video(attempt.id, folder, step=5).read_bytes() == ARTIFACT
    assert client.poster(attempt.id, folder).read_bytes() == b"still"
    assert client.export_policy(attempt.id, "numpy", folder).read_bytes() == exported
    assert client.load_policy(attempt.id)(jnp.zeros(3)).shape == (2,)
    archive = client.export(attempt.id, folder)
    assert archive.read_bytes().startswith(b"PK")
    brought = client.import_job(archive, idempotency_key="i")
    assert client.import_job(archive, idempotency_key="i").id == brought.id
    assert (brought.imported_from.job, brought.succeeded) == (attempt.id, True)
    assert client.download(brought.id, "step-5.ckpt", folder).read_bytes() == b"state"
    with pytest.raises(Rejected, match="not a zip file"):
        client.import_job(folder / "step-5.ckpt")
    shared = client.share(attempt.id, folder / "a" / "b.html")
    assert shared.read_text().startswith("<!doctype html>")
    with pytest.raises(NotFound):
        client.export("019aa3c2f0b9-5be0c1d2e9", folder / "none.zip")
    assert not list(folder.rglob("*.part"))


def _bodies(stack: Stack, client: Either, folder: Path) -> None:
    file = folder / "ball.xml"
    file.write_bytes(XML)
    with validating_worker(stack, status="ready", description=DESCRIPTION):
        model = client.add_model(file)
    assert client.model(model.id) == next(client.models())
    client.delete_model(model.id)
    assert list(client.models()) == []
    with clips_worker(stack, status="ready", description=CLIPS):
        (clips_file := folder / "walk.csv").write_bytes(b"0,0,0.5,0,0,0,1")
        clips = client.add_clips(clips_file, "g1", rate=50.0)
    assert client.clip_file(clips.id) == next(client.clip_files()) == clips
    assert (clips.name, client.rename_clips(clips.id, "walks").name) == ("walk.csv", "walks")
    assert client.clips_content(clips.id) == clips_file.read_bytes()
    client.delete_clips(clips.id)
    assert list(client.clip_files()) == []
    with drawing_worker(stack):
        assert client.preview("ant", folder, camera="track")["track"].read_bytes() == b"track"
        assert set(client.preview("ant", folder)) == {"track", 0}
        assert [found.name for found in client.workers()] == ["w"]
    assert "ant" in [found.id for found in client.environments("gaitway")]
    assert client.environment("corridor", {"num_next_obstacles": 1}).observation[-1].size == 1


def _sweeps(stack: Stack, client: Either) -> None:
    spec = {"job": {"environment": "ant"}, "method": "grid", "parameters": {"seed": [1, 2, 3]}}
    asked = {
        "budget": {"parallel": 2},
        "objective": {"metric": "eval/episode_reward", "direction": "maximize"},
    }
    sweep = client.sweep(spec, idempotency_key="s", **asked)
    assert client.sweep(spec, idempotency_key="s", **asked).id == sweep.id
    assert [found.id for found in client.sweeps()] == [sweep.id]
    assert [found.id for found in client.sweeps(limit=1, status="running")] == [sweep.id]
    look = SweepController(stack.store, stack.queue, stack.objects).run_once
    look()
    assert len(client.get_sweep(sweep.id).trials) == 2
    with pytest.raises(WaitTimeout):
        client.wait_for_sweep(sweep.id, timeout=0.01)
    changed = client.change_sweep(sweep.id, name="seeds", labels={"team": "legs"}, note="Of the knees.")
    assert (changed.name, changed.labels, changed.note) == ("seeds", {"team": "legs"}, "Of the knees.")
    assert client.cancel_sweep(sweep.id).status == "cancelling"
    look()
    look()
    assert client.wait_for_sweep(sweep.id, timeout=10).status == "cancelled"
    assert client.resume_sweep(sweep.id, parallel=1).status == "running"
    client.cancel_sweep(sweep.id)
    look()
    client.delete_sweep(sweep.id)
    with pytest.raises(NotFound):
        client.get_sweep(sweep.id)


def _accounts(client: Either) -> None:
    """This service has no accounts: each call reaches its route, which says so."""
    assert client.whoami().user is None
    for refused in (
        lambda: client.create_token("read"),
        lambda: client.tokens(),
        lambda: client.revoke_token("0" * 12),
        lambda: client.add_user("bob"),
        lambda: client.users(),
        lambda: client.change_user("bob", role="viewer"),
        lambda: client.add_project("gaits"),
        lambda: client.change_members("gaits", add=["bob"]),
        lambda: client.worker_settings(),
        lambda: client.set_quota("user", "bob"),
        lambda: list(client.audit()),
    ):
        with pytest.raises(Conflict, match="no accounts"):
            refused()
    assert [project.name for project in client.projects()] == ["default"]
    assert all(slots.queued >= 0 for slots in client.slots().items)
    assert client.usage().until >= client.usage().since


def _retention(client: Either) -> None:
    assert client.preview_retention(videos_days=3000).jobs == 0
    assert client.set_retention(videos_days=3000).videos_days == 3000
    assert client.retention().set_at is not None
    with pytest.raises(Rejected, match="checkpoints"):
        client.set_retention(checkpoints=0)
    client.remove_retention()
    assert client.retention().set_at is None


def _quotas(client: Either) -> None:
    made = client.set_quota("project", "default", queued=0, gpu_hours=40.0, highest_priority="low")
    assert (made.kind, made.weight, made.highest_priority) == ("project", 1.0, "low")
    with pytest.raises(Conflict, match="its quota of queued jobs is 0"):
        client.submit(environment="ant", priority="low")
    with pytest.raises(Conflict, match="of the priority low at most, and this one has high"):
        client.submit(environment="ant", priority="high")
    assert [(found.name, found.queued) for found in client.quotas()] == [("default", 0)]
    client.remove_quota("project", "default")
    with pytest.raises(NotFound, match="No quota is set for the project default"):
        client.remove_quota("project", "default")


def _webhooks(client: Either) -> None:
    with pytest.raises(Rejected, match="public"):
        client.add_webhook("lab", "http://127.0.0.1:1/")
    made = client.add_webhook("lab", "https://hooks.example.org/gaitway")
    assert [found.name for found in client.webhooks()] == ["lab"]
    assert made.secret is not None
    assert client.change_webhook("lab", jobs="named", active=False).stopped == "Stopped by hand."
    assert client.rotate_secret("lab").secret != made.secret
    sent = client.test_webhook("lab")
    again = client.resend(sent.id)
    assert [found.id for found in client.deliveries("lab")] == [again.id, sent.id]
    job_id = client.submit(environment="ant").id
    assert list(client.job_deliveries(job_id)) == []
    client.delete_webhook("lab")
    assert list(client.webhooks()) == []


@pytest.mark.parametrize("kind", [Client, AsyncClient])
def test_nobody_listening_is_a_sentence(portal: BlockingPortal, kind: type[Client]) -> None:
    client = make(kind, "http://127.0.0.1:1", portal, retry=Retry(attempts=2, first_delay_s=0.001))
    with pytest.raises(Unreachable, match=r"No Gaitway service.*gaitway up"):
        client.get("019aa3c2f0b1-5be0c1d2e3")
    client.close()


def test_a_job_in_a_notebook_has_its_return_and_its_video_and_markup_is_text(stack: Stack) -> None:
    attempt = Attempt(stack, job(name="<b>fast</b>"))
    attempt.say("metrics", step=7, values={"eval/episode_reward": 2.5})
    attempt.keep("video.mp4", b"film")
    with Client(f"http://127.0.0.1:{stack.port}") as client:
        html = client.get(attempt.id)._repr_html_()
    assert "&lt;b&gt;fast" in html
    assert "<b>" not in html
    assert "return ▄ 2.5" in html
    assert 'src="data:video/mp4;base64,ZmlsbQ=="' in html  # "film"


def test_a_job_whose_service_is_gone_is_shown_with_the_reason() -> None:
    with Client("http://127.0.0.1:1") as client:
        document = {"id": "j", "kind": "train", "status": "running", "created_at": "2026-11-20T12:00:00Z"}
        html = Job.model_validate(document, context=client)._repr_html_()
    assert "running" in html
    assert "No Gaitway service answers" in html


def test_metrics_as_a_frame_that_is_not_installed_say_what_to_install(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "polars", None)
    with Client("http://127.0.0.1:1") as client:
        with pytest.raises(MissingExtra, match="pip install polars"):
            client.metrics("j", as_="polars")
        with pytest.raises(ValueError, match="not as 'numpy'"):
            client.metrics("j", as_="numpy")  # pyright: ignore[reportArgumentType, reportCallIssue]
