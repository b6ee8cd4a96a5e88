import json
import os
import threading
from collections import namedtuple
from datetime import datetime, timedelta, tzinfo
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import pytest
import redis
from typer.testing import CliRunner

from core.configuration import SECRETS_DIR, names, variable
from core.settings import WorkerSettings
from gaitway.cli.main import app
from gaitway.doctor import machine, run, services
from gaitway.doctor import settings as doctor_settings
from gaitway.doctor.check import Check, ProbeFailed, probe


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
    found = [check(None) for check in (services.redis, services.object_store, services.clock, machine.device)]
    assert {check.state for check in (*found, doctor_settings.settings(), services.api())} == {"skip"}


def test_half_a_configuration_fails_and_names_the_rest(nothing_set: pytest.MonkeyPatch) -> None:
    nothing_set.setenv("GAITWAY_S3_ENDPOINT", "127.0.0.1:1")
    check = doctor_settings.settings()
    assert check.state == "fail"
    for name in ("REDIS_URL", "S3_ACCESS_KEY", "S3_SECRET_KEY"):
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


def test_a_redis_without_its_append_only_file_is_a_warning(
    settings: WorkerSettings, redis_client: redis.Redis
) -> None:
    redis_client.config_set("appendonly", "no")
    try:
        check = services.redis(settings)
    finally:
        redis_client.config_set("appendonly", "yes")
    assert (check.state, "appendonly yes" in check.remedy) == ("warn", True)


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
        (200, None, "fail", "is no Gaitway service"),
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


def test_embedded_servers_started_for_a_moment_pass(nothing_set: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for name in ("jax_devices", "physics", "renderer", "encoder"):
        nothing_set.setattr(machine, name, lambda: Check("left out", "skip", ""))
    nothing_set.setenv("GAITWAY_S3_STYLE", "host")  # The user's own; it leads elsewhere.
    states = {check.name: check.state for check in run.examine(tmp_path, embedded=True)}
    assert {states[name] for name in ("settings", "redis", "object store", "clock")} == {"pass"}
    assert os.environ["GAITWAY_S3_STYLE"] == "host"
    assert "GAITWAY_REDIS_URL" not in os.environ


def test_the_encoder_makes_a_real_video() -> None:
    assert machine.encoder().state == "pass"
