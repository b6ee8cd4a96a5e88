"""Who may use which route: every route, with tokens of each role and scope."""

import re
from collections.abc import Iterator
from datetime import timedelta
from itertools import product

import pytest
from fastapi import APIRouter, FastAPI
from pydantic import SecretStr, ValidationError

from api import access, authentication
from api.access import names, undeclared
from api.app import interface
from api.main import check_exposure
from api.routes import ROUTERS
from core.accounts.principal import Role, TokenScope
from core.errors import Misconfigured
from core.settings import WorkerSettings
from tests.api.accounts import NOBODY, USERS, Lab, opened
from tests.api.conftest import Attempt, Stack, job
from tests.api.problems import problem

# What each route needs, said again: a GET reads and everything else submits, but for these.
OPEN = {"GET /", "GET /docs", "GET /pages/{version}/{path:path}", "GET /problems/{code}"}
OPEN |= {"GET /healthz", "GET /readyz", "GET /session", "POST /session", "DELETE /session"}
OPEN |= {"POST /session/oidc", "GET /session/oidc"}
FOR_ADMINS = {"GET /users", "POST /users", "PATCH /users/{name}", "GET /audit"}
FOR_ADMINS |= {"POST /projects", "PATCH /projects/{name}"}
FOR_ADMINS |= {"PUT /projects/{project}/retention", "DELETE /projects/{project}/retention"}
FOR_ADMINS |= {"PUT /quotas/{kind}/{name}", "DELETE /quotas/{kind}/{name}"}
FOR_WORKERS = "GET /workers/settings"
FOR_VIEWERS = {"POST /tokens", "DELETE /tokens/{token_id}", "POST /projects/{project}/retention/preview"}
ALL = sorted(name for router in ROUTERS for route in router.routes for name in names(route))
VALUES = {
    "{job_id}": "019aa3c2f0b1-5be0c1d2e3",
    "{sweep_id}": "019aa3c2f0b1-5be0c1d2e3",
    "{model_id}": f"sha256:{'0' * 64}",
    "{clips_id}": f"sha256:{'0' * 64}",
    "{token_id}": "0" * 12,
    "{environment_id:path}": "ant",
    "{path:path}": "app.js",
    "{environment_id}": "ant",
    "{kind}": "user",
    "{code}": "forbidden",
    "{step}": "1",
    "{delivery_id}": "1",
}


@pytest.fixture
def lab(server: tuple[FastAPI, int], stack: Stack) -> Iterator[Lab]:
    with opened(server[0], stack) as lab:
        yield lab


def needed(route: str) -> Role | None:
    if route in OPEN:
        return None
    if route in FOR_ADMINS:
        return Role.ADMIN
    return Role.VIEWER if route.startswith("GET") or route in FOR_VIEWERS else Role.SUBMITTER


def address(route: str) -> tuple[str, str]:
    method, _, path = route.partition(" ")
    for name, value in VALUES.items():
        path = path.replace(name, value)
    return method, path.replace("{name}", "ann")


def test_every_route_wants_a_token_but_the_open_ones(lab: Lab) -> None:
    for route in ALL:
        answer = lab.stack.http.request(*address(route))
        assert (answer.status_code == 401) == (needed(route) is not None), route


@pytest.mark.parametrize("user", ["root", "ann", "vic"])
def test_every_route_admits_who_has_role_and_scope(lab: Lab, user: str) -> None:
    role = USERS[user][0]
    for scope, route in product(TokenScope, ALL):
        wanted = needed(route)
        reached = [] if scope is TokenScope.WORKER else [*Role][: [*TokenScope].index(scope) + 1]
        may = wanted is None or (wanted in reached and role.rank >= wanted.rank)
        if route == FOR_WORKERS:
            may = scope is TokenScope.WORKER
        if route == "GET /metrics":  # Prometheus reads with an admin's token of any scope.
            may = bool(reached) and role is Role.ADMIN
        answer = lab.of(user, scope).request(*address(route))
        assert (answer.status_code != 403) == may, (route, user, scope, answer.text)
        assert answer.status_code != 401, route


def test_a_route_that_says_nothing_is_refused_at_start(monkeypatch: pytest.MonkeyPatch) -> None:
    router = APIRouter()
    router.get("/secrets")(lambda: None)
    assert undeclared([*ROUTERS, router]) == ["GET /secrets"]
    assert undeclared(ROUTERS) == []
    monkeypatch.setattr(access, "ROUTES", {**access.ROUTES, "GET /gone": access.Access()})
    with pytest.raises(Misconfigured, match="GET /gone"):
        interface()


def test_a_missing_scope_and_a_missing_role_are_named(lab: Lab) -> None:
    document = problem(lab.of("ann", TokenScope.READ).post("/jobs", json={}), 403, "forbidden")
    assert "a token of the scope submit; this one has the scope read" in document["detail"]
    document = problem(lab.of("vic").post("/jobs", json={}), 403, "forbidden")
    assert "the role submitter; vic is a viewer" in document["detail"]
    document = problem(lab.of("root", TokenScope.WORKER).get("/jobs"), 403, "forbidden")
    assert document["needed_scope"] == "read"


