"""The page's sessions: how they begin and end, and that no other site's page can use them."""

from collections.abc import Iterator
from datetime import timedelta

import httpx
import pytest
from fastapi import FastAPI

from api import authentication
from api.dependencies import Service
from core.accounts.principal import TokenScope
from tests.api.accounts import NOBODY, Lab, opened
from tests.api.conftest import Stack
from tests.api.problems import pointers, problem

PAGE = {"X-Gaitway-Page": "1", "Sec-Fetch-Site": "same-origin"}
JOB = {"kind": "train", "environment": "ant", "video": None}


@pytest.fixture
def lab(server: tuple[FastAPI, int], stack: Stack, monkeypatch: pytest.MonkeyPatch) -> Iterator[Lab]:
    """The record is asked at each request."""
    monkeypatch.setattr(authentication, "CACHED_S", 0.0)
    with opened(server[0], stack) as lab:
        yield lab


@pytest.fixture
def browser(lab: Lab) -> Iterator[httpx.Client]:
    """Keeps cookies, and sends what our page would."""
    url = f"http://127.0.0.1:{lab.stack.port}"
    with httpx.Client(base_url=url, headers=PAGE, timeout=20, verify=False) as client:  # noqa: S501
        yield client


def sign_in(browser: httpx.Client, token: str, **headers: str) -> httpx.Response:
    return browser.post("/session", json={"token": token}, headers=headers)


def test_a_token_is_typed_once(lab: Lab, browser: httpx.Client) -> None:
    assert browser.get("/session").json() == {"accounts": True, "provider": None, "who": None}
    answer = sign_in(browser, f" {lab.token('ann').text}\n")
    assert answer.status_code == 201
    assert answer.json()["who"]["user"] == "ann"
    assert browser.get("/session").json()["who"]["projects"] == ["a"]
    assert browser.post("/jobs", json=JOB).json()["owner"] == "ann"
    assert browser.delete("/session").status_code == 204
    assert not browser.cookies
    assert browser.get("/jobs").status_code == 401
    actions = [entry.action for entry in lab.stack.store.audit().entries]
    assert actions[:2] == ["session.ended", "session.begun"]


def test_the_cookie_is_out_of_reach_and_only_its_hash_is_stored(lab: Lab, browser: httpx.Client) -> None:
    cookie = sign_in(browser, lab.token("ann").text).headers["Set-Cookie"]
    assert {"HttpOnly", "SameSite=lax", "Path=/"} <= set(cookie.split("; "))
    assert "Secure" not in cookie
    name, _, text = cookie.partition(";")[0].partition("=")
    assert name == "gaitway_session"
    row = lab.stack.store.find_session(text.split("_")[1], timedelta(days=1))
    assert row is not None
    assert text not in row.sha256
    # A proxy in front of us has the TLS: the page's origin says so.
    over_tls = sign_in(browser, lab.token("ann").text, Origin=f"https://127.0.0.1:{lab.stack.port}")
    assert over_tls.headers["Set-Cookie"].startswith("__Host-gaitway_session=")
    assert "Secure" in over_tls.headers["Set-Cookie"]


def test_over_tls_the_plain_name_does_not_count(lab: Lab, browser: httpx.Client) -> None:
    sign_in(browser, lab.token("ann").text)

    def who(**headers: str) -> object:
        return browser.get("/session", headers=headers).json()["who"]

    assert who() is not None
    assert who(Origin=f"https://127.0.0.1:{lab.stack.port}") is None
    # Browsers send Sec-Fetch-Site, as `browser` does, to another machine only over TLS.
    assert who(Host="10.0.0.5") is None
    del browser.headers["Sec-Fetch-Site"]
    assert who(Host="10.0.0.5") is not None


def test_a_sign_in_ends_the_browsers_earlier_session(lab: Lab, browser: httpx.Client) -> None:
    sign_in(browser, lab.token("ann").text)
    earlier = httpx.Cookies(browser.cookies)
    sign_in(browser, lab.token("bob").text)
    with httpx.Client(base_url=browser.base_url, cookies=earlier, verify=False) as thief:  # noqa: S501
        assert problem(thief.get("/jobs"), 401, "unauthenticated")["reason"] == "session-ended"
    assert browser.get("/session").json()["who"]["user"] == "bob"


def test_a_session_does_no_more_than_its_token(lab: Lab, browser: httpx.Client) -> None:
    sign_in(browser, lab.token("ann", TokenScope.READ).text)
    document = problem(browser.post("/jobs", json=JOB), 403, "forbidden")
    assert document["needed_scope"] == "submit"


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("hunter2", "begins with gaitway_"),
        ("", "begins with gaitway_"),
        (f"gaitway_{'0' * 12}_{'x' * 43}", "does not know this token"),
    ],
)
def test_what_is_no_token_of_ours_is_refused_with_its_place(
    lab: Lab, browser: httpx.Client, text: str, sentence: str
) -> None:
    document = problem(sign_in(browser, text), 422, "invalid-request")
    assert pointers(document) == ["/token"]
    assert sentence in document["detail"]
    assert not browser.cookies


