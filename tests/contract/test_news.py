"""What the record promises of webhooks, news and deliveries. How they are sent: tests/faults/test_news.py."""

from concurrent.futures import Future, ThreadPoolExecutor, wait
from datetime import timedelta
from functools import partial

import pytest
from pydantic import SecretStr
from pydantic_core import from_json

from core.accounts.principal import Role
from core.accounts.store import Actor, User
from core.adapters.postgres.news import forget_old
from core.adapters.postgres.store import PostgresJobStore
from core.errors import (
    DeliveryNotFound,
    ProjectNotFound,
    StaleJob,
    TooManyWebhooks,
    WebhookExists,
    WebhookNotFound,
    WebhookUnsigned,
)
from core.jobs.job import Job
from core.jobs.status import JobStatus
from core.news.webhook import (
    ENDS,
    EVENTS,
    MAX_WEBHOOKS,
    PAUSES,
    Change,
    Delivery,
    Due,
    News,
    Outcome,
    Webhook,
    new_message,
    new_signing_secret,
    pause_after,
    wants,
)
from core.reasons import Reason
from core.sweeps.sweep import SweepStatus
from tests.contract.recording import NOW, Database, cancelled, held, queued_job, taken_back
from tests.unit.sweeps.making import sweep_of

ANN = Actor("ann")


def webhook(name: str = "hook", **said: object) -> Webhook:
    facts = {
        "project": "default",
        "url": SecretStr("https://hooks.example/1"),
        "events": EVENTS,
        "jobs": "all",
        "secret": new_signing_secret(),
        "created_at": NOW,
    }
    return Webhook.model_validate({"name": name, **facts, **said})


def told(store: PostgresJobStore, name: str = "hook") -> list[str]:
    """The events of the webhook's deliveries, oldest first."""
    store.spread_news()
    found = store.deliveries(project="default", webhook=name).deliveries
    return [delivery.event for delivery in reversed(found)]


def claim(store: PostgresJobStore, limit: int = 10) -> list[Due]:
    return [*store.claim_deliveries(limit, is_http=True)]


def only_delivery(store: PostgresJobStore) -> Delivery:
    (delivery,) = store.deliveries().deliveries
    return delivery


@pytest.fixture
def ended(job_store: PostgresJobStore) -> Job:
    """A cancelled job, whose news is written, for a webhook."""
    job_store.add_webhook(webhook(events=ENDS), ANN)
    job = job_store.add(queued_job(name="first steps"))
    job_store.save(cancelled(job).model_copy(update={"message": "a\0b \\u0000"}))
    return job


def test_a_start_a_lost_attempt_and_an_end_are_news(job_store: PostgresJobStore) -> None:
    job_store.add_webhook(webhook(), ANN)
    job = held(job_store, queued_job())
    job_store.save(job := job.running(device="cpu"))
    job_store.save(job := taken_back(job))
    job_store.save(job := job.claimed("worker-2", NOW))
    job_store.save(job := job.requeued(Reason.WORKER_DRAINED, "It drains.", NOW))
    job_store.save(job := job.claimed("worker-3", NOW))
    job_store.save(job.ended(JobStatus.SUCCEEDED, Reason.COMPLETED, "Done.", NOW))
    assert told(job_store) == ["job.started", "job.attempt_lost", "job.succeeded"]


def test_a_message_says_what_the_job_is_and_how_it_ended(job_store: PostgresJobStore, ended: Job) -> None:
    job_store.spread_news()
    (due,) = claim(job_store)
    message = from_json(due.document)
    assert message["type"] == "job.cancelled"
    assert message["timestamp"] == "2026-11-21T12:00:00Z"
    about = {"id": ended.id, "name": "first steps", "status": "cancelled", "reason": "user_cancelled"}
    assert message["data"] == message["data"] | about
    assert message["data"]["message"] == "a\N{REPLACEMENT CHARACTER}b \\u0000"
    assert due.message.startswith("msg_")


