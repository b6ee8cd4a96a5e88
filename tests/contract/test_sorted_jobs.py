"""What the record promises of lists that are sorted, and of those in which sweeps are folded."""

import base64
import json
from collections.abc import Sequence
from datetime import timedelta
from typing import Any

import pytest

from core.errors import Rejected
from core.jobs.job import Job, Progress
from core.jobs.sorting import COLUMNS, Sort, sort_by
from core.jobs.status import JobStatus
from core.jobs.store import FOLDED, NO_SWEEP, JobQuery, Whose
from core.reasons import Reason
from core.sweeps.sweep import Sweep, SweepStore
from tests.contract.recording import LEASE, NOW, Database, cancelled, held, queued_job
from tests.unit.sweeps.making import sweep_of, trial_of

EARLY, LATE, NONE = 0, 1, 2


def listed(store: SweepStore, query: JobQuery, limit: int = 50) -> list[str]:
    """The ids of all pages."""
    found, cursor = list[str](), None
    while True:
        page = store.list(query, cursor=cursor, limit=limit)
        found += [job.id for job in page.jobs]
        cursor = page.next_cursor
        if cursor is None:
            return found


def sorted_by(column: str, *, descending: bool = False, **filters: Any) -> JobQuery:
    return JobQuery(sort=sort_by(column, descending=descending), **filters)


def reporting(store: SweepStore, job: Job, progress: Progress) -> None:
    store.record(job.id, job.token, "events", [], progress, write_id=f"of {job.id}")


def _made(*parts: Any) -> str:
    return "sorted-" + base64.urlsafe_b64encode(json.dumps(parts).encode()).decode().rstrip("=")


def _parts(cursor: str | None) -> list[Any]:
    text = (cursor or "").removeprefix("sorted-")
    return json.loads(base64.urlsafe_b64decode(text + "=" * (-len(text) % 4)))


@pytest.fixture
def three(jobs: SweepStore) -> list[Job]:
    """Two jobs with values in all columns, which the first has less of, and one with few values."""
    found = [
        queued_job(0, name="alone", labels={"arm": "1"}, kind="rollout", policy={"kind": "random"}),
        queued_job(1, name="Beside", labels={"arm": "2"}, environment="hopper"),
        queued_job(2, environment="walker2d"),
    ]
    owned = [("ann", "a"), ("bob", "b"), (None, "c")]
    found = [
        job.model_copy(update={"owner": owner, "project": project})
        for job, (owner, project) in zip(found, owned, strict=True)
    ]
    jobs.add(found[NONE])
    for number, (at, (device, engine)) in enumerate([(10, ("cpu", "mjx")), (20, ("gpu:0", "native"))]):
        job = found[number]
        jobs.add(job)
        begun = job.claimed("worker", NOW + timedelta(seconds=at))
        jobs.save(begun, lease=LEASE)
        value = float(at)
        metrics = {"eval/episode_reward": value} if number else {"training/episode_reward": value}
        reporting(jobs, begun, Progress(step=at, total=100, steps_per_second=value, metrics=metrics))
        running = begun.running(device=device, engine=engine)
        jobs.save(running)
        if number:
            again = running.requeued(Reason.WORKER_LOST, "", NOW + timedelta(seconds=at))
            jobs.save(again)
            running = again.claimed("worker", NOW + timedelta(seconds=at))
            jobs.save(running, lease=LEASE)
            running = running.running()
            jobs.save(running)
        # The first ran for 10 seconds, the second for 20.
        end = JobStatus.FAILED if number else JobStatus.SUCCEEDED
        jobs.save(running.ended(end, Reason.COMPLETED, "", NOW + timedelta(seconds=2 * at)))
    return found


@pytest.mark.parametrize("column", [*COLUMNS, "label:arm"])
def test_each_column_sorts_both_ways_with_what_has_no_value_last(
    jobs: SweepStore, three: list[Job], column: str
) -> None:
    # The third has an environment, a project and a kind, and is queued; it has no attempt and no step yet.
    beyond = {
        "environment": 1,
        "project": 1,
        "created": 1,
        "status": -1,
        "attempts": -1,
        "kind": 0,
        "steps": 0,
    }
    place = beyond.get(column)
    upwards = [EARLY, LATE, NONE] if place != -1 else [NONE, EARLY, LATE]
    if column == "kind":  # Two are trainings: the newer comes first either way.
        upwards, downwards = [EARLY, NONE, LATE], [NONE, LATE, EARLY]
    elif place is None or column == "steps":
        downwards = [LATE, EARLY, NONE]
    else:
        downwards = upwards[::-1]
    for limit in (1, 2, 50):
        for descending, expected in ((False, upwards), (True, downwards)):
            found = listed(jobs, sorted_by(column, descending=descending), limit)
            assert found == [three[at].id for at in expected], (limit, descending)


