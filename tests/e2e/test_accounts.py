"""A lab's first ten minutes by the command, against the real service over real sockets."""

import json
import stat
from collections.abc import Iterator
from pathlib import Path

import pytest
import typer
from fastapi import FastAPI
from pydantic import SecretStr
from typer.testing import CliRunner, Result

from core.accounts.first_admin import first_admin
from core.accounts.principal import TokenScope
from gaitway import Client, Forbidden, Unauthenticated, credentials
from gaitway.cli.main import app
from gaitway.service.commands.services import joined
from tests.api.accounts import Lab, opened
from tests.api.conftest import Stack, quiet, server, stack
from tests.faults.test_news import HERE, sending
from tests.receivers import receiving

__all__ = ["quiet", "server", "stack"]  # fixtures
WORKER = TokenScope.WORKER


@pytest.fixture
def lab(
    server: tuple[FastAPI, int], stack: Stack, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Lab]:
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.delenv("XDG_CONFIG_HOME", raising=False)
    monkeypatch.delenv(credentials.VARIABLE, raising=False)
    with opened(server[0], stack) as lab:
        yield lab


def gaitway(lab: Lab, *arguments: str, stdin: str | None = None, token: str | None = None) -> Result:
    """The command, by the stored token or by this one."""
    environment = {} if token is None else {credentials.VARIABLE: token}
    url = f"http://127.0.0.1:{lab.stack.port}"
    return CliRunner(env=environment).invoke(app, ["--url", url, *arguments], input=stdin)


def succeeded(result: Result) -> str:
    assert result.exit_code == 0, result.output
    return result.stdout


def test_a_lab_in_ten_minutes(lab: Lab) -> None:
    secret = first_admin(lab.stack.store, "boss", anyway=True)
    assert secret is not None
    assert first_admin(lab.stack.store, "other") is None
    assert "gaitway login" in gaitway(lab, "jobs").stderr
    assert gaitway(lab, "jobs").exit_code == 2
    told = succeeded(gaitway(lab, "login", stdin=f"{secret.text}\n"))
    assert "You are boss" in told
    assert stat.S_IMODE(credentials.file().stat().st_mode) == 0o600
    succeeded(gaitway(lab, "projects", "add", "gaits"))
    for name, role in (("dan", "submitter"), ("eve", "viewer")):
        succeeded(gaitway(lab, "users", "add", name, "--role", role, "--project", "gaits"))
    dan = succeeded(gaitway(lab, "tokens", "create", "--user", "dan")).strip()
    eve = succeeded(gaitway(lab, "tokens", "create", "--user", "eve", "--scope", "read")).strip()
    job = succeeded(gaitway(lab, "submit", "ant", "--no-video", token=dan)).split()[0]
    shown = succeeded(gaitway(lab, "show", job, token=eve))
    assert "dan, in the project gaits" in shown
    assert "dan" in succeeded(gaitway(lab, "jobs", "--owner", "dan", "--project", "gaits", token=eve))
    assert "a token of the scope submit" in gaitway(lab, "cancel", job, token=eve).stderr
    assert gaitway(lab, "show", job, token=lab.token("bob").text).exit_code == 1
    assert "dan, eve" in succeeded(gaitway(lab, "projects", "list"))
    assert "You are eve" in succeeded(gaitway(lab, "whoami", token=eve))
    assert "eve" in succeeded(gaitway(lab, "projects", "members", "gaits", "--remove", "dan"))
    assert "submitter" in succeeded(gaitway(lab, "users", "role", "eve", "submitter"))
    subject = "https://id.lab.edu#1234"
    assert f"{subject} signs in as eve" in succeeded(gaitway(lab, "users", "link", "eve", subject))
    lab.service.audit_log.flush()
    log = json.loads(succeeded(gaitway(lab, "audit", "--json", "--user", "dan")))
    assert [(one["action"], one["object"]) for one in log] == [("job.submitted", f"job {job}")]
    of_eve = json.loads(succeeded(gaitway(lab, "tokens", "list", "--user", "eve", "--json")))
    succeeded(gaitway(lab, "tokens", "revoke", of_eve[0]["id"]))
    assert "revoked" in succeeded(gaitway(lab, "tokens", "list"))
    succeeded(gaitway(lab, "users", "disable", "dan"))
    assert "disabled" in succeeded(gaitway(lab, "users", "list"))
    assert "is forgotten" in succeeded(gaitway(lab, "logout"))
    assert gaitway(lab, "whoami").exit_code == 2