def test_a_sweeps_end_is_news_once_each_time(job_store: PostgresJobStore) -> None:
    job_store.add_webhook(webhook(), ANN)
    sweep = job_store.add_sweep(sweep_of())
    for status in ("cancelling", "cancelled", "cancelled", "running", "succeeded"):
        sweep = sweep.next(status=SweepStatus(status))
        job_store.save_sweep(sweep)
    assert told(job_store) == ["sweep.cancelled", "sweep.succeeded"]
    message = from_json(claim(job_store, 1)[0].document)
    assert message["data"] == message["data"] | {"id": sweep.id, "environment": "ant"}


def test_a_change_that_is_refused_is_no_news(job_store: PostgresJobStore, database: Database) -> None:
    job = job_store.add(queued_job())
    job_store.save(cancelled(job))
    with pytest.raises(StaleJob):
        job_store.save(cancelled(job))
    assert database.count("news") == 1


def test_a_webhook_is_told_of_its_jobs_and_of_those_that_name_it(job_store: PostgresJobStore) -> None:
    job_store.add_user(User(name="ann", role=Role.SUBMITTER, projects=("default",), created_at=NOW), ANN)
    job_store.add_user(User(name="bob", role=Role.SUBMITTER, projects=("default",), created_at=NOW), ANN)
    for which in ("all", "own", "named"):
        job_store.add_webhook(webhook(which, jobs=which, owner="ann", events=ENDS), ANN)
    job_store.add_webhook(webhook("failures", events=["job.failed"]), ANN)
    anns, bobs, named = (
        queued_job().model_copy(update={"owner": "ann"}),
        queued_job(1).model_copy(update={"owner": "bob"}),
        queued_job(2, notify=["named"]).model_copy(update={"owner": "bob"}),
    )
    for job in (anns, bobs, named):
        job_store.save(cancelled(job_store.add(job)))
    job_store.spread_news()
    of = {
        job.id: {one.webhook for one in job_store.deliveries(job=job.id).deliveries}
        for job in (anns, bobs, named)
    }
    assert of == {anns.id: {"all", "own"}, bobs.id: {"all"}, named.id: {"all", "named"}}


def test_nobody_who_was_disabled_or_has_left_is_told(job_store: PostgresJobStore) -> None:
    for name, role in (
        ("ann", Role.SUBMITTER),
        ("bob", Role.SUBMITTER),
        ("root", Role.ADMIN),
        ("cat", Role.VIEWER),
    ):
        job_store.add_user(User(name=name, role=role, projects=("default",), created_at=NOW), ANN)
        job_store.add_webhook(webhook(name, owner=name), ANN)
    job_store.change_user("ann", ANN, active=False)
    job_store.change_members("default", ANN, remove=["bob", "root"])
    job_store.save(cancelled(job_store.add(queued_job())))
    job_store.spread_news()
    assert {one.webhook for one in job_store.deliveries().deliveries} == {"cat", "root"}


def test_two_senders_never_have_the_same_delivery(job_store: PostgresJobStore) -> None:
    for number in range(5):
        job_store.add_webhook(webhook(f"hook-{number}"), ANN)
    for number in range(8):
        job_store.save(cancelled(job_store.add(queued_job(number))))
    with ThreadPoolExecutor(6) as pool:
        assert sum(pool.map(job_store.spread_news, [3] * 6)) == 8
        assert len(job_store.deliveries(limit=100).deliveries) == 40
        claims = [*pool.map(partial(claim, job_store), [7] * 12)]
    found = [due.id for claimed in claims for due in claimed]
    assert len(found) == len(set(found))


def test_a_webhook_has_four_deliveries_under_way_at_most(job_store: PostgresJobStore) -> None:
    job_store.add_webhook(webhook("slow"), ANN)
    job_store.add_webhook(webhook("other", jobs="named"), ANN)
    for number in range(6):
        job_store.save(cancelled(job_store.add(queued_job(number))))
    job_store.save(cancelled(job_store.add(queued_job(7, notify=["other"]))))
    job_store.spread_news()
    first = claim(job_store)
    assert sorted(due.webhook.name for due in first) == ["other", *["slow"] * 4]
    assert not job_store.claim_deliveries(10, is_http=True, but_not=[("default", "slow")])
    assert not job_store.claim_deliveries(10, is_http=False)