@pytest.mark.parametrize(
    ("header", "reason"),
    [
        ("Bearer hunter2", "malformed"),
        ("Basic YTpi", "malformed"),
        ("Bearer", "malformed"),
        (f"Bearer gaitway_{'0' * 12}_{'x' * 43}", "unknown"),
    ],
)
def test_a_token_that_is_none_of_ours_is_refused(lab: Lab, header: str, reason: str) -> None:
    with lab.with_header(header) as client:
        answer = client.get("/jobs")
    assert problem(answer, 401, "unauthenticated")["reason"] == reason
    assert answer.headers["WWW-Authenticate"] == 'Bearer realm="gaitway", error="invalid_token"'


def test_no_token_is_told_how_to_send_one(lab: Lab) -> None:
    answer = lab.stack.http.get("/jobs")
    document = problem(answer, 401, "unauthenticated")
    assert "gaitway login" in document["detail"]
    assert answer.headers["WWW-Authenticate"] == 'Bearer realm="gaitway"'


def test_half_a_right_token_is_an_unknown_one(lab: Lab) -> None:
    secret = lab.token("ann")
    wrong = secret.text[:-2] + ("aa" if secret.text[-2:] != "aa" else "bb")
    with lab.with_token(wrong) as client:
        assert problem(client.get("/jobs"), 401, "unauthenticated")["reason"] == "unknown"


