"""Webhooks by HTTP: who may see and change them, what is refused, and that secrets are shown once."""

from collections.abc import Iterator
from ipaddress import ip_network
from threading import BoundedSemaphore
from typing import Any

import pytest
from fastapi import FastAPI

from core.accounts.principal import TokenScope
from core.jobs.job import Job
from core.news import channels
from core.news.webhook import ENDS, MAX_WEBHOOKS, Outcome
from tests.api.accounts import Lab, opened
from tests.api.conftest import Stack
from tests.api.problems import problem
from tests.contract.recording import cancelled, queued_job

HOOKS = "/projects/default/webhooks"
PUBLIC = "https://1.1.1.1/hook?token=word"


@pytest.fixture
def lab(server: tuple[FastAPI, int], stack: Stack) -> Iterator[Lab]:
    with opened(server[0], stack) as lab:
        yield lab


def add(stack: Stack, **said: Any) -> Any:
    answer = stack.http.post(HOOKS, json={"name": "hook", "url": PUBLIC, **said})
    assert answer.status_code == 201, answer.text
    return answer.json()


def ended_job(stack: Stack, **said: object) -> Job:
    job = stack.store.add(queued_job(**said))
    stack.store.save(cancelled(job))
    stack.store.spread_news()
    return job


def test_a_secret_is_shown_once_and_an_address_without_its_secrets(stack: Stack) -> None:
    made = add(stack)
    assert made["secret"].startswith("whsec_")
    assert made["events"] == [*ENDS]
    listed = stack.http.get(HOOKS).json()["items"]
    assert listed == [{name: value for name, value in made.items() if name != "secret"}]
    assert listed[0]["url"] == "https://1.1.1.1/…"
    assert stack.http.get(f"{HOOKS}/hook").json() == listed[0]
    given = f"whsec_{'A' * 32}"
    assert add(stack, name="other", secret=given)["secret"] == given


@pytest.mark.parametrize(
    ("said", "pointer", "words"),
    [
        ({"url": "http://127.0.0.1:9/"}, "/url", "127.0.0.1 is at 127.0.0.1, which is not public"),
        ({"url": "http://10.1.2.3/"}, "/url", "GAITWAY_NEWS_NETWORKS"),
        ({"url": "http://169.254.169.254/latest"}, "/url", "not public"),
        ({"url": "http://[::ffff:10.0.0.1]/"}, "/url", "not public"),
        ({"url": "http://[64:ff9b::a00:1]/"}, "/url", "not public"),
        ({"url": "http://2130706433/"}, "/url", "not public"),
        ({"url": "http://localhost:1/"}, "/url", "not public"),
        (
            {"url": "file:///etc/passwd"},
            "/url",
            "`url` begins with file; allowed are http, https, and discord",
        ),
        ({"url": "https://u:p@1.1.1.1/"}, "/url", "a user name or a password"),
        ({"secret": "whsec_AAAA"}, "/secret", "has 3 bytes after `whsec_`; 24 to 64 are allowed"),
        ({"secret": "word"}, "/secret", "must be `whsec_` and then base64"),
        ({"events": ["job.finished"]}, "/events/0", "job.failed"),
        ({"events": []}, "/events", "1"),
        ({"name": "A b"}, "/name", "name"),
        ({"hush": 1}, "/hush", "hush"),
    ],
)
def test_what_is_wrong_is_named(stack: Stack, said: dict[str, Any], pointer: str, words: str) -> None:
    answer = stack.http.post(HOOKS, json={"name": "hook", "url": PUBLIC, **said})
    document = problem(answer, 422, "invalid-request")
    assert document["errors"][0]["pointer"] == pointer
    assert words in document["errors"][0]["detail"]


def test_an_address_of_apprise_has_no_secret(stack: Stack) -> None:
    slack = "slack://T1JJ3T3L2/A1BRTD4JD/TIiajkdnlazkcOXrIdevi7FQ"
    made = add(stack, url=slack)
    assert (made["secret"], made["url"]) == (None, "slack://…")
    refused = stack.http.post(HOOKS, json={"name": "b", "url": slack, "secret": f"whsec_{'A' * 32}"})
    assert problem(refused, 422, "invalid-request")["errors"][0]["pointer"] == "/secret"