def test_a_webhook_of_apprise_has_one_delivery_under_way(job_store: PostgresJobStore) -> None:
    for name in ("slow", "other"):
        job_store.add_webhook(webhook(name, url=SecretStr("ntfys://hooks.example/a"), secret=None), ANN)
    for number in range(2):
        job_store.save(cancelled(job_store.add(queued_job(number))))
    job_store.spread_news()
    claimed = job_store.claim_deliveries(10, is_http=False)
    assert sorted(due.webhook.name for due in claimed) == ["other", "slow"]


def test_a_webhook_that_is_removed_while_news_is_spread_takes_its_deliveries_with_it(
    job_store: PostgresJobStore, database: Database, ended: Job, monkeypatch: pytest.MonkeyPatch
) -> None:
    with ThreadPoolExecutor(1) as pool:
        removals = list[Future[None]]()

        def removed_meanwhile(webhook: Webhook, message: News) -> bool:
            removals.append(pool.submit(job_store.remove_webhook, "default", "hook", ANN))
            wait(removals, timeout=0.3)  # It waits for the end of the transaction.
            return wants(webhook, message)

        monkeypatch.setattr("core.adapters.postgres.news.wants", removed_meanwhile)
        assert job_store.spread_news() == 1
        removals[0].result()
    assert database.count("deliveries") == 0


def test_the_claim_of_a_dead_sender_runs_out(
    job_store: PostgresJobStore, database: Database, ended: Job
) -> None:
    job_store.spread_news()
    (lost,) = claim(job_store)
    assert not claim(job_store)
    database.change("UPDATE deliveries SET next_attempt_at = now()")
    (again,) = claim(job_store)
    assert (again.id, again.message, again.attempt) == (lost.id, lost.message, 2)
    job_store.note_outcome(lost, Outcome(error="late"))
    assert only_delivery(job_store).error is None
    job_store.note_outcome(again, Outcome(answer=204))
    done = only_delivery(job_store)
    assert (done.status, done.answer, done.next_attempt_at) == ("delivered", 204, None)


def test_it_is_tried_for_a_day_and_then_has_failed(
    job_store: PostgresJobStore, database: Database, ended: Job
) -> None:
    assert sum(PAUSES, timedelta()) == timedelta(days=1)
    assert [*PAUSES] == sorted(PAUSES)
    job_store.spread_news()
    for _ in PAUSES:
        database.change("UPDATE deliveries SET next_attempt_at = now()")
        (due,) = claim(job_store)
        job_store.note_outcome(due, Outcome(error="It answered 500.", answer=500))
        assert only_delivery(job_store).status == "waiting"
    database.change("UPDATE deliveries SET next_attempt_at = now()")
    (due,) = claim(job_store)
    job_store.note_outcome(due, Outcome(error="It answered 500.", answer=500))
    failed = only_delivery(job_store)
    assert (failed.status, failed.attempts, failed.error) == ("failed", len(PAUSES) + 1, "It answered 500.")


def test_a_receiver_that_is_gone_is_told_nothing_more(job_store: PostgresJobStore, ended: Job) -> None:
    job_store.save(cancelled(job_store.add(queued_job(1))))
    job_store.spread_news()
    due = claim(job_store, 1)[0]
    job_store.note_outcome(due, Outcome(error="Gone.", answer=410, is_final=True, stops=True))
    assert {one.status for one in job_store.deliveries().deliveries} == {"failed"}
    assert job_store.webhook("default", "hook").stopped == "Gone."
    job_store.save(cancelled(job_store.add(queued_job(2))))
    assert len(told(job_store)) == 2


