"""Signing in on the page, and the account's view: tokens, users, projects, the audit log."""

import re
from collections.abc import Iterator
from datetime import timedelta

import pytest
from fastapi import FastAPI
from playwright.sync_api import Page, expect

from api import authentication
from core.accounts.principal import TokenScope
from core.jobs.turns import Quota
from tests.api.accounts import NOBODY, Lab, opened
from tests.api.conftest import Attempt, Stack, job
from tests.api.identity_provider import provided
from tests.api.pages.conftest import MakeTab, Tab, flaws
from tests.api.test_oidc import KIM, rules

_FETCH = """(url) => fetch(url, {
  method: "POST",
  credentials: "include",
  body: "{}",
  headers: {"Content-Type": "application/json", "X-Gaitway-Page": "1"},
}).then(() => "sent", () => "refused")"""


@pytest.fixture
def lab(server: tuple[FastAPI, int], stack: Stack, monkeypatch: pytest.MonkeyPatch) -> Iterator[Lab]:
    """The record is asked at each request."""
    monkeypatch.setattr(authentication, "CACHED_S", 0.0)
    with opened(server[0], stack) as lab:
        yield lab


def sign_in(tab: Tab, token: str, address: str = "") -> Page:
    page = tab.open(address)
    page.get_by_label("Token").fill(token)
    page.get_by_role("button", name="Sign in", exact=True).click()
    expect(page.locator("a.who")).to_be_visible()
    return page


def owned(stack: Stack, number: int, owner: str, project: str) -> Attempt:
    made = job(f"{number:012x}-0000000000", name=f"of {owner} in {project}")
    stack.store.add(made.model_copy(update={"owner": owner, "project": project}))
    return Attempt(stack, made, is_new=False)


def test_a_token_signs_in_once_and_what_was_asked_for_is_shown(lab: Lab, tab: Tab) -> None:
    attempt = owned(lab.stack, 1, "ann", "a")
    attempt.keep("video.mp4")
    page = tab.open(f"#/jobs/{attempt.id}")
    expect(page.get_by_role("heading", name="Sign in")).to_be_visible()
    expect(page.get_by_role("link", name="Workers")).to_have_count(0)
    assert flaws(page) == []
    page.get_by_label("Token").fill("hunter2")
    page.keyboard.press("Enter")
    expect(page.get_by_role("alert")).to_contain_text("begins with gaitway_")
    expect(page.get_by_label("Token")).to_be_focused()
    tab.picture("sign-in")
    page.get_by_label("Token").fill(lab.token("ann").text)
    page.keyboard.press("Enter")
    expect(page.get_by_role("heading", name="of ann in a")).to_be_visible()
    expect(page.get_by_text("ann · a ·")).to_be_visible()
    attempt.say("progress", step=500, total=1000)  # The stream has the cookie, and so have files.
    expect(page.get_by_text("500 of 1K steps")).to_be_visible()
    assert page.request.get(f"{tab.url}/jobs/{attempt.id}/video").status == 200
    page.reload()
    expect(page.get_by_role("heading", name="of ann in a")).to_be_visible()
    page.get_by_role("link", name="ann", exact=True).click()
    page.get_by_role("button", name="Sign out").click()
    expect(page.get_by_role("heading", name="Sign in")).to_be_visible()
    assert page.request.get(f"{tab.url}/jobs/{attempt.id}/video").status == 401
    assert page.context.cookies() == []


def test_a_session_that_ends_elsewhere_leads_to_the_sign_in(lab: Lab, tab: Tab) -> None:
    secret = lab.token("ann")
    page = sign_in(tab, secret.text)
    expect(page.get_by_text("No jobs yet.")).to_be_visible()
    lab.stack.store.revoke_token(secret.id, NOBODY)
    expect(page.get_by_role("heading", name="Sign in")).to_be_visible()  # The list asks every 5 s.


def test_another_sites_form_and_script_change_nothing(lab: Lab, make_tab: MakeTab, server: object) -> None:
    ours = make_tab()
    page = sign_in(ours, lab.token("ann").text)
    port = lab.stack.port
    form = (
        f'<form method="post" action="http://127.0.0.1:{port}/jobs" enctype="text/plain">'
        """<input name='{"kind": "train", "environment": "ant", "x' value='": 1}'></form>"""
    )
    # Of another site, and of the same host at another port, to which browsers send the cookie, too.
    for site in ("http://evil.localhost:9", "http://127.0.0.1:9"):
        page.route(f"{site}/**", lambda route: route.fulfill(body=form, content_type="text/html"))
        page.goto(f"{site}/")
        with page.expect_response(f"http://127.0.0.1:{port}/jobs") as answered:
            page.evaluate("document.forms[0].submit()")
        assert answered.value.status == 403
        assert "cross-site-request" in answered.value.text()
        page.goto(f"{site}/")
        sent = page.evaluate(_FETCH, f"http://127.0.0.1:{port}/jobs")
        assert sent == "refused"
    ours.complaints.clear()  # Chromium tells that it refused.
    assert lab.stack.is_empty()


