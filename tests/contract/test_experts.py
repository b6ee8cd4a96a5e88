"""The policies of finished jobs as the experts of another: what is filled in, refused, held and delivered."""

import hashlib
from pathlib import Path
from typing import Any

import pytest

from core.adapters.postgres.store import PostgresJobStore
from core.clips.record import ClipsDescription
from core.errors import JobInUse, Rejected
from core.jobs.attempts import Claim
from core.jobs.job import Artifact, Job
from core.jobs.spec import JOB_SPEC
from core.jobs.status import JobStatus
from core.jobs.submission import new_job
from core.reasons import Reason
from tests.contract.recording import NOW, clip_file, held, queued_job
from tests.in_memory import MemoryObjectStore
from worker.protocol import Task
from worker.supervision.starting_point import write_task

POLICY = b"parameters"
CLIPS = "sha256:" + "1" * 64
# Of go1's 12 joints: 12, 12, and 3 numbers.
BODY: list[Any] = [{"kind": "joint_positions"}, {"kind": "joint_velocities"}]
GRAVITY = {"kind": "projected_gravity"}
OPTIONS: dict[str, Any] = {"observation": BODY}
REWARD = [{"kind": "track_joints"}, {"kind": "track_linear_velocity"}]


def following(*names: str, **options: Any) -> dict[str, Any]:
    choice = {"file": CLIPS, **({"names": list(names)} if names else {})}
    return {**OPTIONS, "reference": {"clips": [choice]}, "reward": REWARD, **options}


def trained(store: PostgresJobStore, at_s: int = 0, **changes: Any) -> Job:
    """A job of go1 that has ended as `changes` say."""
    said = {"options": OPTIONS, "id": "go1", "algorithm": {"kind": "ppo"}, "kept": True} | changes
    environment = {"id": said["id"], "options": said["options"]}
    job = held(store, queued_job(at_s, environment=environment, algorithm=said["algorithm"]))
    digest = hashlib.sha256(POLICY).hexdigest()
    file = Artifact(
        name="policy", role="policy", key=f"jobs/{job.id}/policy", sha256=digest, size=len(POLICY),
        media_type="application/octet-stream", step=9,
    )  # fmt: skip
    job = job.model_copy(update={"artifacts": (file,) if said["kept"] else ()})
    reason = said.get("reason", Reason.COMPLETED)
    status = JobStatus.SUCCEEDED if reason == Reason.COMPLETED else JobStatus.FAILED
    ended = job.ended(status, reason, "", NOW)
    store.save(ended)
    return ended


def learning(*experts: Any, options: Any = OPTIONS) -> Any:
    """A specification that learns from these experts."""
    algorithm = {"kind": "distillation", "experts": list(experts)}
    return JOB_SPEC.validate_python(
        {"kind": "train", "environment": {"id": "go1", "options": options}, "algorithm": algorithm}
    )


def with_clips(store: PostgresJobStore, *names: str, file: str = CLIPS) -> None:
    found = [{"name": name, "num_frames": 50, "rate": 50.0, "seconds": 0.98} for name in names]
    made = {"clips.npz": {"sha256": "2" * 64, "size": 1}}
    said = ClipsDescription.model_validate({"format": "ours", "clips": found, "joints": [], "made": made})
    store.clips.add(clip_file(file, body="go1", description=said))


def test_a_submission_fills_in_what_an_expert_sees(job_store: PostgresJobStore) -> None:
    teacher = trained(job_store, options={"observation": [GRAVITY, BODY[1]]})
    # The student sees less, and noise; what the teacher sees is there for it alone.
    noisy = [{**BODY[0], "noise": 0.1}]
    task = {"observation": noisy, "critic": [BODY[0], BODY[1], GRAVITY]}
    job = new_job(learning({"job": teacher.id}, options=task), job_store)
    spec: Any = job.spec
    [expert] = spec.algorithm.experts
    assert (expert.sees, expert.places) == ("privileged_state", [(24, 3), (12, 12)])
    # What was filled in can be sent again.
    assert new_job(job.spec, job_store).spec == job.spec


def test_every_clip_has_one_expert(job_store: PostgresJobStore) -> None:
    with_clips(job_store, "walk 1", "walk 2", "run")
    walker = trained(job_store, options=following("walk.*"))
    runner = trained(job_store, 1, options=following("run"))

    def submitted(*experts: Any) -> Any:
        spec: Any = new_job(learning(*experts, options=following()), job_store).spec
        return spec.algorithm

    # By default the clips of its own job.
    filled = submitted({"job": walker.id}, {"job": runner.id})
    assert [expert.clip_names for expert in filled.experts] == [["walk 1", "walk 2"], ["run"]]
    assert filled.num_of_expert(["walk 1", "walk 2", "run"]) == [0, 0, 1]
    for experts, sentence in (
        ([{"job": walker.id}], "The clip 'run' has no expert"),
        ([{"job": walker.id}, {"job": runner.id, "clips": [".*"]}], f"'walk 1' has .*{walker.id} and"),
        ([{"job": walker.id, "clips": [".*"]}, {"job": runner.id, "clips": ["hop"]}], "none of this job's"),
    ):
        with pytest.raises(Rejected, match=sentence):
            submitted(*experts)


