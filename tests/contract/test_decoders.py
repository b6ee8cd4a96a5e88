"""The decoder of a finished job as the action of another: what is filled in, refused, held and delivered."""

import hashlib
from pathlib import Path
from typing import Any

import pytest

from core.adapters.postgres.store import PostgresJobStore
from core.clips.record import ClipFacts, ClipsDescription
from core.environments import catalog
from core.errors import JobInUse, Rejected
from core.jobs.attempts import Claim
from core.jobs.decoders import why_it_lends_to_few
from core.jobs.job import Artifact, Job
from core.jobs.resolved import resolve_job
from core.jobs.spec import JOB_SPEC
from core.jobs.status import JobStatus
from core.jobs.submission import new_job
from core.reasons import Reason
from tests.contract.recording import NOW, clip_file, held, queued_job
from tests.in_memory import MemoryObjectStore
from worker.protocol import Task
from worker.supervision.starting_point import write_task

POLICY = b"arrays"
BODY: list[Any] = [{"kind": "joint_positions"}, {"kind": "joint_velocities"}, {"kind": "previous_action"}]
NETWORK: dict[str, Any] = {"kind": "intention", "latent": 7, "encoder_sees": ["command"]}
OPTIONS: dict[str, Any] = {"observation": [{"kind": "command"}, *BODY]}
ABOUT_A_CLIP: dict[str, Any] = {
    **OPTIONS,
    "reference": {"clips": [{"file": "sha256:" + "1" * 64}]},
    "reward": [{"kind": "track_joints"}, {"kind": "track_linear_velocity"}],
    "action": {"kind": "joint_position", "about": "reference"},
}


def trained(store: PostgresJobStore, at_s: int = 0, **changes: Any) -> Job:
    """A job of go1 whose decoder sees all but the command, and which has ended as `changes` say."""
    said = {"environment": {"id": "go1", "options": OPTIONS}, "network": NETWORK, "kept": True} | changes
    algorithm = {"kind": "ppo", **({"network": said["network"]} if said["network"] else {})}
    algorithm |= said.get("algorithm", {})
    for choice in said["environment"]["options"].get("reference", {}).get("clips", []):
        store.clips.add(clip_file(choice["file"], body=said["environment"]["id"]))
    job = held(store, queued_job(at_s, environment=said["environment"], algorithm=algorithm))
    info, _ = catalog.resolve(job.spec.environment.id, job.spec.environment.options)
    spec: Any = job.spec
    settings = spec.algorithm.of_environment(info)
    [attempt] = job.attempts
    details = {"hyperparameters": settings.model_dump(mode="json")}
    attempt = attempt.model_copy(update={"details": details})
    digest = hashlib.sha256(POLICY).hexdigest()
    file = Artifact(
        name="policy.npz", role="export", key=f"jobs/{job.id}/policy.npz", sha256=digest, size=len(POLICY),
        media_type="application/x-npz", step=9,
    )  # fmt: skip
    job = job.model_copy(update={"attempts": (attempt,), "artifacts": (file,) if said["kept"] else ()})
    reason = said.get("reason", Reason.COMPLETED)
    status = JobStatus.SUCCEEDED if reason == Reason.COMPLETED else JobStatus.FAILED
    ended = job.ended(status, reason, "", NOW)
    store.save(ended)
    return ended


def driven(source: str, *, action: Any = None, **options: Any) -> Any:
    """A specification whose action is that job's decoder."""
    task = {"observation": [*BODY, {"kind": "projected_gravity"}], **options}
    task["action"] = {"kind": "decoder", "job": source, **(action or {})}
    return JOB_SPEC.validate_python({"kind": "train", "environment": {"id": "go1", "options": task}})


def test_a_submission_fills_in_what_the_decoder_is(job_store: PostgresJobStore) -> None:
    source = trained(job_store)
    job = new_job(driven(source.id), job_store)
    info, options = catalog.resolve("go1", job.spec.environment.options)
    action: Any = options.action  # pyright: ignore[reportAttributeAccessIssue]
    assert (action.latent, action.moves.kind) == (7, "joint_position")
    assert [term["kind"] for term in action.sees] == [term["kind"] for term in BODY]
    assert info.spaces.action_size == 7
    [part] = info.spaces.action
    assert (part.name, part.low, part.high) == ("intention", -3.5, 3.5)
    # What was filled in can be sent again.
    assert new_job(job.spec, job_store).spec == job.spec


FOLLOWS: dict[str, Any] = {"task": "imitate", "reference": {"clips": [{"file": "sha256:" + "1" * 64}]}}
# Of what decoders of the catalog's bodies see, the rat alone has filters behind its servos.
SEEN = [
    *("base_linear_velocity", "base_angular_velocity", "projected_gravity", "joint_positions"),
    *("joint_velocities", "previous_action"),
]


@pytest.mark.parametrize(
    ("body", "imitates", "environment", "task", "sees"),
    [
        ("rodent", {}, "rodent", {}, [*SEEN, "act"]),
        ("rodent", {}, "corridor", {"walker": "rodent"}, [*SEEN, "act"]),
        ("humanoid", {}, "humanoid", {}, SEEN),
        ("g1", {"action": {"kind": "joint_position", "about": "pose"}}, "g1", {}, SEEN),
    ],
    ids=["rodent", "corridor", "humanoid", "g1"],
)
def test_a_body_that_imitated_lends_its_decoder_to_its_other_tasks(
    job_store: PostgresJobStore,
    body: str,
    imitates: dict[str, Any],
    environment: str,
    task: dict[str, Any],
    sees: list[str],
) -> None:
    network = {"kind": "intention", "latent": 7}
    source = trained(job_store, environment={"id": body, "options": {**FOLLOWS, **imitates}}, network=network)
    options = {**task, "action": {"kind": "decoder", "job": source.id}}
    sent = {"kind": "train", "environment": {"id": environment, "options": options}}
    job = new_job(JOB_SPEC.validate_python(sent), job_store)
    action: Any = job.spec.environment.options["action"]
    assert [term["kind"] for term in action["sees"]] == sees
    info, _ = catalog.resolve(environment, job.spec.environment.options)
    plain, _ = catalog.resolve(environment, task)
    assert info.spaces.action_size == 7
    # The G1's walk sees all of that anyway.
    more = (info.spaces.observation_size) - plain.spaces.observation_size
    assert (more > 0) == (environment != "g1")