def test_a_token_is_made_shown_once_and_revoked(lab: Lab, tab: Tab) -> None:
    page = sign_in(tab, lab.token("ann").text, "#/account")
    expect(page.get_by_role("heading", name="ann")).to_be_visible()
    expect(page.get_by_role("navigation", name="Parts of the account")).to_have_count(0)
    page.get_by_label("Name").fill("notebook")
    page.get_by_label("Scope").select_option(label="read: looks, for notebooks and dashboards")
    page.get_by_role("button", name="Make it").click()
    secret = page.get_by_role("region", name="The token").inner_text()
    expect(page.get_by_role("button", name="Copy: The token")).to_be_visible()
    with lab.with_token(secret) as client:
        assert client.get("/whoami").json()["scope"] == "read"
    row = page.get_by_role("row").filter(has_text="notebook")
    expect(row).to_contain_text("read")
    assert flaws(page) == []
    tab.picture("account-tokens")
    row.get_by_role("button", name="Revoke").click()
    row.get_by_role("button", name="Yes, revoke").click()
    expect(row).to_contain_text("revoked")
    with lab.with_token(secret) as client:
        assert client.get("/whoami").status_code == 401
    page.reload()
    expect(page.get_by_role("row").filter(has_text="notebook")).to_be_visible()
    assert secret not in page.content()


def test_an_admin_keeps_users_and_projects_and_reads_what_was_done(lab: Lab, tab: Tab) -> None:
    page = sign_in(tab, lab.token("root").text, "#/account/users")
    form = page.get_by_role("form", name="Add a user")
    form.get_by_label("Name").fill("Zoe!")
    form.get_by_role("button", name="Add").click()
    expect(form.get_by_role("alert")).to_be_visible()
    form.get_by_label("Name").fill("zoe")
    form.get_by_label("Role").select_option("viewer")
    form.get_by_role("checkbox", name="a", exact=True).check()
    form.get_by_role("button", name="Add").click()
    row = page.get_by_role("row").filter(has_text="zoe")
    expect(row).to_contain_text("a, default")
    row.get_by_label("Role of zoe").select_option("submitter")
    row.get_by_role("button", name="Disable").click()
    row.get_by_role("button", name="Yes, disable").click()
    expect(row.get_by_role("button", name="Enable")).to_be_visible()
    zoe = lab.stack.store.get_user("zoe")
    assert (zoe.role, zoe.active, zoe.projects) == ("submitter", False, ("a", "default"))
    assert flaws(page) == []
    tab.picture("account-users")
    row.get_by_role("button", name="Enable").click()
    row.get_by_role("link", name="Tokens").click()
    expect(page.get_by_text("Tokens of zoe")).to_be_visible()

    page.get_by_role("link", name="Projects", exact=True).click()
    form = page.get_by_role("form", name="Add a project")
    form.get_by_label("Name").fill("gaits")
    form.get_by_role("button", name="Add").click()
    card = page.locator("section").filter(has=page.get_by_role("heading", name="gaits"))
    card.get_by_label("Add a member").select_option("zoe")
    expect(card.get_by_role("button", name="Remove zoe from gaits")).to_be_visible()
    assert flaws(page) == []
    tab.picture("account-projects")
    card.get_by_role("button", name="Remove zoe from gaits").click()
    expect(card.get_by_text("No members")).to_be_visible()

    for number in range(60):
        lab.stack.store.add_project(f"p{number}", NOBODY)
    page.get_by_role("link", name="Audit log").click()
    expect(page.get_by_role("row").filter(has_text="project p59")).to_be_visible()
    page.get_by_role("link", name="Older entries").click()
    expect(page.get_by_role("row").filter(has_text="user zoe").first).to_contain_text("127.0.0.1")
    assert flaws(page) == []
    tab.picture("account-audit")
    page.get_by_label("action").fill("session.")
    page.get_by_label("action").press("Enter")
    expect(page.get_by_role("row").filter(has_text="session.begun")).to_have_count(1)
    expect(page.get_by_role("row").filter(has_text="project.")).to_have_count(0)