def test_what_was_taken_away_works_no_more_once_the_cache_is_old(
    lab: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = lab.stack.store
    client, secret = lab.of("ann"), lab.token("ann")
    with lab.with_token(secret.text) as revoked:
        assert revoked.get("/jobs").status_code == 200
        store.revoke_token(secret.id, NOBODY)
        assert revoked.get("/jobs").status_code == 200  # For two seconds at most.
        monkeypatch.setattr(authentication, "CACHED_S", 0.0)
        lab.service.authenticator = authentication.Authenticator(lab.service.store, 200, timedelta(days=1))
        assert problem(revoked.get("/jobs"), 401, "unauthenticated")["reason"] == "revoked"
    store.change_user("ann", NOBODY, role=Role.VIEWER)
    problem(client.post("/jobs", json={}), 403, "forbidden")
    store.change_user("ann", NOBODY, active=False)
    assert problem(client.get("/jobs"), 401, "unauthenticated")["reason"] == "disabled"


def test_the_record_is_asked_for_a_token_once_in_two_seconds(
    lab: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[str] = []
    find = lab.stack.store.find_token
    monkeypatch.setattr(lab.stack.store, "find_token", lambda one: asked.append(one) or find(one))
    moment = [100.0]
    monkeypatch.setattr(authentication, "monotonic", lambda: moment[0])
    for _ in range(5):
        lab.of("ann").get("/whoami")
    assert len(asked) == 1
    moment[0] += authentication.CACHED_S
    lab.of("ann").get("/whoami")
    assert len(asked) == 2


def test_a_token_that_asks_too_often_waits(lab: Lab, monkeypatch: pytest.MonkeyPatch) -> None:
    lab.service.authenticator = authentication.Authenticator(lab.service.store, 0.5, timedelta(days=1))
    moment = [100.0]
    monkeypatch.setattr(authentication, "monotonic", lambda: moment[0])
    client = lab.of("ann")
    assert [client.get("/whoami").status_code for _ in range(6)] == [200] * 5 + [429]
    answer = client.get("/whoami")
    problem(answer, 429, "too-many-requests")
    assert lab.of("ann", TokenScope.READ).get("/whoami").status_code == 429  # Another one does not help.
    assert lab.of("bob").get("/whoami").status_code == 200
    moment[0] += int(answer.headers["Retry-After"])
    assert client.get("/whoami").status_code == 200


def _counted(lab: Lab, route: str, status: int) -> float:
    """How many requests of this route have ended so, in all tests of this process."""
    numbers = re.findall(
        rf'^gaitway_http_requests_total.*route="{route}",status="{status}"}} (\S+)$',
        lab.of("root").get("/metrics").text,
        re.MULTILINE,
    )
    return sum(map(float, numbers))


def test_an_address_that_guesses_tokens_waits_and_shuts_out_none_that_was_known(
    lab: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    counted = _counted(lab, "/whoami", 401)
    asked: list[str] = []
    find = lab.stack.store.find_token
    monkeypatch.setattr(lab.stack.store, "find_token", lambda one: asked.append(one) or find(one))
    monkeypatch.setattr(authentication, "_GUESSES_PER_SECOND", 0.3)
    lab.service.authenticator = authentication.Authenticator(lab.service.store, 200, timedelta(days=1))
    moment = [100.0]
    monkeypatch.setattr(authentication, "monotonic", lambda: moment[0])
    assert lab.of("ann").get("/whoami").status_code == 200
    with lab.with_token(f"gaitway_{'0' * 12}_{'x' * 43}") as guessing:
        assert [guessing.get("/whoami").status_code for _ in range(3)] == [401] * 3
        document = problem(guessing.get("/whoami"), 429, "too-many-requests")
    assert "from this address" in document["detail"]
    assert len(asked) == 4
    moment[0] += authentication.CACHED_S
    assert lab.of("ann").get("/whoami").status_code == 200
    moment[0] += 10
    assert lab.of("bob").get("/whoami").status_code == 200
    assert _counted(lab, "/whoami", 401) == counted + 3


def test_an_expired_token_says_when(lab: Lab) -> None:
    secret = lab.token("ann", lives=timedelta(seconds=-1))
    with lab.with_token(secret.text) as client:
        document = problem(client.get("/jobs"), 401, "unauthenticated")
    assert document["reason"] == "expired"
    assert "UTC" in document["detail"]


def test_a_worker_gets_the_stores_as_it_reaches_them_and_nothing_of_this_machine(lab: Lab) -> None:
    worker = lab.of("root", TokenScope.WORKER)
    document = problem(worker.get("/workers/settings"), 409, "stores-out-of-reach")
    assert "GAITWAY_WORKER_DATABASE_URL" in document["detail"]
    named = {
        "worker_database_url": SecretStr("postgresql://worker:word@db.lab/gaitway"),
        "worker_redis_url": SecretStr("rediss://:word@redis.lab/0"),
    }
    lab.service.settings = lab.service.settings.model_copy(update=named)
    lab.service.settings = lab.service.settings.model_copy(update={"s3_endpoint": "127.0.0.1:9000"})
    document = problem(worker.get("/workers/settings"), 409, "stores-out-of-reach")
    assert "127.0.0.1" in document["detail"]
    assert "GAITWAY_WORKER_S3_ENDPOINT" in document["detail"]
    lab.service.settings = lab.service.settings.model_copy(update={"worker_s3_endpoint": "s3.lab:9000"})
    variables = worker.get("/workers/settings").json()["variables"]
    assert variables["GAITWAY_DATABASE_URL"] == "postgresql://worker:word@db.lab/gaitway"
    assert variables["GAITWAY_S3_ENDPOINT"] == "s3.lab:9000"
    assert variables["GAITWAY_S3_ACCESS_KEY"] == lab.service.settings.s3_access_key
    key = {"worker_s3_access_key": "worker", "worker_s3_secret_key": SecretStr("their own")}
    lab.service.settings = lab.service.settings.model_copy(update=key)
    variables = worker.get("/workers/settings").json()["variables"]
    assert variables["GAITWAY_S3_ACCESS_KEY"] == "worker"
    assert variables["GAITWAY_S3_SECRET_KEY"] == "their own"
    lab.service.audit_log.flush()
    joined = lab.stack.store.audit(action="worker.").entries  # Not those that were refused.
    assert [(one.user, one.action) for one in joined] == [("root", "worker.joined")] * 2
    with pytest.raises(ValidationError):  # They are settings of a worker, but for its folder.
        WorkerSettings.model_validate(
            {name.removeprefix("GAITWAY_").lower(): value for name, value in variables.items()}
        )


def test_nobody_gets_the_stores_of_a_service_without_accounts(stack: Stack) -> None:
    problem(stack.http.get("/workers/settings"), 409, "accounts-off")


def test_a_stream_ends_when_its_token_is_revoked(lab: Lab, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(authentication, "CACHED_S", 0.0)
    attempt = Attempt(lab.stack, lab.stack.store.add(job().model_copy(update={"project": "a"})), is_new=False)
    secret = lab.token("ann")
    with lab.with_token(secret.text) as client, client.stream("GET", f"/jobs/{attempt.id}/events") as stream:
        pieces = stream.iter_text()
        assert "retry" in next(pieces)
        lab.stack.store.revoke_token(secret.id, NOBODY)
        attempt.say("note", text="for members alone")
        assert "for members alone" not in "".join(pieces)  # It ends, although the job runs.


@pytest.mark.parametrize("address", ["127.0.0.1", "::1", "localhost", "127.0.0.2"])
def test_without_accounts_it_listens_on_this_machine(address: str) -> None:
    check_exposure(address, has_accounts=False)


@pytest.mark.parametrize("address", ["0.0.0.0", "::", "10.0.0.5", "gaitway.lab"])  # noqa: S104
def test_beyond_this_machine_it_needs_accounts(address: str) -> None:
    with pytest.raises(Misconfigured, match=r"GAITWAY_ACCOUNTS=true.*ssh -L"):
        check_exposure(address, has_accounts=False)
    check_exposure(address, has_accounts=True)


def test_usage_names_the_projects_that_one_sees(lab: Lab) -> None:
    for number, user in enumerate(("ann", "bob")):
        queued = job(f"{number:012x}-0000000000").model_copy(
            update={"owner": user, "project": USERS[user][1][0]}
        )
        Attempt(lab.stack, queued).end()
    seen = {who: lab.of(who).get("/usage").json()["projects"] for who in ("ann", "two", "root")}
    assert [(used["project"], used["owner"]) for used in seen["ann"]] == [("a", "ann")]
    assert (
        {used["project"] for used in seen["two"]} == {"a", "b"} == {used["project"] for used in seen["root"]}
    )
