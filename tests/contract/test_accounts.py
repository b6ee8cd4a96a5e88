"""Users, projects, tokens and the audit log; whose jobs, sweeps and models are."""

import threading
from concurrent.futures import ThreadPoolExecutor
from datetime import timedelta
from itertools import product

import psycopg
import pytest

from core.accounts.principal import Ownership, Role, TokenScope
from core.accounts.provider import Grant
from core.accounts.store import Actor, AuditEntry, PageSession, Token, User
from core.accounts.tokens import MAX_TOKENS, SESSION, TOKEN, Secret, new_secret, parse
from core.adapters.postgres import listing
from core.adapters.postgres.store import PostgresJobStore
from core.errors import (
    JobNotFound,
    LastAdmin,
    ModelNotFound,
    ProjectExists,
    ProjectNotFound,
    Rejected,
    TokenNotFound,
    TooManyTokens,
    UserExists,
    UserNotFound,
)
from core.jobs.job import Job
from core.jobs.store import Idempotency, JobQuery, Whose
from tests.contract.recording import NOW, Database, model, queued_job
from tests.unit.sweeps.making import sweep_of

ADMIN = Actor("root", "0123456789ab", "10.0.0.7", "c0ffee")


def user(name: str, role: Role = Role.SUBMITTER, *projects: str) -> User:
    return User(name=name, role=role, projects=projects, created_at=NOW)


def add_token(store: PostgresJobStore, name: str, scope: TokenScope = TokenScope.READ) -> Secret:
    secret = new_secret()
    store.add_token(Token(id=secret.id, user=name, name="", scope=scope, created_at=NOW), secret, ADMIN)
    return secret


def owned(number: int, owner: str | None, project: str) -> Job:
    return queued_job(number).model_copy(update={"owner": owner, "project": project})


def test_a_token_is_found_by_its_id_with_its_user_and_only_its_hash_is_stored(
    job_store: PostgresJobStore, database_url: str
) -> None:
    job_store.add_project("gaits", ADMIN)
    job_store.add_user(user("ann", Role.SUBMITTER, "default", "gaits"), ADMIN)
    secret = add_token(job_store, "ann", TokenScope.SUBMIT)
    known = job_store.find_token(secret.id)
    assert known is not None
    assert secret.matches(known.sha256)
    assert not new_secret().matches(known.sha256)
    principal = known.principal
    assert (principal.user, principal.acts_as) == ("ann", Role.SUBMITTER)
    assert principal.projects == {"default", "gaits"}
    assert parse(secret.text) is not None
    assert parse(secret.text[:-1]) is None
    with psycopg.connect(database_url) as connection:
        stored = str(connection.execute("SELECT * FROM tokens").fetchall())
    assert secret.text.removeprefix(f"{TOKEN}_{secret.id}_") not in stored
    assert job_store.find_token("0" * 12) is None


def test_a_tokens_use_is_noted_once_a_minute(job_store: PostgresJobStore, database: Database) -> None:
    job_store.add_user(user("ann"), ADMIN)
    secret = add_token(job_store, "ann")

    def last_use() -> object:
        job_store.find_token(secret.id)
        return job_store.tokens("ann")[0].last_used_at

    first = last_use()
    assert first is not None
    assert last_use() == first
    database.change("UPDATE tokens SET last_used_at = clock_timestamp() - interval '61 seconds'")
    assert last_use() != first


def test_a_revoked_token_says_since_when_and_only_its_user_revokes_it(job_store: PostgresJobStore) -> None:
    job_store.add_user(user("ann"), ADMIN)
    job_store.add_user(user("bob"), ADMIN)
    secret = add_token(job_store, "ann")
    with pytest.raises(TokenNotFound):
        job_store.revoke_token(secret.id, ADMIN, user="bob")
    revoked = job_store.revoke_token(secret.id, ADMIN, user="ann")
    assert revoked.revoked_at is not None
    assert job_store.revoke_token(secret.id, ADMIN).revoked_at == revoked.revoked_at


def test_a_user_has_so_many_tokens_that_are_valid(job_store: PostgresJobStore) -> None:
    job_store.add_user(user("ann"), ADMIN)
    job_store.add_user(user("bob"), ADMIN)
    first, *_ = [add_token(job_store, "ann") for _ in range(MAX_TOKENS)]
    with pytest.raises(TooManyTokens, match="ann has 100 tokens"):
        add_token(job_store, "ann")
    add_token(job_store, "bob")
    job_store.revoke_token(first.id, ADMIN)
    add_token(job_store, "ann")


