"""The lines that a job's log gets from its supervisor."""

from collections.abc import Mapping
from pathlib import Path

from core.jobs.job import Job, utc_now
from core.jobs.spec import JOB_SPEC
from core.jobs.status import JobStatus
from core.reasons import Reason
from worker.protocol import FileReady, Hello, Measured, Message, Noted, PhaseBegan, PhaseEnded, Started
from worker.supervision.outcome import Outcome
from worker.supervision.story import Story

TRAINING = {
    "kind": "train",
    "environment": {"id": "corridor", "options": {"walker": "ant"}},
    "algorithm": {"kind": "ppo", "num_timesteps": 1000},
}
ROLLOUT = {
    "kind": "rollout",
    "environment": "ant",
    "num_episodes": 3,
    "policy": {"kind": "checkpoint", "job": "019aa3c2f0b1-5be0c1d2e3", "step": 1000},
}
DONE = Outcome(JobStatus.SUCCEEDED, Reason.COMPLETED, "Everything asked for is done.")


class Clock:
    def __init__(self) -> None:
        self.seconds = 0.0

    def __call__(self) -> float:
        return self.seconds


def held(**spec: object) -> Job:
    return Job(id="019aa3c2f0b1-000000000", spec=JOB_SPEC.validate_python(spec), created_at=utc_now())


def begun(spec: Mapping[str, object], folder: Path, clock: Clock | None = None) -> Story:
    return Story(held(**spec).claimed("here:cpu", utc_now()), folder, clock or Clock())


def said(story: Story, *messages: Message) -> list[str]:
    """The lines without their times."""
    lines = [line for message in messages for line in story.lines(message)]
    return [line[10:] for line in lines]


def test_a_training_tells_who_runs_it_on_what_with_which_settings_and_what_came_of_it(tmp_path: Path) -> None:
    (tmp_path / "2-state").write_bytes(b"x" * 1_234_000)
    story = begun(TRAINING, tmp_path)
    first, second = story.begin()
    assert first[10:].startswith("Attempt 1 on worker here:cpu, ")
    assert second[10:] == "train corridor with walker=ant, seed 0, ppo"
    details = {
        "engine_reason": "It was measured fastest.",
        "host": "lab",
        "python": "3.13.1",
        "versions": {"gaitway": "1.0", "jax": "0.10"},
        "commit": "abc",
        "hyperparameters": {
            "num_timesteps": 1000,
            "num_envs": 256,
            "learning_rate": 1e-3,
            "layers": [32, 32],
        },
        "resumed_at_step": 500,
    }
    evaluation = {"eval/episode_reward": 12.345, "eval/episode_reward_std": 0.5, "eval/epoch_eval_time": 0.81}
    assert said(
        story,
        Hello(pid=1),
        Started(device="cpu × 2", engine="compiled", details=details),
        PhaseEnded(name="compile", seconds=8.12),
        Measured(step=600, values={"training/loss": 1.0}),
        Measured(step=600, values=evaluation),
        FileReady(name="checkpoint", path="2-state", role="checkpoint", media_type="", step=600),
        FileReady(name="video.mp4", path="gone", role="video", media_type="", step=600),
        FileReady(name="policy", path="gone", role="policy", media_type="", step=600),
        Noted(text="Two\nlines."),
    ) == [
        "Device: cpu × 2, of lab",
        "Engine: compiled. It was measured fastest.",
        "python 3.13.1, gaitway 1.0, jax 0.10, commit abc",
        "Settings that the job names: num_timesteps=1000",
        "Settings that were filled in: num_envs=256, learning_rate=0.001, layers=[32, 32]",
        "The run resumes from the checkpoint of step 500",
        "Compiled in 8.1 s",
        "Step 600: return 12.35 ± 0.5, in 0.8 s",
        "Checkpoint of step 600: 1.2 MB",
        "video.mp4",
        "Note: Two lines.",
    ]


def test_its_end_has_the_seconds_of_each_phase_and_the_reason(tmp_path: Path) -> None:
    clock = Clock()
    story = begun(TRAINING, tmp_path, clock)
    for phase, seconds in (("compiling", 3.0), ("training", 10.0), ("evaluating", 60.0), ("training", 2.0)):
        clock.seconds += seconds
        assert said(story, PhaseBegan(phase=phase)) == []  # type: ignore[arg-type]
    clock.seconds += 5
    took, why = story.end(DONE)
    assert (
        took[10:] == "Seconds by phase: preparing 3.0 s, compiling 10.0 s, training 65.0 s, evaluating 2.0 s"
    )
    assert why[10:] == "The job has succeeded (completed). Everything asked for is done."


def test_a_further_attempt_says_why_the_one_before_ended_and_a_given_back_job_where_it_goes(
    tmp_path: Path,
) -> None:
    lost = (
        held(**TRAINING).claimed("a", utc_now()).requeued(Reason.WORKER_LOST, "Its lease ran out.", utc_now())
    )
    story = Story(lost.claimed("b", utc_now()), tmp_path)
    lines = [line[10:] for line in story.begin()]
    assert lines[0].startswith("Attempt 2 on worker b")
    assert lines[1] == "Attempt 1 ended as worker_lost: Its lease ran out."
    *_, end = story.end(Outcome(None, Reason.WORKER_DRAINED, "The worker was shut down."))
    assert end[10:] == "The job goes back to the queue (worker_drained). The worker was shut down."


def test_a_rollout_says_whose_policy_acts(tmp_path: Path) -> None:
    _, what, whose = begun(ROLLOUT, tmp_path).begin()
    assert what[10:] == (
        "rollout ant, seed 0, 3 episodes of the policy in the checkpoint of step 1,000 of job"
    )
    assert whose.strip() == "019aa3c2f0b1-5be0c1d2e3"
    best = {"kind": "checkpoint", "job": "019aa3c2f0b1-5be0c1d2e3", "which": "best"}
    _, what = begun({**ROLLOUT, "policy": best}, tmp_path).begin()
    assert what[10:] == (
        "rollout ant, seed 0, 3 episodes of the policy of the best evaluation of job 019aa3c2f0b1-5be0c1d2e3"
    )


def test_a_process_that_was_taken_over_cannot_break_the_log(tmp_path: Path) -> None:
    file = FileReady(name="b", path="b", role="best_policy", media_type="", metadata={"return": "81"})
    assert said(begun(TRAINING, tmp_path), file) == [
        "Step 0: the best evaluation so far, with a return of 81; its policy is kept"
    ]


def test_a_long_line_goes_on_below_and_a_long_value_is_cut(tmp_path: Path) -> None:
    story = begun({**TRAINING, "environment": {"id": "ant", "options": {"x": "y" * 5000}}}, tmp_path)
    assert all(len(line) <= 200 for line in story.begin())
    first, *rest = story.lines(Noted(text="word " * 100))
    assert max(map(len, (first, *rest))) <= 110
    assert all(line.startswith(" " * 10) for line in rest)