def test_a_token_that_the_service_does_not_accept_is_not_stored(lab: Lab) -> None:
    for text in ("gaitway_0_x", lab.token("ann").text[:-1], ""):
        assert gaitway(lab, "login", stdin=f"{text}\n").exit_code == 2
    assert not credentials.file().exists()


def test_a_login_at_a_service_without_accounts_stores_nothing(stack: Stack, lab: Lab) -> None:
    lab.service.authenticator = None
    result = gaitway(lab, "login", stdin="gaitway_0_x\n")
    assert result.exit_code == 1
    assert "has no accounts, and needs no token" in result.stderr
    assert not credentials.file().exists()
    assert "everybody who reaches it" in succeeded(gaitway(lab, "whoami"))


def test_the_client_raises_what_it_may_not_do(lab: Lab) -> None:
    url = f"http://127.0.0.1:{lab.stack.port}"
    with Client(url) as client, pytest.raises(Unauthenticated, match="gaitway login"):
        client.submit(environment="ant")
    with Client(url, token=lab.token("vic").text) as client:
        with pytest.raises(Forbidden, match="role submitter"):
            client.submit(environment="ant")
        assert [project.name for project in client.projects()] == ["a"]
        assert list(client.list(owner="ann", project="a")) == []


def test_a_worker_asks_a_service_for_its_settings(lab: Lab) -> None:
    named = {
        "worker_database_url": SecretStr("postgresql://worker:word@db.lab/gaitway"),
        "worker_redis_url": SecretStr("redis://:word@redis.lab/0"),
        "worker_s3_endpoint": "s3.lab:9000",
    }
    lab.service.settings = lab.service.settings.model_copy(update=named)
    url = f"http://127.0.0.1:{lab.stack.port}"
    by_tunnel = {"GAITWAY_S3_ENDPOINT": "127.0.0.1:7", credentials.VARIABLE: lab.token("root", WORKER).text}
    joined(url, by_tunnel)
    assert by_tunnel["GAITWAY_DATABASE_URL"] == "postgresql://worker:word@db.lab/gaitway"
    assert by_tunnel["GAITWAY_S3_ENDPOINT"] == "127.0.0.1:7"
    assert credentials.VARIABLE not in by_tunnel
    assert Path(by_tunnel["GAITWAY_DATA_DIR"]).is_dir()
    with pytest.raises(typer.Exit):
        joined(url, {})
    with pytest.raises(Forbidden, match="scope worker"):
        joined(url, {credentials.VARIABLE: lab.token("ann").text})


def test_quotas_by_the_command(lab: Lab) -> None:
    root, ann = lab.token("root").text, lab.token("ann").text
    assert "No quota is set" in succeeded(gaitway(lab, "quotas", "list", token=ann))
    made = gaitway(lab, "quotas", "set", "project", "a", "--gpu-hours", "40", "--bytes", "200GB", token=root)
    for words in ("0.0 of 40", "0 B of 200.0 GB"):
        assert words in succeeded(made)
    whole = gaitway(lab, "quotas", "set", "project", "a", "--queued", "0", "--json", token=root)
    assert json.loads(succeeded(whole))["gpu_hours"] is None
    refused = gaitway(lab, "submit", "ant", token=ann)
    assert (refused.exit_code, "its quota of queued jobs is 0" in refused.stderr) == (1, True)
    assert gaitway(lab, "submit", "ant", "--dry-run", token=ann).exit_code == 1
    for wrong in (("team", "a"), ("user", "ann", "--bytes", "much")):
        assert gaitway(lab, "quotas", "set", *wrong, token=root).exit_code == 2
    assert "0 of 0" in succeeded(gaitway(lab, "quotas", "list", token=ann))
    assert "has no quota any more" in succeeded(gaitway(lab, "quotas", "remove", "project", "a", token=root))