def test_names_that_exist_and_names_that_do_not_are_refused(job_store: PostgresJobStore) -> None:
    job_store.add_user(user("ann"), ADMIN)
    with pytest.raises(UserExists):
        job_store.add_user(user("ann"), ADMIN)
    with pytest.raises(ProjectNotFound):
        job_store.add_user(user("bob", Role.VIEWER, "nowhere"), ADMIN)
    assert [one.name for one in job_store.users()] == ["ann"]  # All or nothing.
    with pytest.raises(ProjectExists):
        job_store.add_project("default", ADMIN)
    with pytest.raises(ProjectNotFound):
        job_store.change_members("nowhere", ADMIN, add=["ann"])
    with pytest.raises(UserNotFound):
        job_store.change_members("default", ADMIN, add=["ann", "cat"])
    assert [one.members for one in job_store.projects()] == [()]
    with pytest.raises(UserNotFound):
        add_token(job_store, "cat")


def test_two_admins_who_disable_each_other_leave_one(job_store: PostgresJobStore) -> None:
    for name in ("ann", "bob"):
        job_store.add_user(user(name, Role.ADMIN), ADMIN)
    together = threading.Barrier(2)

    def disable(name: str) -> bool:
        together.wait()
        try:
            job_store.change_user(name, ADMIN, active=False)
        except LastAdmin:
            return False
        return True

    with ThreadPoolExecutor(2) as pool:
        assert sorted(pool.map(disable, ["ann", "bob"])) == [False, True]
    [left] = [one.name for one in job_store.users() if one.active]
    with pytest.raises(LastAdmin):
        job_store.change_user(left, ADMIN, role=Role.VIEWER)


def test_sign_ins_that_take_the_role_from_all_admins_leave_one(job_store: PostgresJobStore) -> None:
    names, barrier = [f"admin{number}" for number in range(4)], threading.Barrier(4)
    for name in names:
        job_store.add_user(user(name, Role.ADMIN), ADMIN)
        job_store.change_user(name, ADMIN, subject=f"https://id#{name}")

    def admit(name: str) -> Role:
        grant = Grant(name, f"https://id#{name}", Role.VIEWER, frozenset({"default"}), is_kept=True)
        barrier.wait()
        return job_store.admit(grant, Actor(name)).role

    with ThreadPoolExecutor(4) as threads:
        roles = sorted(threads.map(admit, names))
    assert roles == [Role.ADMIN, Role.VIEWER, Role.VIEWER, Role.VIEWER]


def test_the_audit_log_has_who_what_and_where_and_cannot_be_changed(
    job_store: PostgresJobStore, database: Database
) -> None:
    job_store.add_user(user("ann"), ADMIN)
    secret = add_token(job_store, "ann")
    job_store.note(
        [AuditEntry(at=NOW, user="ann", action="job.submitted", object="job 1", details={"a": "\0"})]
    )
    newest, token, first = job_store.audit().entries
    assert (first.user, first.token, first.address, first.correlation_id) == tuple(vars(ADMIN).values())
    assert (first.action, first.object) == ("user.added", "user ann")
    assert (token.action, token.details["user"]) == ("token.created", "ann")
    assert secret.text not in token.model_dump_json()
    assert (newest.at, newest.details) == (NOW, {"a": "\N{REPLACEMENT CHARACTER}"})
    assert [one.action for one in job_store.audit(user="ann").entries] == ["job.submitted"]
    assert [one.action for one in job_store.audit(action="token.").entries] == ["token.created"]
    assert [one.action for one in job_store.audit(object="job 1").entries] == ["job.submitted"]
    for statement in ("UPDATE audit SET user_name = 'bob'", "DELETE FROM audit", "TRUNCATE audit"):
        with pytest.raises(psycopg.errors.RaiseException, match="append-only"):
            database.change(statement)


def test_the_audit_log_comes_page_by_page(job_store: PostgresJobStore) -> None:
    job_store.note([AuditEntry(at=NOW, action=f"a{number}") for number in range(5)])
    first = job_store.audit(limit=3)
    rest = job_store.audit(limit=3, cursor=first.next_cursor)
    assert [one.action for one in [*first.entries, *rest.entries]] == ["a4", "a3", "a2", "a1", "a0"]
    assert rest.next_cursor is None
    with pytest.raises(Rejected):
        job_store.audit(cursor="x")