def test_an_expert_that_saw_its_clips_in_another_way_is_refused(job_store: PostgresJobStore) -> None:
    with_clips(job_store, "walk", "run")
    expert = trained(job_store, options=following("walk"))
    for changed in ({"ahead": {"frames": 5}}, {"bodies": ["FR_.*"]}):
        options = following()
        options = {**options, "reference": {**options["reference"], **changed}}
        with pytest.raises(Rejected, match=f"with another reference.{next(iter(changed))}: take the same"):
            new_job(learning({"job": expert.id}, options=options), job_store)
    walks = {"task": "imitate", "reference": {"clips": [{"file": CLIPS}]}}
    other = trained(job_store, 1, id="g1", options=walks)
    with pytest.raises(Rejected, match="trained 'g1', and this task has 'go1'"):
        new_job(learning({"job": other.id}, options=following()), job_store)


def test_a_clip_is_its_experts_own_by_its_file_and_changes_and_not_by_its_name(
    job_store: PostgresJobStore,
) -> None:
    other = "sha256:" + "3" * 64
    with_clips(job_store, "clip")
    with_clips(job_store, "clip", file=other)
    of_the_first, of_the_second, fast = (
        {**following(), "reference": {"clips": [choice]}}
        for choice in ({"file": CLIPS}, {"file": other}, {"file": CLIPS, "speed": 2.0})
    )
    teachers = [
        trained(job_store, at_s, options=had) for at_s, had in enumerate((of_the_first, of_the_second))
    ]
    both = {**following(), "reference": {"clips": [{"file": other, "weight": 2.0}, {"file": CLIPS}]}}
    spec: Any = new_job(learning(*({"job": one.id} for one in teachers), options=both), job_store).spec
    # The job calls them `clip` and `clip 2`.
    assert spec.algorithm.num_of_expert(["clip", "clip 2"]) == [1, 0]
    for options in (of_the_second, fast):
        with pytest.raises(Rejected, match="was trained on no clip of this job: of the same file") as refused:
            new_job(learning({"job": teachers[0].id}, options=options), job_store)
        assert refused.value.problems[-1].pointer == "/algorithm/experts/0/clips"


def test_the_job_is_kept_until_those_that_learn_from_it_have_ended(
    job_store: PostgresJobStore, tmp_path: Path
) -> None:
    source = trained(job_store)
    objects = MemoryObjectStore()
    objects.put(source.artifacts[0].key, POLICY)
    job = held(job_store, new_job(learning({"job": source.id}), job_store))
    with pytest.raises(JobInUse, match=job.id):
        job_store.delete(source.id, source.version)
    write_task(job, Claim(job.id, 1, job.token, job_store, objects), "cpu", tmp_path)
    task = Task.model_validate_json((tmp_path / "task.json").read_bytes())
    [(path, kind)] = task.experts
    assert kind == "ppo"
    assert (tmp_path / path).read_bytes() == POLICY
    job_store.save(job.ended(JobStatus.FAILED, Reason.TIMEOUT, "", NOW))
    job_store.delete(source.id, source.version)


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"algorithm": {"kind": "ppo", "action_repeat": 2}}, "holds an action for 2 steps"),
        ({"reason": Reason.TIMEOUT}, "an expert is that of a job that has succeeded"),
        ({"kept": False}, "has no policy of this kind"),
        ({"id": "g1"}, "trained 'g1', and this task has 'go1'"),
        ({"options": {**OPTIONS, "action": {"kind": "joint_position", "scale": 0.1}}}, "another action"),
        ({"options": {"observation": [GRAVITY]}}, "this task lacks; add it .*projected_gravity"),
    ],
    ids=["held-actions", "failed", "gone", "another-body", "another-action", "unseen"],
)
def test_a_job_that_is_no_expert_here_is_refused(
    job_store: PostgresJobStore, changes: dict[str, Any], sentence: str
) -> None:
    source = trained(job_store, **changes)
    with pytest.raises(Rejected, match=sentence) as refused:
        new_job(learning({"job": source.id}), job_store)
    assert refused.value.problems[-1].pointer.startswith("/algorithm/experts/0/")


def test_experts_that_are_not_there_not_to_be_seen_or_too_many_are_refused(
    job_store: PostgresJobStore,
) -> None:
    source = trained(job_store)
    for experts, readable, sentence in (
        ([{"job": "000000000000-0000000000"}], None, "no job"),
        ([{"job": source.id}], ["another"], "no job"),
        ([{"job": source.id}, {"job": source.id}], None, "There are 2 experts"),
        ([{"job": source.id, "clips": ["walk"]}], None, "those of a task with a `reference`"),
        ([], None, "Distillation needs `experts`"),
    ):
        with pytest.raises(Rejected, match=sentence):
            new_job(learning(*experts), job_store, readable=readable)