def test_a_page_begins_where_the_one_before_ended_though_jobs_come_and_go(jobs: SweepStore) -> None:
    same = [queued_job(at, name="same") for at in range(4)]
    for job in same:
        jobs.add(job)
    query = sorted_by("name")
    first = jobs.list(query, limit=2)
    assert [job.id for job in first.jobs] == [same[3].id, same[2].id]
    jobs.save(cancelled(same[2]))
    jobs.delete(same[2].id, 2)
    jobs.add(queued_job(9, name="a"))
    rest = jobs.list(query, cursor=first.next_cursor, limit=2)
    assert [job.id for job in rest.jobs] == [same[1].id, same[0].id]
    assert rest.next_cursor is None


def test_how_long_running_jobs_have_run_is_the_same_on_all_pages(
    jobs: SweepStore, database: Database
) -> None:
    """One that runs must not overtake the page's end while somebody reads."""
    running, ended = held(jobs, queued_job(0)), held(jobs, queued_job(1))
    jobs.save(running := running.running())
    jobs.save(ended := ended.running())
    jobs.save(ended.ended(JobStatus.SUCCEEDED, Reason.COMPLETED, "", NOW + timedelta(hours=24)))
    database.change("UPDATE jobs SET started_at = now() - interval '23 h' WHERE id = %s", running.id)
    query = sorted_by("duration", descending=True)
    first = jobs.list(query, limit=1)
    assert [job.id for job in first.jobs] == [ended.id]
    assert [job.id for job in jobs.list(query, cursor=first.next_cursor).jobs] == [running.id]
    # Had the first page been read two hours later, it would have had the other one.
    column, descending, value, job, at = _parts(first.next_cursor)
    later = _made(column, descending, value, job, at + 7200)
    assert list(jobs.list(query, cursor=later).jobs) == []


def test_filters_and_owners_hold_for_sorted_lists(jobs: SweepStore, three: list[Job]) -> None:
    def found(**filters: Any) -> list[str]:
        return listed(jobs, sorted_by("name", **filters))

    assert found(status=JobStatus.FAILED) == [three[LATE].id]
    assert found(labels={"arm": "1"}) == [three[EARLY].id]
    assert found(whose=Whose(projects=("a", "c"), first="bob")) == [three[EARLY].id, three[NONE].id]
    assert found(whose=Whose(owner="bob")) == [three[LATE].id]