def test_a_job_and_a_sweep_keep_their_owner_and_project(job_store: PostgresJobStore) -> None:
    job = job_store.add(owned(1, "ann", "gaits"))
    assert job_store.owner_of(job.id) == job_store.get(job.id).ownership == Ownership("ann", "gaits")
    sweep = job_store.add_sweep(sweep_of().model_copy(update={"owner": "ann", "project": "gaits"}))
    assert job_store.owner_of_sweep(sweep.id) == job_store.get_sweep(sweep.id).ownership
    job_store.save_sweep(job_store.get_sweep(sweep.id).next(message="m"))
    assert job_store.get_sweep(sweep.id).owner == "ann"
    with pytest.raises(JobNotFound):
        job_store.owner_of("000000000000-0000000000")


def test_two_users_may_have_the_same_idempotency_key(job_store: PostgresJobStore) -> None:
    jobs = {name: queued_job(number) for number, name in enumerate(("ann", "bob", None))}
    for name, job in jobs.items():
        assert job_store.add(job, Idempotency("k", f"body of {name}", name)).id == job.id
    found = job_store.remembered(Idempotency("k", "body of bob", "bob"))
    assert found is not None
    assert found.id == jobs["bob"].id


def listed(store: PostgresJobStore, query: JobQuery, limit: int) -> list[str]:
    """The ids of all pages, each of which has `limit` but the last."""
    found, cursor = list[str](), None
    while True:
        page = store.list(query, cursor=cursor, limit=limit)
        found += [job.id for job in page.jobs]
        cursor = page.next_cursor
        if cursor is None:
            return found
        assert len(page.jobs) == limit


@pytest.mark.parametrize("near", [20_000, 2])
@pytest.mark.parametrize("limit", [1, 2, 3, 4, 5, 50])
def test_ones_own_jobs_come_first_and_pages_lose_and_repeat_none(
    job_store: PostgresJobStore, monkeypatch: pytest.MonkeyPatch, limit: int, near: int
) -> None:
    monkeypatch.setattr(listing, "_NEAR", near)
    jobs = [
        job_store.add(owned(number, owner, project))
        for number, (owner, project) in enumerate(
            [("ann", "a"), ("bob", "a"), ("ann", "b"), (None, "a"), ("bob", "c"), ("ann", "a"), ("cat", "b")]
        )
    ]

    def expected(*numbers: int) -> list[str]:
        return [jobs[number].id for number in numbers]

    def ask(*, kind: str | None = None, **filters: object) -> list[str]:
        whose = Whose.model_validate(filters)
        return listed(job_store, JobQuery.model_validate({"whose": whose, "kind": kind}), limit)

    for kind in (None, "train"):
        assert ask(kind=kind, projects=("a", "b"), first="ann") == expected(5, 2, 0, 6, 3, 1)
        assert ask(kind=kind, projects=("a", "b"), first="bob") == expected(1, 6, 5, 3, 2, 0)
        assert ask(kind=kind, projects=("a", "b"), first="dan") == expected(6, 5, 3, 2, 1, 0)
        assert ask(kind=kind, projects=("a",), first="ann", owner="bob") == expected(1)
        assert ask(kind=kind, first="cat") == expected(6, 5, 4, 3, 2, 1, 0)  # An admin sees all.
        assert ask(kind=kind, projects=(), first="ann") == []
        assert ask(kind=kind) == expected(6, 5, 4, 3, 2, 1, 0)


def test_a_cursor_that_no_listing_gave_is_refused(job_store: PostgresJobStore) -> None:
    for cursor, first in product(("others-x", "other", "-", "others-", ""), ("ann", None)):
        with pytest.raises(Rejected):
            job_store.list(JobQuery(whose=Whose(first=first)), cursor=cursor)


def test_a_listing_continues_when_accounts_are_turned_off(job_store: PostgresJobStore) -> None:
    for number in range(3):
        job_store.add(queued_job(number))
    whole = job_store.list(JobQuery()).jobs
    first = job_store.list(JobQuery(whose=Whose(first="ann")), limit=1)
    rest = job_store.list(JobQuery(), cursor=first.next_cursor)
    assert [*first.jobs, *rest.jobs] == whole


