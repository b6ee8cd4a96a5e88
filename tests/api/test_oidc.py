"""Signing in at an identity provider, which each test starts on a free port."""

import time
from collections.abc import Callable, Iterator
from datetime import timedelta
from typing import Any

import httpx
import pytest
from fastapi import FastAPI
from joserfc import jwt
from joserfc.jwk import RSAKey
from pydantic import SecretStr

from api import oidc
from core.accounts.principal import Role
from core.settings import ApiSettings, GroupGrant
from tests.api.accounts import NOBODY, USERS, Lab, opened
from tests.api.conftest import NOWHERE, Stack
from tests.api.identity_provider import CLIENT, SECRET, Provider, provided, signed_by_hmac, unsigned
from tests.api.problems import pointers, problem
from tests.api.test_sessions import PAGE

KIM = {"sub": "1234", "preferred_username": "Kim", "email": "kim@lab.edu", "email_verified": True}


@pytest.fixture(scope="module")
def running() -> Iterator[Provider]:
    with provided() as provider:
        yield provider


@pytest.fixture
def provider(running: Provider) -> Provider:
    """It answers as it should, and lets Kim in."""
    running.claims, running.refuses, running.is_broken = dict(KIM), None, False
    running.forge, running.sign = lambda header, claims: None, None
    running.asked.clear()
    return running


def rules(provider: Provider, **changes: Any) -> dict[str, Any]:
    return {
        "oidc_issuer": provider.issuer,
        "oidc_client_id": CLIENT,
        "oidc_client_secret": SecretStr(SECRET),
        "oidc_domains": "lab.edu",
        **changes,
    }


@pytest.fixture
def lab(server: tuple[FastAPI, int], stack: Stack, provider: Provider, request: Any) -> Iterator[Lab]:
    with opened(server[0], stack, **rules(provider, **getattr(request, "param", {}))) as lab:
        yield lab


def with_settings(**changes: Any) -> pytest.MarkDecorator:
    return pytest.mark.parametrize("lab", [changes], indirect=True)


@pytest.fixture
def browser(lab: Lab) -> Iterator[httpx.Client]:
    url = f"http://127.0.0.1:{lab.stack.port}"
    with httpx.Client(base_url=url, timeout=20, verify=False) as client:  # noqa: S501
        yield client


def begin(browser: httpx.Client, back: str = "") -> str:
    """The address at the provider that the page sends the browser to."""
    headers = {**PAGE, "Origin": str(browser.base_url).rstrip("/")}
    answer = browser.post("/session/oidc", json={"back": back}, headers=headers)
    assert answer.status_code == 200, answer.text
    return answer.json()["location"]


def returned(location: str) -> str:
    """Where the provider sends the browser."""
    return httpx.get(location, verify=False).headers["Location"]  # noqa: S501


def sign_in(browser: httpx.Client, back: str = "") -> httpx.Response:
    return browser.get(returned(begin(browser, back)))


def refusal(answer: httpx.Response, status: int = 403) -> str:
    """The sentence on the page that says why nobody was signed in."""
    assert answer.status_code == status
    assert answer.headers["content-type"].startswith("text/html")
    assert "gaitway_session" not in answer.headers.get("set-cookie", "")
    before, _, after = answer.text.partition('<meta name="refusal" content="')
    assert before
    return after.partition('"')[0].replace("&#x27;", "'")


def nothing_changed(lab: Lab) -> bool:
    return {user.name for user in lab.stack.store.users()} == set(USERS)


def test_a_new_user_gets_the_role_and_the_project_of_the_settings(lab: Lab, browser: httpx.Client) -> None:
    assert browser.get("/session").json()["provider"] == "single sign-on"
    answer = sign_in(browser, "#/jobs?status=failed")
    assert (answer.status_code, answer.headers["Location"]) == (303, "/#/jobs?status=failed")
    assert "gaitway_sign_in" not in browser.cookies
    who = browser.get("/whoami").json()
    assert (who["user"], who["role"], who["projects"], who["token"]) == (
        "kim",
        "submitter",
        ["default"],
        None,
    )
    user = lab.stack.store.get_user("kim")
    assert user.subject == f"{lab.service.settings.oidc_issuer}#1234"
    entries = lab.stack.store.audit(user="kim").entries
    actions = ["session.begun", "project.members", "user.added"]
    assert [entry.action for entry in entries] == actions
    assert {entry.address for entry in entries} == {"127.0.0.1"}


