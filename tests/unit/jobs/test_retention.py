"""Which files of an ended job the rules of its project remove."""

from datetime import timedelta
from typing import Any

import pytest

from core.errors import Rejected
from core.jobs.retention import (
    EndedJob,
    Need,
    RetainedFile,
    RetentionRules,
    Verdict,
    check_rules,
    choice,
    judge,
    rules_due,
)
from core.jobs.status import JobStatus
from tests.unit.jobs.making import NOON

JOB, OTHER = "019aa3c2f0b1-5be0c1d2e3", "019aa3c2f0b2-5be0c1d2e4"
FILES = [
    *(RetainedFile(f"checkpoint-{step}", "checkpoint", step, 100) for step in (10, 20, 30)),
    RetainedFile("video.mp4", "video", None, 7),
    RetainedFile("video.png", "poster", None, 2),
    RetainedFile("replay", "replay", None, 3),
    RetainedFile("trajectory", "trajectory", None, 30),
    RetainedFile("policy", "policy", None, 5),
    RetainedFile("policy-best", "best_policy", None, 5),
    RetainedFile("policy.onnx", "export", None, 5),
]


def ended(status: JobStatus = JobStatus.SUCCEEDED, days_ago: float = 10, **said: Any) -> EndedJob:
    return EndedJob(JOB, 4, "run", None, status, NOON - timedelta(days=days_ago), **said)


def judged(rules: RetentionRules, job: EndedJob, *needs: Need) -> Verdict:
    """The verdict on the files that `choice` names, as the record finds them."""
    due = rules_due(job, rules.limits(NOON))
    chosen = choice(rules, due, is_needed=bool(needs) or job.sweep is not None)
    kept = sorted(file.step for file in FILES if file.step is not None)[-chosen.keep :]
    files = [
        file for file in FILES if chosen.is_whole or (file.role in chosen.roles and file.step not in kept)
    ]
    return judge(job, due, files, needs)


def removed(rules: RetentionRules, job: EndedJob, *needs: Need) -> set[str]:
    """The names of the files that go."""
    verdict = judged(rules, job, *needs)
    return set() if verdict.removal is None else {file.name for file in verdict.removal.all_files}


@pytest.mark.parametrize(
    ("rules", "gone"),
    [
        ({"checkpoints": 2}, {"checkpoint-10"}),
        ({"checkpoints": 1}, {"checkpoint-10", "checkpoint-20"}),
        ({"checkpoints": 3}, set[str]()),
        ({"videos_days": 10}, {"video.mp4", "video.png"}),
        ({"videos_days": 11}, set[str]()),
        ({"replays_days": 1}, {"replay", "trajectory"}),
        ({"failed_days": 1, "cancelled_days": 1}, set[str]()),
        ({"checkpoints": 2, "videos_days": 1}, {"checkpoint-10", "video.mp4", "video.png"}),
    ],
)
def test_each_rule_removes_its_own_files(rules: dict[str, int], gone: set[str]) -> None:
    assert removed(RetentionRules(**rules), ended()) == gone


@pytest.mark.parametrize(
    ("status", "rule"), [(JobStatus.FAILED, "failed_days"), (JobStatus.CANCELLED, "cancelled_days")]
)
def test_a_job_that_failed_or_was_cancelled_goes_as_a_whole(status: JobStatus, rule: Any) -> None:
    rules = RetentionRules(**{rule: 10}, checkpoints=1)
    verdict = judged(rules, ended(status))
    assert verdict.removal is not None
    assert verdict.removal.is_whole
    assert [*verdict.removal.files] == [rule]
    assert verdict.removal.num_bytes == 357
    # A day earlier its checkpoints alone.
    assert removed(rules, ended(status, days_ago=9.9)) == {"checkpoint-10", "checkpoint-20"}


def test_what_another_job_needs_stays_and_the_job_is_named() -> None:
    rules, job = RetentionRules(checkpoints=1), ended()
    verdict = judged(rules, job, Need(OTHER, 10))
    assert verdict.needs == [Need(OTHER, 10)]
    assert removed(rules, job, Need(OTHER, 10)) == {"checkpoint-20"}
    # The newest always stays, and a policy too.
    assert judged(rules, job, Need(OTHER, None), Need(OTHER, 30)).needs == []


def test_a_whole_job_that_another_one_needs_stays_but_its_other_rules_hold() -> None:
    rules, job = RetentionRules(failed_days=1, videos_days=1), ended(JobStatus.FAILED)
    assert removed(rules, job, Need(OTHER, None)) == {"video.mp4", "video.png"}
    assert judged(rules, job, Need(OTHER, None)).needs == [Need(OTHER, None)]


def test_a_job_of_a_sweep_that_goes_on_is_left_alone() -> None:
    verdict = judged(RetentionRules(checkpoints=1), ended(sweep=OTHER))
    assert (verdict.removal, verdict.sweep) == (None, OTHER)
    assert judged(RetentionRules(checkpoints=9), ended(sweep=OTHER)).sweep is None


def test_a_pinned_job_loses_nothing() -> None:
    rules = RetentionRules(checkpoints=1, videos_days=1, failed_days=1)
    job = ended(JobStatus.FAILED, is_pinned=True)
    assert rules_due(job, rules.limits(NOON)) == ()
    assert judged(rules, job).removal is None


def test_rules_that_say_nothing_are_refused() -> None:
    with pytest.raises(Rejected, match=r"No rule says anything\. Give one of checkpoints, videos_days"):
        check_rules(RetentionRules())