def test_an_admin_sets_changes_and_removes_quotas_and_all_see_theirs_in_the_usage(lab: Lab, tab: Tab) -> None:
    page = sign_in(tab, lab.token("root").text, "#/account/quotas")
    expect(page.get_by_text("No quota is set")).to_be_visible()
    form = page.get_by_role("form", name="Set a quota")
    form.get_by_label("Of").select_option("project a")
    form.get_by_label("Waiting").fill("many")
    form.get_by_role("button", name="Set it").click()
    expect(form.get_by_role("alert")).to_contain_text("queued")
    form.get_by_label("Waiting").fill("200")
    form.get_by_label("GPU hours").fill("40")
    form.get_by_label("Stored").fill("500")
    form.get_by_role("button", name="Set it").click()
    row = page.get_by_role("row").filter(has_text="project a")
    expect(row).to_contain_text("0 of 200")
    expect(row).to_contain_text("0 B of 500 GB")
    assert flaws(page) == []
    tab.picture("account-quotas")
    row.get_by_role("button", name="Change").click()
    expect(form.get_by_label("Stored")).to_have_value("500")
    form.get_by_label("Waiting").fill("")
    form.get_by_label("Weight").fill("2")
    form.get_by_label("Highest priority").select_option("normal")
    form.get_by_role("button", name="Set it").click()
    expect(row).not_to_contain_text("of 200")
    set_now = lab.stack.store.quotas().of("project", "a")
    assert set_now == Quota(2.0, gpu_hours=40.0, bytes=500 * 10**9, highest_priority="normal")
    expect(row.get_by_role("cell", name="normal")).to_be_visible()
    page.get_by_role("link", name="Usage").click()
    expect(page.get_by_role("region", name="Quotas").get_by_text("0 of 40")).to_be_visible()
    assert flaws(page) == []
    tab.picture("usage-quotas")
    page.goto(page.url.replace("#/usage", "#/account/quotas"))
    row.get_by_role("button", name="Remove").click()
    row.get_by_role("button", name="Yes, remove").click()
    expect(page.get_by_text("No quota is set")).to_be_visible()


def test_lists_say_whose_jobs_are_and_filter_by_it(lab: Lab, tab: Tab) -> None:
    for number, (owner, project) in enumerate(
        [("two", "a"), ("ann", "a"), ("bob", "b"), ("vic", "default")], 1
    ):
        owned(lab.stack, number, owner, project)
    page = sign_in(tab, lab.token("two").text)
    jobs = page.get_by_role("rowheader")
    expect(jobs).to_have_text(["of two in a", "of bob in b", "of ann in a"])  # One's own, then the newest.
    row = page.get_by_role("row", name="of bob in b")
    expect(row.get_by_role("cell", name="bob", exact=True)).to_be_visible()
    page.get_by_label("Project").first.select_option("b")
    expect(jobs).to_have_text(["of bob in b"])
    assert flaws(page) == []
    tab.picture("jobs-of-a-lab")
    page.get_by_label("Project").first.select_option("")
    expect(jobs).to_have_count(3)
    owner = page.get_by_role("combobox", name="Owner")
    owner.fill("ann")
    owner.press("Enter")
    expect(jobs).to_have_text(["of ann in a"])
    assert re.search(r"owner=ann", page.url)


def test_a_user_of_several_projects_says_which(lab: Lab, tab: Tab) -> None:
    page = sign_in(tab, lab.token("two", TokenScope.SUBMIT, lives=timedelta(hours=1)).text, "#/submit")
    page.get_by_role("button", name="Submit").click()
    expect(page.get_by_role("alert")).to_contain_text("/project")
    choice = page.get_by_label("project", exact=True)
    expect(choice).to_have_attribute("aria-invalid", "true")
    choice.select_option("b")
    page.get_by_role("button", name="Submit").click()
    expect(page.get_by_text("two · b ·")).to_be_visible()
    assert flaws(page) == []


def test_without_accounts_nothing_of_them_is_shown(stack: Stack, tab: Tab) -> None:
    Attempt(stack, job(name="mine"))
    page = tab.open()
    expect(page.get_by_role("rowheader", name="mine")).to_be_visible()
    for text in ("Owner", "Project"):
        expect(page.get_by_label(text)).to_have_count(0)
        expect(page.get_by_role("columnheader", name=text)).to_have_count(0)
    expect(page.locator("a.who")).to_have_count(0)
    expect(page.get_by_text("default", exact=True)).to_have_count(0)
    tab.open("#/submit")
    expect(page.get_by_role("button", name="Submit")).to_be_visible()
    expect(page.get_by_label("project", exact=True)).to_have_count(0)


def test_the_identity_provider_signs_in_and_a_refusal_is_a_sentence(
    server: tuple[FastAPI, int], stack: Stack, tab: Tab
) -> None:
    with provided() as provider, opened(server[0], stack, **rules(provider)) as lab:
        attempt = owned(lab.stack, 1, "ann", "default")
        provider.claims = {**KIM, "email": "kim@evil.example"}
        page = tab.open(f"#/jobs/{attempt.id}/files")
        page.get_by_role("button", name="Sign in with single sign-on").click()
        expect(page.get_by_role("alert")).to_contain_text("evil.example may not sign in")
        assert page.url == f"{tab.url}/"
        assert flaws(page) == []
        tab.picture("sign-in-refused")
        provider.claims = dict(KIM)
        page = tab.open(f"#/jobs/{attempt.id}/files")
        page.get_by_role("button", name="Sign in with single sign-on").click()
        expect(page.get_by_role("heading", name="of ann in default")).to_be_visible()
        assert page.url == f"{tab.url}/#/jobs/{attempt.id}/files"
        expect(page.get_by_role("link", name="kim", exact=True)).to_be_visible()