def test_the_subject_stays_and_the_name_may_change(
    lab: Lab, browser: httpx.Client, provider: Provider
) -> None:
    sign_in(browser)
    provider.claims["preferred_username"] = "kim.new"
    sign_in(browser)
    assert browser.get("/whoami").json()["user"] == "kim"
    provider.claims |= {"sub": "5678", "preferred_username": "kim"}
    browser.cookies.clear()
    assert "not linked to this account" in refusal(sign_in(browser))


@pytest.mark.parametrize("name", ["root", "vic"])
def test_nobody_becomes_a_user_who_is_here_by_the_name_alone(
    lab: Lab, browser: httpx.Client, provider: Provider, name: str
) -> None:
    provider.claims["preferred_username"] = name
    subject = f"{provider.issuer}#1234"
    assert refusal(sign_in(browser)).endswith(f"gaitway users link {name} '{subject}'")
    assert browser.get("/session").json()["who"] is None
    assert lab.stack.store.get_user(name).subject is None


def test_a_user_whom_an_admin_links_keeps_role_and_projects(
    lab: Lab, browser: httpx.Client, provider: Provider
) -> None:
    root, subject = lab.of("root"), f"{provider.issuer}#1234"
    document = problem(
        root.patch("/users/vic", json={"subject": "https://evil.example#1"}), 422, "invalid-request"
    )
    assert pointers(document) == ["/subject"]
    assert root.patch("/users/vic", json={"subject": subject}).json()["subject"] == subject
    document = problem(root.patch("/users/ann", json={"subject": subject}), 409, "subject-taken")
    assert document["user"] == "vic"
    [entry] = lab.stack.store.audit(action="user.changed").entries
    assert (entry.user, entry.object, entry.details) == ("root", "user vic", {"subject": subject})
    sign_in(browser)
    who = browser.get("/whoami").json()
    assert (who["user"], who["role"], who["projects"]) == ("vic", "viewer", ["a"])
    session = browser.cookies["gaitway_session"].split("_")[1]
    root.patch("/users/vic", json={"subject": f"{provider.issuer}#5678"})  # It was the wrong person.
    assert lab.stack.store.find_session(session, timedelta(days=1)) is None


def expired(header: dict[str, Any], claims: dict[str, Any]) -> None:
    claims |= {"iat": claims["iat"] - 1000, "exp": int(time.time()) - 61}


def not_yet(header: dict[str, Any], claims: dict[str, Any]) -> None:
    claims["nbf"] = int(time.time()) + 600


def setting(name: str, value: Any) -> Callable[[dict[str, Any], dict[str, Any]], None]:
    def forge(header: dict[str, Any], claims: dict[str, Any]) -> None:
        claims[name] = value

    return forge


@pytest.mark.parametrize(
    "forge",
    [
        setting("iss", "https://evil.example"),
        setting("aud", "another"),
        setting("aud", [CLIENT, "another"]),
        setting("azp", "another"),
        setting("nonce", "of another sign-in"),
        setting("exp", "tomorrow"),
        setting("sub", ["1234"]),
        expired,
        not_yet,
    ],
)
def test_a_token_for_another_purpose_is_refused(
    lab: Lab, browser: httpx.Client, provider: Provider, forge: Any
) -> None:
    provider.forge = forge
    assert "token" in refusal(sign_in(browser))
    assert nothing_changed(lab)


@pytest.mark.parametrize(
    "how", ["none", "foreign key", "our secret", "the public key as a secret", "garbage"]
)
def test_a_token_that_the_provider_has_not_signed_is_refused(
    lab: Lab, browser: httpx.Client, provider: Provider, how: str
) -> None:
    def hmac_by(key: str) -> Callable[[dict[str, Any], dict[str, Any]], str]:
        return lambda header, claims: signed_by_hmac(header, claims, key)

    foreign = RSAKey.generate_key(2048)
    provider.sign = {
        "none": unsigned,
        "foreign key": lambda header, claims: jwt.encode(header, claims, foreign),
        "our secret": hmac_by(SECRET),
        "the public key as a secret": hmac_by(provider.key.as_pem(private=False).decode()),
        "garbage": lambda header, claims: "a.b.c",
    }[how]
    assert "token is not valid" in refusal(sign_in(browser))
    assert nothing_changed(lab)


def test_clocks_may_differ_a_little(lab: Lab, browser: httpx.Client, provider: Provider) -> None:
    provider.forge = setting("exp", int(time.time()) - 20)
    assert sign_in(browser).status_code == 303