def test_sweeps_come_as_jobs_do(job_store: PostgresJobStore) -> None:
    for number, (owner, project) in enumerate([("ann", "a"), ("bob", "a"), ("bob", "b")]):
        sweep = sweep_of().model_copy(
            update={"id": f"{number:012x}-0000000000", "owner": owner, "project": project}
        )
        job_store.add_sweep(sweep)
    first = job_store.list_sweeps(whose=Whose(projects=("a",), first="ann"), limit=1)
    rest = job_store.list_sweeps(whose=Whose(projects=("a",), first="ann"), limit=1, cursor=first.next_cursor)
    assert [one.owner for one in [*first.sweeps, *rest.sweeps]] == ["ann", "bob"]
    assert (first.next_cursor, rest.next_cursor) == ("others", None)


def test_a_model_is_in_each_project_to_which_it_was_sent(job_store: PostgresJobStore) -> None:
    record = model()
    job_store.models.add(record)
    job_store.models.claim(record.id, Ownership("ann", "a"))
    job_store.models.claim(record.id, Ownership("bob", "b"))
    job_store.models.claim(record.id, Ownership("cat", "b"))  # Who came first owns it there.
    assert job_store.models.owners_of([record.id]) == {
        record.id: [Ownership("ann", "a"), Ownership("bob", "b")]
    }
    assert [one.id for one in job_store.models.list(projects=("b",)).uploads] == [record.id]
    assert job_store.models.list(projects=("c",)).uploads == []
    assert job_store.models.list(projects=("b",), owner="ann").uploads == []
    assert not job_store.models.release(record.id, ["a"])
    assert job_store.models.release(record.id, ["b"])
    with pytest.raises(ModelNotFound):
        job_store.models.release(record.id, ["b"])
    with pytest.raises(ModelNotFound):
        job_store.models.claim(record.id, Ownership("ann", "a"))


def test_a_listing_of_ones_projects_reads_few_rows_of_many(
    job_store: PostgresJobStore, database: Database
) -> None:
    """At a million jobs, sorting all of one's projects took most of a second."""
    job_store.add(owned(1, "ann", "a"))
    database.change(
        "INSERT INTO jobs (id, owner, project, version, kind, environment, labels, spec, status, created_at) "
        "SELECT lpad(to_hex(1000000 + n), 12, '0') || '-0000000000', 'user' || n %% 50, "
        "CASE WHEN n < 15000 THEN 'a' ELSE 'p' || n %% 9 END, "
        "version, kind, environment, labels, spec, status, created_at "
        "FROM jobs, generate_series(1, 30000) AS n"
    )
    database.change("ANALYZE jobs")
    began = job_store.now()
    page = job_store.list(JobQuery(whose=Whose(projects=("a", "p3"), first="ann")), limit=50)
    assert job_store.now() - began < timedelta(seconds=1)
    assert [job.owner for job in page.jobs[:1]] == ["ann"]
    assert len(page.jobs) == 50


def test_a_session_is_found_until_it_expires_and_while_it_is_used(job_store: PostgresJobStore) -> None:
    job_store.add_user(user("ann", Role.SUBMITTER, "default"), ADMIN)
    now, day = job_store.now(), timedelta(days=1)
    token = add_token(job_store, "ann")

    def begin(lives: timedelta, *, token_id: str | None = None) -> Secret:
        secret = new_secret(SESSION)
        session = PageSession(
            id=secret.id,
            user="ann",
            scope=TokenScope.READ,
            token=token_id,
            created_at=now,
            expires_at=now + lives,
        )
        job_store.add_session(session, secret, ADMIN)
        return secret

    old, kept, of_token = begin(-day), begin(day), begin(day, token_id=token.id)
    assert job_store.find_session(old.id, day) is None
    known = job_store.find_session(kept.id, day)
    assert known is not None
    assert kept.matches(known.sha256)
    assert (known.principal.user, known.principal.acts_as) == ("ann", Role.VIEWER)
    assert job_store.find_session(kept.id, timedelta(0)) is None  # Not used for that long.
    job_store.revoke_token(token.id, ADMIN)
    assert job_store.find_session(of_token.id, day) is None
    late = begin(day, token_id=token.id)  # Its sign-in had checked the token just before.
    assert job_store.find_session(late.id, day) is None
    job_store.end_session(kept.id, ADMIN)
    job_store.end_session(kept.id, ADMIN)
    assert job_store.find_session(kept.id, day) is None