def test_a_wait_that_the_receiver_asks_for_counts_up_to_a_day(
    job_store: PostgresJobStore, ended: Job
) -> None:
    for said, seconds in (({"seconds": 1}, 4.7), ({"hours": 1}, 3600), ({"days": 9}, 86_400)):
        pause = pause_after(1, timedelta(**said))
        assert pause is not None
        assert seconds <= pause.total_seconds() < seconds + 1
    job_store.spread_news()
    (due,) = claim(job_store)
    job_store.note_outcome(due, Outcome(error="It answered 503.", answer=503, wait=timedelta(hours=2)))
    then = only_delivery(job_store).next_attempt_at
    assert then is not None
    assert timedelta(hours=1.9) < then - job_store.now() <= timedelta(hours=2)


def test_a_change_of_a_webhook_holds_for_what_waits(job_store: PostgresJobStore, ended: Job) -> None:
    job_store.spread_news()
    change = Change(url=SecretStr("https://hooks.example/secret"), events=("job.failed",), jobs="named")
    changed = job_store.change_webhook("default", "hook", change, ANN)
    assert (changed.events, changed.jobs, changed.stopped) == (("job.failed",), "named", None)
    assert claim(job_store)[0].webhook == changed
    assert job_store.change_webhook("default", "hook", Change(), ANN) == changed
    with pytest.raises(WebhookNotFound):
        job_store.change_webhook("default", "no", change, ANN)
    entry = job_store.audit().entries[0]
    assert (entry.action, entry.details["url"]) == ("webhook.changed", "https://hooks.example/…")


def test_a_webhook_that_is_stopped_is_told_nothing_until_it_starts_again(
    job_store: PostgresJobStore, ended: Job
) -> None:
    job_store.spread_news()
    stopped = job_store.change_webhook("default", "hook", Change(active=False), ANN)
    assert (stopped.stopped, only_delivery(job_store).status) == ("Stopped by ann.", "failed")
    assert not claim(job_store)
    job_store.save(cancelled(job_store.add(queued_job(1))))
    assert len(told(job_store)) == 1
    job_store.change_webhook("default", "hook", Change(active=True), ANN)
    job_store.save(cancelled(job_store.add(queued_job(2))))
    assert len(told(job_store)) == 2


def test_the_end_of_an_old_address_does_not_stop_the_new_one(job_store: PostgresJobStore, ended: Job) -> None:
    job_store.spread_news()
    (due,) = claim(job_store)
    job_store.change_webhook("default", "hook", Change(url=SecretStr("https://hooks.example/2")), ANN)
    job_store.note_outcome(due, Outcome(error="Gone.", answer=410, is_final=True, stops=True))
    assert job_store.webhook("default", "hook").stopped is None


def test_a_new_secret_signs_beside_the_old_one_alone(job_store: PostgresJobStore, database: Database) -> None:
    first = job_store.add_webhook(webhook(), ANN)
    second, third = new_signing_secret(), new_signing_secret()
    rotated = job_store.rotate_secret("default", "hook", second, ANN)
    assert (rotated.secret, rotated.old_secret) == (second, first.secret)
    assert rotated.old_secret_until is not None
    assert timedelta(hours=23.9) < rotated.old_secret_until - job_store.now() <= timedelta(days=1)
    rotated = job_store.rotate_secret("default", "hook", third, ANN)
    assert (rotated.secret, rotated.old_secret) == (third, second)
    job_store.tidy()
    assert job_store.webhook("default", "hook") == rotated
    database.change("UPDATE webhooks SET old_secret_until = now()")
    job_store.tidy()
    kept = job_store.webhook("default", "hook")
    assert (kept.secret, kept.old_secret, kept.old_secret_until) == (third, None, None)
    job_store.add_webhook(webhook("chat", url=SecretStr("ntfys://hooks.example/a"), secret=None), ANN)
    with pytest.raises(WebhookUnsigned):
        job_store.rotate_secret("default", "chat", second, ANN)
    with pytest.raises(WebhookNotFound):
        job_store.rotate_secret("default", "no", second, ANN)
    assert [one.action for one in job_store.audit().entries].count("webhook.rotated") == 2