def test_apprise_looks_at_few_addresses_at_once(stack: Stack, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("core.news.channels._WAIT_S", 0.0)
    monkeypatch.setattr("core.news.channels._looking", BoundedSemaphore(1))
    slack = {"name": "hook", "url": "slack://T1JJ3T3L2/A1BRTD4JD/TIiajkdnlazkcOXrIdevi7FQ"}
    with channels._looking:  # pyright: ignore[reportPrivateUsage]
        problem(stack.http.post(HOOKS, json=slack), 503, "addresses-wait")
    assert stack.http.post(HOOKS, json=slack).status_code == 201


def test_a_change_is_checked_as_a_new_webhook_is(stack: Stack) -> None:
    add(stack)
    add(stack, name="chat", url="slack://T1JJ3T3L2/A1BRTD4JD/TIiajkdnlazkcOXrIdevi7FQ")
    changed = stack.http.patch(
        f"{HOOKS}/hook", json={"url": "https://1.0.0.1/", "events": ["job.failed"] * 2}
    )
    assert (changed.status_code, changed.json()["url"]) == (200, "https://1.0.0.1")
    assert changed.json()["events"] == ["job.failed"]
    assert "secret" not in changed.text.replace("old_secret_until", "")
    wrong: list[tuple[str, dict[str, Any], str, str]] = [
        ("hook", {"url": "http://10.1.2.3/"}, "/url", "not public"),
        ("hook", {"url": "ntfys://1.1.1.1/a"}, "/url", "has to be of the same kind"),
        ("chat", {"url": PUBLIC}, "/url", "has to be of the same kind"),
        ("hook", {"events": []}, "/events", "1"),
        ("hook", {"name": "other"}, "/name", "name"),
    ]
    for name, said, pointer, words in wrong:
        answer = stack.http.patch(f"{HOOKS}/{name}", json=said)
        (error,) = problem(answer, 422, "invalid-request")["errors"]
        assert error["pointer"] == pointer
        assert words in error["detail"]
    problem(stack.http.patch(f"{HOOKS}/none", json={"url": PUBLIC}), 404, "webhook-not-found")
    assert stack.http.patch(f"{HOOKS}/hook", json={"active": False}).json()["stopped"] == "Stopped by hand."
    assert stack.http.patch(f"{HOOKS}/hook", json={"active": True}).json()["stopped"] is None


def test_a_new_secret_is_shown_once(stack: Stack) -> None:
    made = add(stack)
    rotated = stack.http.post(f"{HOOKS}/hook/rotate").json()
    assert rotated["secret"].startswith("whsec_")
    assert rotated["secret"] != made["secret"]
    shown = stack.http.get(f"{HOOKS}/hook").json()
    assert shown == {name: value for name, value in rotated.items() if name != "secret"}
    assert shown["old_secret_until"] is not None
    add(stack, name="chat", url="slack://T1JJ3T3L2/A1BRTD4JD/TIiajkdnlazkcOXrIdevi7FQ")
    problem(stack.http.post(f"{HOOKS}/chat/rotate"), 409, "webhook-unsigned")


def test_a_project_has_so_many_of_different_names(stack: Stack) -> None:
    add(stack)
    problem(stack.http.post(HOOKS, json={"name": "hook", "url": PUBLIC}), 409, "webhook-exists")
    for number in range(1, MAX_WEBHOOKS):
        add(stack, name=f"hook-{number}")
    for url in (PUBLIC, "slack://nonsense"):  # It does not even look at the address.
        problem(stack.http.post(HOOKS, json={"name": "more", "url": url}), 409, "too-many-webhooks")
    problem(stack.http.get("/projects/none/webhooks"), 404, "project-not-found")
    problem(stack.http.delete(f"{HOOKS}/none"), 404, "webhook-not-found")
    assert stack.http.delete(f"{HOOKS}/hook").status_code == 204
    problem(stack.http.get(f"{HOOKS}/hook/deliveries"), 404, "webhook-not-found")


def test_a_test_and_what_was_sent_are_in_the_deliveries_page_by_page(stack: Stack) -> None:
    add(stack)
    job = ended_job(stack)
    sent = stack.http.post(f"{HOOKS}/hook/test")
    assert (sent.status_code, sent.json()["event"]) == (202, "webhook.test")
    (due, _) = stack.store.claim_deliveries(2, is_http=True)
    stack.store.note_outcome(due, Outcome(error="It answered 500.", answer=500))
    first = stack.http.get(f"{HOOKS}/hook/deliveries", params={"limit": 1}).json()
    assert first["items"][0]["id"] == sent.json()["id"]
    then = stack.http.get(f"{HOOKS}/hook/deliveries", params={"limit": 1, "cursor": first["next"]}).json()
    assert then["next"] is None
    (of_job,) = then["items"]
    assert (of_job["job"], of_job["status"], of_job["answer"]) == (job.id, "waiting", 500)
    assert stack.http.get(f"/jobs/{job.id}/deliveries").json()["items"] == [of_job]
    again = stack.http.post(f"/deliveries/{of_job['id']}/resend")
    assert (again.status_code, again.json()["message"]) == (202, of_job["message"])
    for wrong in ("x", "1.5", "9" * 30, str(10**17)):
        problem(stack.http.post(f"/deliveries/{wrong}/resend"), 404, "delivery-not-found")
    problem(stack.http.get(f"{HOOKS}/hook/deliveries", params={"cursor": "x"}), 422, "invalid-request")
    problem(stack.http.get("/jobs/019aa3c2f0b1-5be0c1d2e3/deliveries"), 404, "job-not-found")


def test_a_job_names_webhooks_of_its_project(stack: Stack) -> None:
    add(stack, jobs="named")
    spec = {"kind": "train", "environment": "ant", "notify": ["hook"]}
    assert stack.http.post("/jobs", json=spec).status_code == 202
    for path in ("/jobs", "/jobs/check"):
        refused = problem(
            stack.http.post(path, json={**spec, "notify": ["hook", "no"]}), 422, "invalid-request"
        )
        detail = "The project default has no webhook 'no'. It has: hook."
        assert refused["errors"] == [{"pointer": "/notify/1", "detail": detail}]
    sweep = {"job": {**spec, "notify": ["no"]}, "method": "grid", "parameters": {"seed": [1, 2]}}
    refused = problem(stack.http.post("/sweeps", json=sweep), 422, "invalid-request")
    assert refused["errors"][0]["pointer"] == "/job/notify/0"


def test_members_see_a_projects_webhooks_and_their_owner_or_an_admin_changes_them(lab: Lab) -> None:
    hooks = "/projects/a/webhooks"
    document = {"name": "hook", "url": PUBLIC}
    problem(lab.of("vic").post(hooks, json=document), 403, "forbidden")
    problem(lab.of("ann", TokenScope.READ).post(hooks, json=document), 403, "forbidden")
    problem(lab.of("bob").post(hooks, json=document), 404, "project-not-found")
    assert lab.of("ann").post(hooks, json=document).json()["owner"] == "ann"
    for user in ("ann", "amy", "vic", "root"):
        assert [one["name"] for one in lab.of(user).get(hooks).json()["items"]] == ["hook"]
        assert lab.of(user).get(f"{hooks}/hook/deliveries").json()["items"] == []
    for path in ("", "/hook", "/hook/deliveries"):
        problem(lab.of("bob").get(f"{hooks}{path}"), 404, "project-not-found")
    problem(lab.of("bob").delete(f"{hooks}/hook"), 404, "project-not-found")
    sent = lab.of("ann").post(f"{hooks}/hook/test")
    assert sent.status_code == 202
    again = f"/deliveries/{sent.json()['id']}/resend"
    for refused in (
        lab.of("amy").delete(f"{hooks}/hook"),
        lab.of("amy").patch(f"{hooks}/hook", json={"jobs": "own"}),
        *(lab.of("amy").post(path) for path in (f"{hooks}/hook/test", f"{hooks}/hook/rotate", again)),
    ):
        assert "belongs to ann" in problem(refused, 403, "forbidden")["detail"]
    problem(lab.of("bob").post(again), 404, "delivery-not-found")
    problem(lab.of("bob").patch(f"{hooks}/hook", json={}), 404, "project-not-found")
    assert lab.of("ann").post(again).status_code == 202
    assert lab.of("root").delete(f"{hooks}/hook").status_code == 204
    actions = [entry.action for entry in lab.stack.store.audit(object="project a").entries]
    assert actions[:2] == ["webhook.deleted", "webhook.added"]


def test_an_admin_allows_private_networks(server: tuple[FastAPI, int], stack: Stack) -> None:
    with opened(server[0], stack, news_networks=(ip_network("10.1.0.0/16"),)) as lab:
        hooks = "/projects/a/webhooks"
        inside = lab.of("ann").post(hooks, json={"name": "inside", "url": "http://10.1.2.3/"})
        assert inside.status_code == 201
        problem(
            lab.of("ann").post(hooks, json={"name": "b", "url": "http://10.2.2.3/"}), 422, "invalid-request"
        )
