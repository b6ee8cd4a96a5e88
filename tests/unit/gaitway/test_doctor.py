from collections import namedtuple
from pathlib import Path

import pytest
from typer.testing import CliRunner

from core.settings import WorkerSettings
from gaitway.cli.main import app
from gaitway.doctor import machine, run, services
from gaitway.doctor.check import Check, ProbeFailed, probe


def environ(settings: WorkerSettings, **changed: str) -> dict[str, str]:
    return {
        "GAITWAY_REDIS_URL": settings.redis_url.get_secret_value(),
        "GAITWAY_S3_ENDPOINT": settings.s3_endpoint,
        "GAITWAY_S3_ACCESS_KEY": settings.s3_access_key,
        "GAITWAY_S3_SECRET_KEY": settings.s3_secret_key.get_secret_value(),
        "GAITWAY_S3_BUCKET": settings.s3_bucket,
        "GAITWAY_S3_SECURE": "false",
        **({"GAITWAY_S3_REGION": settings.s3_region} if settings.s3_region else {}),
        **changed,
    }


def test_real_servers_pass(settings: WorkerSettings) -> None:
    found = [check(environ(settings)) for check in (services.redis, services.object_store, services.clock)]
    assert [check.state for check in found] == ["pass", "pass", "pass"]


def test_what_is_not_configured_is_skipped_and_not_passed() -> None:
    assert {services.redis({}).state, services.object_store({}).state, services.clock({}).state} == {"skip"}


def test_servers_that_are_away_fail_with_a_remedy() -> None:
    names = ("GAITWAY_S3_ACCESS_KEY", "GAITWAY_S3_SECRET_KEY")
    away = {
        "GAITWAY_REDIS_URL": "redis://127.0.0.1:1",
        "GAITWAY_S3_ENDPOINT": "127.0.0.1:1",
        "GAITWAY_S3_SECURE": "false",
        **dict.fromkeys(names, "x"),
    }
    for check in (services.redis(away), services.object_store(away)):
        assert check.state == "fail"
        assert "GAITWAY_" in check.remedy


def test_half_a_configuration_of_the_object_store_fails_and_names_the_rest() -> None:
    check = services.object_store({"GAITWAY_S3_ENDPOINT": "127.0.0.1:1"})
    assert check.state == "fail"
    assert "GAITWAY_S3_SECRET_KEY" in check.detail


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
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def broken() -> Check:
        raise RuntimeError("oops")

    for name in ("jax_devices", "renderer", "encoder"):
        monkeypatch.setattr(machine, name, broken)
    for name in (
        "GAITWAY_REDIS_URL",
        "GAITWAY_S3_ENDPOINT",
        "GAITWAY_S3_ACCESS_KEY",
        "GAITWAY_S3_SECRET_KEY",
    ):
        monkeypatch.delenv(name, raising=False)
    states = {check.name: check.state for check in run.examine(tmp_path)}
    assert [name for name, state in states.items() if state == "fail"] == ["jax", "renderer", "encoder"]
    assert states["clock"] == "skip"
    assert CliRunner().invoke(app, ["doctor", "--json", "--data", str(tmp_path)]).exit_code == 1


def test_the_encoder_makes_a_real_video() -> None:
    assert machine.encoder().state == "pass"