def test_new_keys_are_asked_for(
    lab: Lab, browser: httpx.Client, provider: Provider, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert sign_in(browser).status_code == 303
    provider.key = RSAKey.generate_key(2048, auto_kid=True)
    assert "not valid" in refusal(sign_in(browser))  # Not more often than once a minute.
    monkeypatch.setattr(oidc, "_KEYS_AGAIN_S", 0.0)
    assert sign_in(browser).status_code == 303
    assert provider.asked.count("/.well-known/openid-configuration") == 1


def test_another_browser_or_a_second_time_is_refused(
    lab: Lab, browser: httpx.Client, provider: Provider
) -> None:
    answer = returned(begin(browser))
    with httpx.Client(verify=False) as another:  # noqa: S501
        assert "has not begun this sign-in" in refusal(another.get(answer))
    forged = answer.replace("state=", "state=x")
    assert "has not begun this sign-in" in refusal(browser.get(forged))
    assert "has not begun this sign-in" in refusal(browser.get(answer))  # That attempt was used up.
    answer = returned(begin(browser))
    assert browser.get(answer).status_code == 303
    assert "has not begun this sign-in" in refusal(browser.get(answer))


@pytest.mark.parametrize("back", ["/evil.example", "//evil.example", "https://evil.example", "#/\n"])
def test_a_forged_cookie_sends_nobody_elsewhere(back: str) -> None:
    attempt = oidc.Attempt(state="s", nonce="n", verifier="v", redirect_uri="https://lab/cb", back="#/jobs")
    assert oidc.Attempt.read(attempt.text) == attempt
    assert oidc.Attempt.read(attempt.model_copy(update={"back": back}).text) is None


def test_over_tls_only_this_host_sets_the_attempts_cookie(lab: Lab, browser: httpx.Client) -> None:
    headers = {**PAGE, "Origin": f"https://127.0.0.1:{lab.stack.port}"}
    cookie = browser.post("/session/oidc", json={}, headers=headers).headers["Set-Cookie"]
    assert cookie.startswith("__Host-gaitway_sign_in=")
    assert {"HttpOnly", "Secure", "Path=/"} <= set(cookie.split("; "))


def test_a_code_of_another_sign_in_is_refused(lab: Lab, browser: httpx.Client) -> None:
    first, second = returned(begin(browser)), returned(begin(browser))
    code = httpx.URL(first).params["code"]
    assert "invalid_grant" in refusal(browser.get(httpx.URL(second).copy_set_param("code", code)))
    assert nothing_changed(lab)


def test_a_provider_that_refuses_is_quoted(lab: Lab, browser: httpx.Client, provider: Provider) -> None:
    provider.refuses = "access_denied"
    assert "access_denied: the user said no" in refusal(sign_in(browser))


def test_an_answer_of_another_issuer_is_refused(lab: Lab, browser: httpx.Client) -> None:
    answer = returned(begin(browser)) + "&iss=https://evil.example"
    assert "no answer of the identity provider" in refusal(browser.get(answer))


def test_a_provider_that_is_away_is_said_to_be(lab: Lab, browser: httpx.Client, provider: Provider) -> None:
    location = begin(browser)
    answer = returned(location)
    provider.is_broken = True
    assert "status 500" in refusal(browser.get(answer), 503)
    lab.service.provider = oidc.IdentityProvider(lab.service.settings)
    for _ in range(2):
        answer = browser.post("/session/oidc", json={}, headers=PAGE)
        assert "status 500" in problem(answer, 503, "provider-away")["detail"]
    assert provider.asked.count("/.well-known/openid-configuration") == 2  # The second was told at once.


@with_settings(oidc_issuer="http://127.0.0.1:9")
def test_a_provider_that_nobody_reaches_is_named(lab: Lab, browser: httpx.Client) -> None:
    document = problem(browser.post("/session/oidc", json={}, headers=PAGE), 503, "provider-away")
    assert "127.0.0.1:9 does not answer" in document["detail"]


def test_another_sites_page_begins_no_sign_in(lab: Lab, browser: httpx.Client) -> None:
    answer = browser.post("/session/oidc", json={}, headers={"Origin": "https://evil.example"})
    problem(answer, 403, "cross-site-request")
    problem(browser.post("/session/oidc", json={}), 403, "cross-site-request")


@pytest.mark.parametrize(
    ("claims", "sentence"),
    [
        ({"email": "kim@evil.example"}, "evil.example may not sign in"),
        ({"email": "kim@notlab.edu"}, "notlab.edu may not sign in"),
        ({"email_verified": False}, "does not say a checked address"),
        ({"email_verified": None}, "does not say a checked address"),
        ({"email": None}, "does not say a checked address"),
        ({"hd": "other.org"}, "other.org may not sign in"),
        ({"preferred_username": None}, "GAITWAY_OIDC_USER_CLAIM"),
        ({"preferred_username": "Kim Lee"}, "cannot be a user's name"),
    ],
)
def test_who_may_not_sign_in_is_told_why(
    lab: Lab, browser: httpx.Client, provider: Provider, claims: dict[str, Any], sentence: str
) -> None:
    provider.claims |= claims
    assert sentence in refusal(sign_in(browser))
    assert nothing_changed(lab)


@with_settings(oidc_user_claim="email", oidc_domains="*")
def test_an_address_that_names_the_user_is_checked(
    lab: Lab, browser: httpx.Client, provider: Provider
) -> None:
    del provider.claims["email_verified"]
    assert "GAITWAY_OIDC_EMAILS_ARE_VERIFIED" in refusal(sign_in(browser))
    assert nothing_changed(lab)


@with_settings(oidc_emails_are_verified=True)
def test_a_provider_may_be_trusted_to_check_all_addresses(
    lab: Lab, browser: httpx.Client, provider: Provider
) -> None:
    provider.claims["email_verified"] = False  # It says the contrary.
    assert "does not say a checked address" in refusal(sign_in(browser))
    del provider.claims["email_verified"]
    assert sign_in(browser).status_code == 303


GROUPS = {
    "legs": GroupGrant(projects=frozenset({"a", "gaits"})),
    "boss": GroupGrant(role="admin"),
    "old": GroupGrant(role="viewer", projects=frozenset({"b"})),
}


@with_settings(oidc_groups=GROUPS, oidc_domains="")
def test_groups_give_role_and_projects_at_each_sign_in(
    lab: Lab, browser: httpx.Client, provider: Provider
) -> None:
    provider.claims["groups"] = ["strangers"]
    assert "none of the groups" in refusal(sign_in(browser))
    assert nothing_changed(lab)
    provider.claims["groups"] = ["/legs", "old"]
    sign_in(browser)
    user = lab.stack.store.get_user("kim")
    assert (user.role, user.projects) == (Role.SUBMITTER, ("a", "b", "default", "gaits"))
    lab.stack.store.add_project("own", NOBODY)
    lab.stack.store.change_members("own", NOBODY, add=["kim"])
    provider.claims["groups"] = ["boss"]
    sign_in(browser)
    user = lab.stack.store.get_user("kim")
    assert (user.role, user.projects) == (Role.ADMIN, ("default", "own"))  # No group gave `own`.
    left = lab.stack.store.audit(user="kim", object="project a").entries[0]
    assert left.details == {"removed": ["kim"], "by": "provider"}
    [made] = lab.stack.store.audit(user="kim", action="project.added").entries
    assert made.object == "project gaits"


@with_settings(oidc_groups=GROUPS)
def test_groups_do_not_take_the_last_admin(lab: Lab, browser: httpx.Client, provider: Provider) -> None:
    lab.stack.store.change_user("root", NOBODY, subject=f"{provider.issuer}#1234")
    provider.claims |= {"preferred_username": "root", "groups": ["legs"]}
    assert sign_in(browser).status_code == 303
    assert browser.get("/whoami").json()["role"] == "admin"


def test_a_disabled_user_stays_out_and_as_they_were(
    lab: Lab, browser: httpx.Client, provider: Provider
) -> None:
    lab.stack.store.change_user("ann", NOBODY, active=False, subject=f"{provider.issuer}#1234")
    assert "ann is disabled" in refusal(sign_in(browser))


def test_a_service_without_a_provider_says_so(stack: Stack) -> None:
    problem(stack.http.post("/session/oidc", json={}, headers=PAGE), 409, "no-provider")


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"oidc_domains": ""}, "GAITWAY_OIDC_DOMAINS"),
        ({"oidc_issuer": "http://id.lab.edu"}, "https://"),
        ({"oidc_client_id": None}, "GAITWAY_OIDC_CLIENT_ID"),
        ({"accounts": False}, "GAITWAY_ACCOUNTS"),
        ({"oidc_groups": "legs"}, "write it as JSON"),
        ({"oidc_groups": '{"legs": {"rank": 1}}'}, "rank"),
        ({"oidc_groups": '{"legs": {"projects": ["No!"]}}'}, "projects"),
    ],
)
def test_settings_that_let_in_the_wrong_people_are_refused(changes: dict[str, Any], sentence: str) -> None:
    whole: dict[str, Any] = {
        **NOWHERE.model_dump(
            include={"database_url", "redis_url", "s3_endpoint", "s3_access_key", "s3_secret_key"}
        ),
        "accounts": True,
        "oidc_issuer": "https://id.lab.edu",
        "oidc_client_id": "gaitway",
        "oidc_domains": "lab.edu",
    }
    ApiSettings.model_validate(whole)
    with pytest.raises(ValueError, match=sentence):
        ApiSettings.model_validate({**whole, **changes})
