"""News reaches real receivers: signed, again after failures, and through the death of its sender."""

import base64
import hashlib
import hmac
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from ipaddress import ip_network
from threading import Event

import pytest
from anyio.from_thread import start_blocking_portal
from pydantic import SecretStr

from core.accounts.store import Actor
from core.adapters.postgres.store import PostgresJobStore
from core.news.channels import BadAddress, check_url, send_by_apprise
from core.news.webhook import EVENTS, Delivery, Webhook, new_signing_secret, signed_headers
from tests.contract.recording import NOW, Database, cancelled, queued_job
from tests.receivers import Received, Receiver, receiving
from worker.news import Head, Post, Sender, outcome_of, wait_of

HERE = (ip_network("127.0.0.1/32"),)
# Runs a sender as the reconciler does.
_SENDER = """
import sys
from ipaddress import ip_network
from core.adapters.postgres.engine import connect_postgres
from core.adapters.postgres.store import PostgresJobStore
from worker.news import Post, Sender
Sender(PostgresJobStore(connect_postgres(sys.argv[1])), Post((ip_network("127.0.0.1/32"),)), 0.05).run()
"""


@contextmanager
def sending(store: PostgresJobStore, post: Post | None = None) -> Iterator[None]:
    """A sender in this process."""
    sender = Sender(store, post or Post(HERE), every_s=0.02)
    with start_blocking_portal() as portal:
        serving = portal.start_task_soon(sender.serve)
        try:
            yield
        finally:
            serving.cancel()


def add_webhook(store: PostgresJobStore, url: str, name: str = "hook") -> Webhook:
    webhook = Webhook(
        project="default",
        name=name,
        url=SecretStr(url),
        events=EVENTS,
        jobs="all",
        secret=new_signing_secret(),
        created_at=NOW,
    )
    return store.add_webhook(webhook, Actor())


def end_a_job(store: PostgresJobStore) -> str:
    job = store.add(queued_job())
    store.save(cancelled(job))
    return job.id


def wait_for(
    store: PostgresJobStore, is_so: Callable[[Delivery], bool], number: int = 1
) -> Sequence[Delivery]:
    """The deliveries, once all of so many are so."""
    until = time.monotonic() + 20
    while time.monotonic() < until:
        found = store.deliveries().deliveries
        if len(found) == number and all(map(is_so, found)):
            return found
        time.sleep(0.02)
    raise AssertionError(store.deliveries().deliveries)


def signature(received: Received, secret: SecretStr | None) -> str:
    """By hand, as a receiver makes it."""
    assert secret is not None
    key = base64.b64decode(secret.get_secret_value().removeprefix("whsec_"))
    said = [received.headers[name].encode() for name in ("webhook-id", "webhook-timestamp")]
    digest = hmac.new(key, b".".join([*said, received.body]), hashlib.sha256).digest()
    return f"v1,{base64.b64encode(digest).decode()}"


def has_failed_once(delivery: Delivery) -> bool:
    return delivery.error is not None


def is_delivered(delivery: Delivery) -> bool:
    return delivery.status == "delivered"


def test_the_end_of_a_job_is_there_within_two_seconds_and_signed(job_store: PostgresJobStore) -> None:
    with receiving() as receiver, sending(job_store):
        webhook = add_webhook(job_store, receiver.url)
        ended_at = time.monotonic()
        job_id = end_a_job(job_store)
        received = receiver.next()
        assert time.monotonic() - ended_at < 2
        assert received.message["data"]["id"] == job_id
        (delivery,) = wait_for(job_store, is_delivered)
        assert (delivery.answer, delivery.attempts, delivery.message) == (
            204,
            1,
            received.headers["webhook-id"],
        )
    assert received.headers["webhook-signature"] == signature(received, webhook.secret)


def test_the_secret_before_a_new_one_signs_beside_it_for_a_day(
    job_store: PostgresJobStore, database: Database
) -> None:
    with receiving() as receiver, sending(job_store):
        old, new = add_webhook(job_store, receiver.url), new_signing_secret()
        job_store.rotate_secret("default", "hook", new, Actor())
        end_a_job(job_store)
        received = receiver.next()
        both = f"{signature(received, new)} {signature(received, old.secret)}"
        assert received.headers["webhook-signature"] == both
        database.change("UPDATE webhooks SET old_secret_until = now()")
        end_a_job(job_store)
        received = receiver.next()
        assert received.headers["webhook-signature"] == signature(received, new)


def test_a_receiver_that_fails_twice_gets_it_at_the_third_try(
    job_store: PostgresJobStore, database: Database
) -> None:
    with receiving(lambda number: (500 if number < 3 else 200, "")) as receiver, sending(job_store):
        add_webhook(job_store, receiver.url)
        end_a_job(job_store)
        ids = set[str]()
        for _ in range(2):
            ids.add(receiver.next().headers["webhook-id"])
            wait_until_noted(database)
            # Instead of waiting for five seconds.
            database.change("UPDATE deliveries SET next_attempt_at = now()")
        ids.add(receiver.next().headers["webhook-id"])
        (delivery,) = wait_for(job_store, is_delivered)
        assert (delivery.attempts, delivery.error, len(ids)) == (3, None, 1)