def test_a_webhook_by_the_command(lab: Lab) -> None:
    token = lab.token("two").text
    lab.service.settings = lab.service.settings.model_copy(update={"news_networks": HERE})
    with receiving() as receiver, sending(lab.stack.store):
        missing = gaitway(lab, "webhooks", "list", token=token)
        assert (missing.exit_code, "several projects: say which by --project" in missing.stderr) == (2, True)
        made = gaitway(
            lab, "webhooks", "add", "hook", receiver.url, "--project", "a", "--jobs", "named", token=token
        )
        assert succeeded(made).startswith("whsec_")
        assert "gaitway webhooks test hook" in made.stderr
        in_a = ("--project", "a")
        listed = succeeded(gaitway(lab, "webhooks", "list", *in_a, "--json", token=token))
        assert [(one["name"], one["jobs"]) for one in json.loads(listed)] == [("hook", "named")]
        tested = succeeded(gaitway(lab, "webhooks", "test", "hook", *in_a, token=token))
        assert tested == f"{receiver.next().headers['webhook-id']}: delivered (204)\n"
        sent = gaitway(lab, "submit", "ant", *in_a, "--notify", "hook", token=token)
        job_id = succeeded(sent).strip()
        succeeded(gaitway(lab, "cancel", job_id, token=token))
        assert receiver.next().message["type"] == "job.cancelled"
        shown = succeeded(gaitway(lab, "webhooks", "deliveries", "hook", *in_a, token=token))
        assert "webhook.test" in shown
        number = next(line.split()[0] for line in shown.splitlines() if "webhook.test" in line)
        again = succeeded(gaitway(lab, "webhooks", "resend", number, token=token))
        assert again.startswith("webhook.test goes to hook again, as delivery ")
        assert receiver.next().message["type"] == "webhook.test"
        assert succeeded(gaitway(lab, "webhooks", "rotate", "hook", *in_a, token=token)).startswith("whsec_")
        nothing = gaitway(lab, "webhooks", "change", "hook", *in_a, token=token)
        assert (nothing.exit_code, "Say what changes: --url" in nothing.stderr) == (2, True)
        changes = ("--event", "job.failed", "--jobs", "all", "--stop", "--json")
        changed = json.loads(
            succeeded(gaitway(lab, "webhooks", "change", "hook", *in_a, *changes, token=token))
        )
        assert (changed["events"], changed["jobs"]) == (["job.failed"], "all")
        assert changed["stopped"] == "Stopped by two."
        of_job = succeeded(gaitway(lab, "webhooks", "deliveries", "--job", job_id, "--json", token=token))
        assert [one["event"] for one in json.loads(of_job)] == ["job.cancelled"]
        succeeded(gaitway(lab, "webhooks", "delete", "hook", *in_a, "--yes", token=token))


def test_retention_by_the_command(lab: Lab) -> None:
    token, in_a = lab.token("root").text, ("--project", "a")
    shown = succeeded(gaitway(lab, "retention", "show", *in_a, token=token))
    assert shown == "a has no rules and keeps everything.\n"
    without = gaitway(lab, "retention", "preview", *in_a, token=token)
    assert (without.exit_code, "give some, such as --checkpoints 2" in without.stderr) == (2, True)
    seen = succeeded(gaitway(lab, "retention", "preview", *in_a, "--checkpoints", "2", token=token))
    assert seen == "0 jobs would lose 0 files, 0 bytes.\n"
    rules = ("--checkpoints", "2", "--videos-days", "30", "--yes")
    made = succeeded(gaitway(lab, "retention", "set", *in_a, *rules, token=token))
    assert "In a, of each job the newest 2 checkpoints stay; videos go after 30 days. Set by root" in made
    own = succeeded(gaitway(lab, "retention", "preview", *in_a, "--json", token=token))
    assert json.loads(own)["jobs"] == 0
    removed = succeeded(gaitway(lab, "retention", "remove", *in_a, token=token))
    assert removed == "a keeps everything from now on.\n"