def test_only_the_newest_of_those_that_one_may_see_are_sorted(
    jobs: SweepStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("core.adapters.postgres.sorting._MOST", 2)
    added = [
        queued_job(at, name=name).model_copy(update={"project": "b" if name in "de" else "a"})
        for at, name in enumerate("abcde")
    ]
    for job in added:
        jobs.add(job)
    assert listed(jobs, sorted_by("name"), 1) == [added[3].id, added[4].id]
    assert listed(jobs, sorted_by("name", whose=Whose(projects=("a",))), 1) == [added[1].id, added[2].id]
    # Three of project a, and two of b: only of a older ones are left out.
    assert [jobs.list(sorted_by("name", whose=Whose(projects=(one,)))).of_newest for one in "ab"] == [2, None]


def test_all_trials_of_a_sweep_are_sorted(jobs: SweepStore, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("core.adapters.postgres.sorting._MOST", 1)
    sweep, added = jobs.add_sweep(sweep_of()), [queued_job(at, name=name) for at, name in enumerate("abc")]
    for number, job in enumerate(added):
        assert jobs.add_trial(sweep.id, trial_of(number, job=job.id), job)
    jobs.add(queued_job(9))
    assert listed(jobs, sorted_by("name", sweep=sweep.id), 2) == [job.id for job in added]


@pytest.mark.parametrize(
    "cursor",
    [
        "",
        "sorted-",
        "sorted-é",
        "sorted-AAAA",
        "019aa3c2f0b1-5be0c1d2e3",
        _made("name", False, "a"),
        _made("name", False, 7, "019aa3c2f0b1-5be0c1d2e3", 0.0),
        _made("name", False, "a\0", "019aa3c2f0b1-5be0c1d2e3", 0.0),
        _made("name", False, "\ud800", "019aa3c2f0b1-5be0c1d2e3", 0.0),
        _made("name", False, "a", "no id", 0.0),
        _made("name", False, "a", 7, 0.0),
        _made("name", False, "a", "019aa3c2f0b1-5be0c1d2e3", float("nan")),
        _made("name", True, "a", "019aa3c2f0b1-5be0c1d2e3", 0.0),
        _made("kind", False, "a", "019aa3c2f0b1-5be0c1d2e3", 0.0),
        _made(["name"], False, "a", "019aa3c2f0b1-5be0c1d2e3", 0.0),
        _made("name", False, "a", "019aa3c2f0b1-5be0c1d2e3", "nan"),
        _made("name", False, "a", "019aa3c2f0b1-5be0c1d2e3", 10**400),
    ],
)
def test_a_cursor_that_this_list_did_not_give_is_refused(jobs: SweepStore, cursor: str) -> None:
    with pytest.raises(Rejected, match="The cursor is not one that this listing gave"):
        jobs.list(sorted_by("name"), cursor=cursor)


def test_a_number_is_a_number_in_a_cursor(jobs: SweepStore) -> None:
    for wrong in ("7", True, [7], float("inf")):
        with pytest.raises(Rejected):
            jobs.list(sorted_by("steps"), cursor=_made("steps", False, wrong, "019aa3c2f0b1-5be0c1d2e3", 0.0))


def test_damaged_progress_is_no_value(jobs: SweepStore, three: list[Job], database: Database) -> None:
    for damaged in ("no JSON", "[]", '{"step": "many"}', '{"step": 5, "phase": "\\u0000"}'):
        database.change("UPDATE jobs SET progress = %s WHERE id = %s", damaged, three[LATE].id)
        assert listed(jobs, sorted_by("steps", descending=True)) == [
            three[at].id for at in (EARLY, NONE, LATE)
        ]


@pytest.fixture
def swept(jobs: SweepStore) -> tuple[Sweep, list[Job]]:
    """A job, two trials of a sweep, a job, and a third trial: their names in the order of their age."""
    sweep = jobs.add_sweep(sweep_of())
    added = [queued_job(at, name=name) for at, name in enumerate(["one", "best", "worst", "two", "mean"])]
    for number, job in enumerate(added):
        if job.spec.name in ("one", "two"):
            jobs.add(job)
        else:
            assert jobs.add_trial(sweep.id, trial_of(number, job=job.id), job)
    return sweep, added


def _names(added: Sequence[Job], ids: Sequence[str]) -> list[str | None]:
    by_id = {job.id: job.spec.name for job in added}
    return [by_id[job] for job in ids]


@pytest.mark.parametrize("limit", [1, 2, 50])
def test_of_a_folded_sweep_the_first_trial_in_the_lists_order_is_there(
    jobs: SweepStore, swept: tuple[Sweep, list[Job]], limit: int
) -> None:
    sweep, added = swept

    def found(**query: Any) -> list[str | None]:
        return _names(added, listed(jobs, JobQuery(**query), limit))

    assert found(sweep=FOLDED) == ["mean", "two", "one"]
    assert found(sweep=NO_SWEEP) == ["two", "one"]
    assert found(sweep=sweep.id) == ["mean", "worst", "best"]
    assert found(sweep="019aa3c2f0b1-5be0c1d2e3") == []
    # Of those that match: `s` is in `best` and `worst`.
    assert found(sweep=FOLDED, search="s", kind="train") == ["worst"]
    assert found(sweep=FOLDED, name="best") == ["best"]
    names = Sort(column="name", descending=False)
    assert found(sweep=FOLDED, sort=names) == ["best", "one", "two"]
    assert found(sweep=FOLDED, sort=names.model_copy(update={"descending": True})) == ["worst", "two", "one"]
    assert found(sweep=sweep.id, sort=names) == ["best", "mean", "worst"]


def test_jobs_that_are_no_trials_read_no_trials(jobs: SweepStore, database: Database) -> None:
    """PostgreSQL read every trial for each of them, which took seconds."""
    sweep = jobs.add_sweep(sweep_of())
    jobs.add(queued_job(1))
    database.change(
        "INSERT INTO jobs (id, version, kind, environment, labels, spec, status, created_at) "
        "SELECT lpad(to_hex(n), 12, '0') || '-0000000000', version, kind, environment, labels, spec, status, "
        "created_at FROM jobs, generate_series(1, 50200) AS n"
    )
    # The newest two hundred are none.
    database.change(
        "INSERT INTO trials (sweep_id, number, job_id, created_at, document) "
        "SELECT %s, n, lpad(to_hex(n), 12, '0') || '-0000000000', now(), '{}' "
        "FROM generate_series(1, 50000) AS n",
        sweep.id,
    )
    database.change("ANALYZE jobs")
    database.change("ANALYZE trials")
    for query in (JobQuery(sweep=FOLDED), JobQuery(sweep=FOLDED, kind="train")):
        began = jobs.now()
        page = jobs.list(query, limit=150)
        assert jobs.now() - began < timedelta(seconds=1)
        assert len(page.jobs) == 150


def test_a_sweep_is_known_by_its_jobs(jobs: SweepStore, swept: tuple[Sweep, list[Job]]) -> None:
    sweep, added = swept
    trials = {job.id: sweep.id for job in added if job.spec.name in ("best", "worst", "mean")}
    assert jobs.sweeps_of([job.id for job in added]) == trials
    assert jobs.sweeps_of([]) == {}
    assert list(jobs.list_sweeps(ids=[sweep.id]).sweeps) == [sweep]
    assert list(jobs.list_sweeps(ids=[added[0].id]).sweeps) == []