def test_a_receiver_that_asks_for_a_later_try_gets_it_then(job_store: PostgresJobStore) -> None:
    with receiving(lambda number: (503, "3600")) as receiver, sending(job_store):
        add_webhook(job_store, receiver.url)
        end_a_job(job_store)
        (delivery,) = wait_for(job_store, has_failed_once)
        assert delivery.next_attempt_at is not None
        wait = delivery.next_attempt_at - job_store.now()
        assert timedelta(minutes=59) < wait <= timedelta(hours=1)


def errors_of(webhook: str, store: PostgresJobStore) -> Sequence[str | None]:
    return [one.error for one in store.deliveries().deliveries if one.webhook == webhook]


def test_one_that_hangs_is_given_up_and_delays_no_other(job_store: PostgresJobStore) -> None:
    with (
        receiving(lambda number: None) as silent,
        receiving() as prompt,
        sending(job_store, Post(HERE, timeout_s=3.0)),
    ):
        add_webhook(job_store, silent.url, "silent")
        for _ in range(5):
            end_a_job(job_store)
        silent.next()
        add_webhook(job_store, prompt.url, "prompt")
        ended_at = time.monotonic()
        job_id = end_a_job(job_store)
        # News of the jobs before it may be spread after the webhook was added, and come to it, too.
        while prompt.next().message["data"]["id"] != job_id:
            pass
        assert time.monotonic() - ended_at < 2
        until = time.monotonic() + 20
        while None in (errors := errors_of("silent", job_store)) and time.monotonic() < until:
            time.sleep(0.02)
        assert errors == ["It did not answer within 3 s."] * 6


def test_a_redirect_is_not_followed(job_store: PostgresJobStore) -> None:
    with receiving(host="127.0.0.2") as inside:
        with receiving(lambda number: (302, inside.url)) as receiver, sending(job_store):
            add_webhook(job_store, receiver.url)
            end_a_job(job_store)
            (delivery,) = wait_for(job_store, has_failed_once)
        place = inside.url.removesuffix("/hook")
        assert delivery.error == f"It redirects to {place}/…; redirects are not followed."
        assert inside.requests.empty()


def test_a_private_address_gets_nothing(job_store: PostgresJobStore) -> None:
    with receiving(host="127.0.0.2") as inside, sending(job_store):
        add_webhook(job_store, inside.url)
        end_a_job(job_store)
        (delivery,) = wait_for(job_store, has_failed_once)
        assert "is not public" in str(delivery.error)
        assert "GAITWAY_NEWS_NETWORKS" in str(delivery.error)
        assert inside.requests.empty()


def test_a_name_that_means_another_address_a_moment_later_leads_to_the_first(
    job_store: PostgresJobStore,
) -> None:
    answers = iter([["127.0.0.1"], ["127.0.0.2"], ["127.0.0.2"]])

    async def rebinding(host: str, port: int) -> Sequence[str]:
        assert host == "hooks.example"
        return next(answers)

    with receiving() as receiver, sending(job_store, Post(HERE, rebinding)):
        port = receiver.url.split(":")[2]
        add_webhook(job_store, f"http://hooks.example:{port}")
        end_a_job(job_store)
        assert receiver.next().headers["host"] == f"hooks.example:{port.partition('/')[0]}"
        wait_for(job_store, is_delivered)
        assert next(answers) == ["127.0.0.2"]  # It was asked once.
        end_a_job(job_store)
        wait_for(job_store, lambda one: is_delivered(one) or "is at 127.0.0.2" in str(one.error), 2)


def test_news_of_a_killed_sender_comes_again_with_the_same_id(
    job_store: PostgresJobStore, database: Database, database_url: str
) -> None:
    with receiving(lambda number: None if number == 1 else (204, "")) as receiver:
        add_webhook(job_store, receiver.url)
        command = [sys.executable, "-c", _SENDER, database_url]
        with subprocess.Popen(command, stdout=subprocess.DEVNULL) as sender:
            end_a_job(job_store)
            lost = receiver.next(30)
            os.kill(sender.pid, signal.SIGKILL)
        # What happens while nobody sends is not lost, either.
        end_a_job(job_store)
        # Instead of waiting for the end of the claim.
        database.change("UPDATE deliveries SET next_attempt_at = now()")
        with sending(job_store):
            again = [receiver.next(), receiver.next()]
            wait_for(job_store, is_delivered, 2)
    assert lost.headers["webhook-id"] in {one.headers["webhook-id"] for one in again}
    assert lost.body in {one.body for one in again}


def wait_until_noted(database: Database) -> None:
    """Wait until the outcome of a try is there: no claim is under way."""
    until = time.monotonic() + 10
    while time.monotonic() < until:
        if database.read("SELECT 1 FROM deliveries WHERE next_attempt_at < now() + interval '40 s'"):
            return
        time.sleep(0.02)
    raise AssertionError


@pytest.fixture
def chat() -> Iterator[Receiver]:
    """A server that takes what Apprise sends to ntfy."""
    with receiving(lambda number: (200, "")) as receiver:
        yield receiver