def test_a_token_that_may_not_sign_in_says_why(lab: Lab, browser: httpx.Client) -> None:
    worker = lab.token("root", TokenScope.WORKER)
    assert "lets a worker join" in problem(sign_in(browser, worker.text), 422, "invalid-request")["detail"]
    expired = lab.token("ann", lives=timedelta(seconds=-1))
    assert "expired" in problem(sign_in(browser, expired.text), 422, "invalid-request")["detail"]
    revoked = lab.token("ann")
    lab.stack.store.revoke_token(revoked.id, NOBODY)
    assert "revoked" in problem(sign_in(browser, revoked.text), 422, "invalid-request")["detail"]


def test_it_ends_with_its_token(lab: Lab, browser: httpx.Client) -> None:
    secret = lab.token("ann")
    sign_in(browser, secret.text)
    lab.stack.store.revoke_token(secret.id, NOBODY)
    assert problem(browser.get("/jobs"), 401, "unauthenticated")["reason"] == "session-ended"
    assert browser.get("/session").json()["who"] is None


def test_it_ends_with_its_user_and_does_not_come_back(lab: Lab, browser: httpx.Client) -> None:
    sign_in(browser, lab.token("ann").text)
    lab.stack.store.change_user("ann", NOBODY, active=False)
    assert browser.get("/jobs").status_code == 401
    lab.stack.store.change_user("ann", NOBODY, active=True)
    assert browser.get("/jobs").status_code == 401


def test_it_lives_no_longer_than_its_token(lab: Lab, browser: httpx.Client) -> None:
    answer = sign_in(browser, lab.token("ann", lives=timedelta(seconds=100)).text)
    [age] = [part for part in answer.headers["Set-Cookie"].split("; ") if part.startswith("Max-Age")]
    assert 90 < int(age.partition("=")[2]) <= 100


@pytest.mark.parametrize("limit", ["session_idle", "session_lifetime"])
def test_it_ends_when_it_is_old_or_was_not_used(lab: Lab, browser: httpx.Client, limit: str) -> None:
    parts = lab.service
    settings = parts.settings.model_copy(update={limit: timedelta(microseconds=1)})
    lab.app.state.service = Service(settings, parts.store, parts.queue, parts.objects)
    sign_in(browser, lab.token("ann").text)
    assert browser.get("/jobs").status_code == 401


@pytest.mark.parametrize(
    "headers",
    [
        {"Sec-Fetch-Site": "same-origin"},  # A form, without the page's header.
        {"X-Gaitway-Page": "1"},  # From nowhere.
        {"X-Gaitway-Page": "1", "Sec-Fetch-Site": "none"},
        {"X-Gaitway-Page": "1", "Sec-Fetch-Site": "same-site"},
        {"X-Gaitway-Page": "1", "Sec-Fetch-Site": "cross-site"},
        {"X-Gaitway-Page": "1", "Origin": "https://evil.example"},
        {"X-Gaitway-Page": "1", "Origin": "null"},
    ],
)
def test_only_our_page_changes_something_by_the_cookie(
    lab: Lab, browser: httpx.Client, headers: dict[str, str]
) -> None:
    sign_in(browser, lab.token("ann").text)
    with httpx.Client(base_url=browser.base_url, cookies=browser.cookies, verify=False) as foreign:  # noqa: S501
        for method, path in (("POST", "/jobs"), ("POST", "/tokens"), ("DELETE", "/session")):
            answer = foreign.request(method, path, json=JOB, headers=headers)
            problem(answer, 403, "cross-site-request")
        problem(foreign.post("/session", json={"token": ""}, headers=headers), 403, "cross-site-request")
    assert lab.stack.is_empty()
    assert browser.get("/session").json()["who"]["user"] == "ann"


def test_without_fetch_metadata_the_origin_counts(lab: Lab, browser: httpx.Client) -> None:
    del browser.headers["Sec-Fetch-Site"]  # As at an address without TLS.
    browser.headers["Origin"] = str(browser.base_url)
    sign_in(browser, lab.token("ann").text)
    assert browser.post("/jobs", json=JOB).status_code == 202


def test_a_token_in_the_header_counts_before_the_cookie(lab: Lab, browser: httpx.Client) -> None:
    sign_in(browser, lab.token("ann").text)
    headers = {"Authorization": f"Bearer {lab.token('bob').text}"}
    with httpx.Client(base_url=browser.base_url, cookies=browser.cookies, headers=headers) as program:
        assert program.post("/jobs", json=JOB).json()["owner"] == "bob"


def test_failed_sign_ins_are_counted_by_address(
    lab: Lab, browser: httpx.Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    moment = [100.0]
    monkeypatch.setattr(authentication, "monotonic", lambda: moment[0])
    secret = lab.token("ann")
    for _ in range(40):  # Those that succeed do not count.
        assert sign_in(browser, secret.text).status_code == 201
    most = int(lab.service.settings.sign_ins_per_minute)
    assert [sign_in(browser, "x").status_code for _ in range(most + 1)] == [422] * most + [429]
    answer = sign_in(browser, secret.text)
    assert "sign-ins from this address" in problem(answer, 429, "too-many-requests")["detail"]
    moment[0] += int(answer.headers["Retry-After"])
    assert sign_in(browser, secret.text).status_code == 201


def test_a_service_without_accounts_has_nobody_to_sign_in(stack: Stack) -> None:
    document = stack.http.get("/session").json()
    assert (document["accounts"], document["who"]["role"]) == (False, "admin")
    problem(stack.http.post("/session", json={"token": "x"}, headers=PAGE), 409, "accounts-off")