def test_a_message_is_sent_again_by_hand(job_store: PostgresJobStore, ended: Job) -> None:
    job_store.spread_news()
    (late,) = claim(job_store)
    assert job_store.webhook_of(late.id).name == "hook"
    second = job_store.resend(late.id)
    job_store.note_outcome(late, Outcome(answer=204))
    newest, waited = job_store.deliveries().deliveries
    assert newest == second
    assert (waited.status, waited.error) == ("failed", f"Sent again by hand, as delivery {second.id}.")
    (due,) = claim(job_store)
    assert (due.id, due.attempt, due.message, due.document) == (second.id, 1, late.message, late.document)
    job_store.note_outcome(due, Outcome(answer=204))
    third = job_store.resend(second.id)
    assert (third.status, third.job) == ("waiting", ended.id)
    assert job_store.deliveries().deliveries[1].status == "delivered"
    for missing in (job_store.resend, job_store.webhook_of):
        with pytest.raises(DeliveryNotFound):
            missing(10**17)


def test_old_deliveries_are_found_by_an_index(
    job_store: PostgresJobStore, database: Database, ended: Job
) -> None:
    job_store.spread_news()
    database.change(
        """
        INSERT INTO deliveries (project, webhook, message, event, document, status, created_at, ended_at)
        SELECT project, webhook, message, event, document, 'delivered', now(), now() - interval '1 minute' * n
        FROM deliveries, generate_series(1, 20000) AS n
        """
    )
    database.change("ANALYZE deliveries")
    old = "SELECT id FROM deliveries WHERE ended_at < statement_timestamp() - interval '7 days' LIMIT 5000"
    plan = database.read(f"EXPLAIN {old}")
    assert "deliveries_ended" in str(plan)


def test_a_test_goes_to_one_webhook_that_wants_nothing(job_store: PostgresJobStore) -> None:
    job_store.add_webhook(webhook(jobs="named", events=[]), ANN)
    message = new_message("webhook.test", NOW, {"webhook": "hook"}, project="default")
    delivery = job_store.add_test("default", "hook", message)
    assert (delivery.status, delivery.job, delivery.attempts) == ("waiting", None, 0)
    assert [due.id for due in claim(job_store)] == [delivery.id]
    with pytest.raises(WebhookNotFound):
        job_store.add_test("default", "other", message)


def test_a_project_has_so_many_webhooks_each_with_its_name(
    job_store: PostgresJobStore, database: Database
) -> None:
    with pytest.raises(ProjectNotFound):
        job_store.add_webhook(webhook(project="gaits"), ANN)
    with ThreadPoolExecutor(4) as pool:
        steps = [partial(job_store.add_webhook, webhook(f"hook-{n}"), ANN) for n in range(MAX_WEBHOOKS + 2)]
        errors = [one.exception() for one in [pool.submit(step) for step in steps]]
    assert [type(error) for error in errors if error] == [TooManyWebhooks] * 2
    job_store.remove_webhook("default", job_store.webhooks("default")[0].name, ANN)
    with pytest.raises(WebhookExists):
        job_store.add_webhook(webhook(job_store.webhooks("default")[0].name), ANN)
    with pytest.raises(WebhookNotFound):
        job_store.remove_webhook("default", "no", ANN)
    actions = [entry.action for entry in job_store.audit().entries]
    assert actions == ["webhook.deleted", *["webhook.added"] * MAX_WEBHOOKS]
    assert "hooks.example" not in str(database.read("SELECT details FROM audit"))


def test_old_deliveries_are_forgotten(
    job_store: PostgresJobStore, database: Database, ended: Job, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("core.adapters.postgres.store.forget_old", partial(forget_old, limit=1))
    job_store.save(cancelled(job_store.add(queued_job(1))))
    job_store.spread_news()
    for due in claim(job_store):
        job_store.note_outcome(due, Outcome(answer=200))
    job_store.tidy()
    assert database.count("deliveries") == 2
    database.change("UPDATE deliveries SET ended_at = now() - interval '8 days'")
    job_store.tidy()
    assert database.count("deliveries") == 0