def test_apprise_sends_to_allowed_addresses_alone(chat: Receiver) -> None:
    url = chat.url.replace("http://", "ntfy://").replace("/hook", "/gaits")
    assert send_by_apprise(url, "ant has succeeded", "job 1", HERE) is None
    assert b"ant has succeeded" in chat.next().body
    problem = send_by_apprise(url, "ant has succeeded", "job 1", ())
    assert problem is not None
    assert problem.startswith("it is at 127.0.0.1, which is not public")
    assert chat.requests.empty()


def test_apprise_follows_no_redirect_to_another_private_address() -> None:
    with receiving(host="127.0.0.2") as inside:
        with receiving(lambda number: (307, inside.url)) as receiver:
            url = receiver.url.replace("http://", "ntfy://").replace("/hook", "/gaits")
            assert send_by_apprise(url, "title", "text", HERE) is not None
        assert inside.requests.empty()


@pytest.mark.parametrize(
    "url",
    [
        "file:///etc/passwd",
        "exec://rm",
        "script://x",
        "syslog://",
        "dbus://",
        "json://127.0.0.1",
        "slack://T1JJ3T3L2/A1BRTD4JD/TIiajkdnlazkcOXrIdevi7FQ?template=/etc/passwd",
        "mailto://a:b@example.com?pgppub=/etc/passwd",
        "mailto://a:b@example.com?verify=no",
        "discord://id/token/#x?template=/etc/passwd",
        "mailto://a:b@example.com?to=x;verify=no",
        "slack://nonsense",
        "http://",
        "https://user:word@hooks.example",
        "https://hooks.example/a b",
        "hooks.example",
        f"https://hooks.example/{'p' * 2000}",
    ],
)
def test_an_address_that_is_none_or_not_allowed_is_refused(url: str) -> None:
    with pytest.raises(BadAddress):
        check_url(url)


@pytest.mark.parametrize(
    ("url", "name"),
    [
        ("discord://id/token/#x?template=/etc/passwd", "template"),
        ("mailto://a:b@example.com?to=x;verify=no", "verify"),
    ],
)
def test_apprise_itself_reads_no_parameter_that_is_not_allowed(url: str, name: str) -> None:
    problem = send_by_apprise(url, "title", "text", ())
    assert problem == f"it has the parameter `{name}`, which is not allowed here"


def test_a_known_address_is_taken() -> None:
    assert check_url("slack://T1JJ3T3L2/A1BRTD4JD/TIiajkdnlazkcOXrIdevi7FQ")


def test_what_an_answer_means() -> None:
    assert outcome_of(Head(202)).error is None
    assert outcome_of(Head(410)).stops
    assert not outcome_of(Head(503)).is_final
    for status, wait in ((429, 7), (503, 7), (500, None)):
        answer = outcome_of(Head(status, retry_after="7"))
        assert answer.wait == (wait and timedelta(seconds=wait))


@pytest.mark.parametrize(
    ("said", "seconds"),
    [
        ("120", 120),
        (" 0 ", 0),
        ("Sat, 21 Nov 2026 12:05:00 GMT", 300),
        ("Sat, 21 Nov 2026 11:00:00 GMT", 0),
        ("Sat, 21 Nov 2026 12:05:00", 300),
        *(
            (wrong, None)
            for wrong in ("", "-1", "1.5", "soon", "9" * 30, "9" * 5000, "Sat, 99 Nov 2026 12:05:00")
        ),
    ],
)
def test_a_retry_after_is_seconds_or_a_date(said: str, seconds: int | None) -> None:
    now = datetime(2026, 11, 21, 12, tzinfo=UTC)
    assert wait_of(said, now) == (None if seconds is None else timedelta(seconds=seconds))


@pytest.mark.parametrize("location", ["", "/secret", "http://[secret"])
def test_a_redirect_to_no_whole_address_says_nothing_of_it(location: str) -> None:
    assert outcome_of(Head(302, location)).error == "It redirects; redirects are not followed."


def test_a_defect_of_the_record_does_not_end_the_sender(
    job_store: PostgresJobStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("worker.news._PAUSE_IN_OUTAGE_S", 0.05)
    spread, called = job_store.spread_news, Event()

    def broken() -> int:
        monkeypatch.setattr(job_store, "spread_news", spread)
        called.set()
        raise ValueError("a defect")

    monkeypatch.setattr(job_store, "spread_news", broken)
    with receiving() as receiver, sending(job_store):
        add_webhook(job_store, receiver.url)
        end_a_job(job_store)
        receiver.next()
        wait_for(job_store, is_delivered)
    assert called.is_set()


def test_the_signature_is_that_of_the_specification() -> None:
    # The example of the reference libraries' tests.
    headers = signed_headers(
        "msg_p5jXN8AQM9LWM0D4loKWxJek",
        datetime.fromtimestamp(1614265330, UTC),
        b'{"test": 2432232314}',
        ["whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw"],
    )
    assert headers["webhook-signature"] == "v1,g0hM9SsE+OTPJTGt/tmIKtSyZlE3uFJELVlNIOLJ1OE="