def test_one_that_learnt_about_a_clip_moves_a_task_with_a_reference(job_store: PostgresJobStore) -> None:
    source = trained(job_store, environment={"id": "go1", "options": ABOUT_A_CLIP})
    found = ClipsDescription(
        format="csv", clips=[ClipFacts(name="walk", num_frames=2, rate=50, seconds=1)], joints=[]
    )
    job_store.clips.add(clip_file("sha256:" + "1" * 64, body="go1", description=found))
    follows = {name: ABOUT_A_CLIP[name] for name in ("reference", "reward")}
    action: Any = new_job(driven(source.id, **follows), job_store).spec.environment.options["action"]
    assert action["moves"]["about"] == "reference"


def test_a_training_whose_decoder_needs_clips_says_so_as_it_begins() -> None:
    def said(about: str) -> str | None:
        options = {**FOLLOWS, "action": {"kind": "joint_position", "about": about}}
        algorithm = {"kind": "ppo", "network": {"kind": "intention", "latent": 7}}
        sent = {"kind": "train", "environment": {"id": "g1", "options": options}, "algorithm": algorithm}
        job = resolve_job(JOB_SPEC.validate_python(sent))
        return why_it_lends_to_few(job, job.settings_on("cpu"))

    assert said("pose") is None
    assert "can move tasks with a `reference` alone" in (said("reference") or "")


def test_the_job_is_kept_until_those_that_need_its_decoder_have_ended(
    job_store: PostgresJobStore, tmp_path: Path
) -> None:
    source = trained(job_store)
    objects = MemoryObjectStore()
    objects.put(source.artifacts[0].key, POLICY)
    job = held(job_store, new_job(driven(source.id), job_store))
    with pytest.raises(JobInUse, match=job.id):
        job_store.delete(source.id, source.version)
    write_task(job, Claim(job.id, 1, job.token, job_store, objects), "cpu", tmp_path)
    task = Task.model_validate_json((tmp_path / "task.json").read_bytes())
    assert task.decoder is not None
    assert (tmp_path / task.decoder).read_bytes() == POLICY
    job_store.save(job.ended(JobStatus.FAILED, Reason.TIMEOUT, "", NOW))
    job_store.delete(source.id, source.version)


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"network": None}, "has no decoder"),
        (
            {
                "algorithm": {"policy_obs_key": "privileged_state"},
                "environment": {"id": "go1", "options": {**OPTIONS, "critic": OPTIONS["observation"]}},
            },
            "saw 'privileged_state', and a decoder sees 'state'",
        ),
        ({"environment": {"id": "go1", "options": ABOUT_A_CLIP}}, 'was trained with `about`: "reference"'),
        ({"reason": Reason.TIMEOUT}, "a decoder is that of a job that has succeeded"),
        ({"kept": False}, "has no exported policy"),
        ({"environment": {"id": "g1", "options": OPTIONS}}, "trained 'g1', and this task has 'go1'"),
        ({"environment": {"id": "go1", "options": {**OPTIONS, "n_frames": 3}}}, "with another n_frames"),
        (
            {
                "environment": {
                    "id": "go1",
                    "options": {"observation": [{"kind": "command"}, {"kind": "qvel"}]},
                }
            },
            "sees what the observation of this task lacks; add it as it is there: .*qvel",
        ),
    ],
    ids=["plain", "privileged", "about-a-clip", "failed", "gone", "another-body", "another-step", "unseen"],
)
def test_a_job_whose_decoder_does_not_fit_is_refused(
    job_store: PostgresJobStore, changes: dict[str, Any], sentence: str
) -> None:
    source = trained(job_store, **changes)
    with pytest.raises(Rejected, match=sentence) as refused:
        new_job(driven(source.id), job_store)
    [problem] = refused.value.problems
    assert problem.pointer.startswith("/environment/options/")


def test_a_job_that_is_not_there_or_not_to_be_seen_is_refused_alike(job_store: PostgresJobStore) -> None:
    source = trained(job_store)
    for spec, readable in ((driven("000000000000-0000000000"), None), (driven(source.id), ["another"])):
        with pytest.raises(Rejected, match="no job"):
            new_job(spec, job_store, readable=readable)


@pytest.mark.parametrize(
    ("action", "sentence"),
    [({"latent": 8}, "`latent` is not what job"), ({"smoothing": 0.5}, "smoothing is that of the job")],
)
def test_fields_that_contradict_the_job_are_refused(
    job_store: PostgresJobStore, action: dict[str, Any], sentence: str
) -> None:
    source = trained(job_store)
    with pytest.raises(Rejected, match=sentence):
        new_job(driven(source.id, action=action), job_store)


def test_a_battery_is_refused(job_store: PostgresJobStore) -> None:
    source = trained(job_store)
    task = driven(source.id).model_dump(mode="json", exclude_unset=True)
    spec = JOB_SPEC.validate_python({"kind": "train", **task, "battery": True})
    with pytest.raises(Rejected, match="here a decoder does"):
        new_job(spec, job_store)
