import re
import shlex
import signal
import stat
import subprocess
from collections.abc import Mapping
from datetime import timedelta
from ipaddress import ip_address
from pathlib import Path
from typing import Any

import pytest
import yaml
from cryptography import x509

from core.configuration import PROCESSES, names, read
from core.settings import ApiSettings, StoreSettings, WorkerSettings
from core.variables import variable
from gaitway.service import compose
from gaitway.service.settings_page import OTHERS

ROOT = Path(__file__).parents[3]


@pytest.fixture(scope="module")
def services() -> Mapping[str, Any]:
    return yaml.safe_load((ROOT / "docker-compose.yml").read_text())["services"]


@pytest.fixture
def settings_from(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Reads what a folder holds, in an environment without settings."""

    def settings_from(folder: Path, **environ: str) -> ApiSettings:
        for name in names():
            monkeypatch.delenv(name, raising=False)
        for name, value in environ.items():
            monkeypatch.setenv(name, value)
        monkeypatch.setenv("GAITWAY_SECRETS_DIR", str(folder))
        return read(ApiSettings)

    return settings_from


def files(folder: Path) -> dict[str, str]:
    return {path.name: path.read_text() for path in folder.iterdir()}


def test_secrets_are_made_once_and_read_by_their_owner_alone(tmp_path: Path) -> None:
    compose.setup(tmp_path, {}, tmp_path / "database.password")
    first = files(tmp_path)
    compose.setup(tmp_path, {}, tmp_path / "database.password")
    assert files(tmp_path) == first
    modes = {path.name: stat.S_IMODE(path.stat().st_mode) for path in tmp_path.iterdir()}
    # PostgreSQL's container runs as another user, and sees nothing else of the secrets.
    assert modes.pop("database.password") == 0o644
    assert set(modes.values()) == {0o600}


def test_two_deployments_have_different_secrets(tmp_path: Path) -> None:
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        compose.setup(tmp_path / name, {}, tmp_path / name / "database.password")
    assert (tmp_path / "one/keys.json").read_text() != (tmp_path / "two/keys.json").read_text()


def test_the_files_are_settings(tmp_path: Path, settings_from: Any) -> None:
    compose.setup(tmp_path, {}, tmp_path / "database.password")
    settings = settings_from(tmp_path)
    assert settings.s3_endpoint == "objects:8333"
    assert not settings.s3_secure
    password = (tmp_path / "valkey.password").read_text()
    assert settings.redis_url.get_secret_value() == f"redis://:{password}@valkey:6379/0"
    assert (tmp_path / "valkey.conf").read_text() == f"requirepass {password}\n"
    password = (tmp_path / "database.password").read_text()
    assert (
        settings.database_url.get_secret_value() == f"postgresql://gaitway:{password}@postgres:5432/gaitway"
    )


def test_a_new_set_of_keys_leaves_the_password_that_the_database_has(tmp_path: Path) -> None:
    compose.setup(tmp_path, {}, tmp_path / "database.password")
    before = (tmp_path / "gaitway_database_url").read_text()
    (tmp_path / "keys.json").unlink()
    compose.setup(tmp_path, {}, tmp_path / "database.password")
    assert (tmp_path / "gaitway_database_url").read_text() == before


def test_a_store_of_the_users_own_is_not_mixed_with_ours(tmp_path: Path, settings_from: Any) -> None:
    compose.setup(tmp_path, {}, tmp_path / "database.password")
    own = {
        "GAITWAY_S3_ENDPOINT": "s3.example:443",
        "GAITWAY_S3_ACCESS_KEY": "theirs",
        "GAITWAY_S3_SECRET_KEY": "theirs too",
    }
    compose.setup(tmp_path, own, tmp_path / "database.password")
    settings = settings_from(tmp_path, **own)
    assert settings.s3_secure  # ours speaks no TLS, and says so in a file of the first start
    assert settings.s3_region is None
    assert settings.redis_url.get_secret_value().endswith("@valkey:6379/0")


def test_weed_is_started_with_the_keys_that_the_settings_have(tmp_path: Path) -> None:
    compose.setup(tmp_path, {}, tmp_path / "database.password")
    shown = subprocess.check_output(["sh", str(tmp_path / "objects.sh"), "env"], text=True)
    assert f"AWS_ACCESS_KEY_ID={(tmp_path / 'gaitway_s3_access_key').read_text()}\n" in shown
    assert f"AWS_SECRET_ACCESS_KEY={(tmp_path / 'gaitway_s3_secret_key').read_text()}\n" in shown


def test_weed_is_ended_when_only_a_new_start_lets_it_write_again(tmp_path: Path) -> None:
    compose.setup(tmp_path, {}, tmp_path / "database.password")
    line = "insert entry /a: write /data/filerldb2/04/000001.log: no space left on device"
    started = [
        "sh",
        str(tmp_path / "objects.sh"),
        "sh",
        "-c",
        f"echo a line >&2; echo '{line}' >&2; exec sleep 60",
    ]
    ended = subprocess.run(
        started, cwd=tmp_path, capture_output=True, text=True, timeout=20, check=False, start_new_session=True
    )
    assert (ended.returncode, ended.stderr) == (-signal.SIGTERM, f"a line\n{line}\n")


def test_a_worker_elsewhere_is_told_the_shared_address_and_to_verify_it(tmp_path: Path) -> None:
    compose.setup(tmp_path, {}, tmp_path / "database.password")
    told = compose.join(tmp_path, {"GAITWAY_SHARE": "192.0.2.7"}, tmp_path / "database.password")
    password = (tmp_path / "valkey.password").read_text()
    assert told["GAITWAY_REDIS_URL"] == f"rediss://:{password}@192.0.2.7:6379/0"
    assert told["GAITWAY_S3_ENDPOINT"] == "192.0.2.7:8333"
    assert told["GAITWAY_S3_SECURE"] == "true"
    assert told["GAITWAY_DATABASE_URL"].endswith("@192.0.2.7:5432/gaitway?sslmode=verify-full")
    assert told.pop("COMPOSE_FILE") == "docker-compose.yml:deploy/own-ca.yml"
    assert set(told) <= names()


def test_the_api_hands_out_shared_stores_with_a_user_that_sees_jobs_alone(tmp_path: Path) -> None:
    shared = {"GAITWAY_SHARE": "192.0.2.7"}
    compose.setup(tmp_path, shared, tmp_path / "database.password")
    found = {file.name.upper(): file.read_text() for file in tmp_path.glob("gaitway_worker_*")}
    assert set(found) <= names()
    database = found["GAITWAY_WORKER_DATABASE_URL"]
    assert database.startswith("postgresql://gaitway_worker:")
    assert database.endswith("@192.0.2.7:5432/gaitway?sslmode=verify-full")
    assert (tmp_path / "database.password").read_text() not in database
    assert found["GAITWAY_WORKER_REDIS_URL"].startswith("rediss://:")
    assert found["GAITWAY_WORKER_S3_ENDPOINT"] == "192.0.2.7:8333"
    assert found["GAITWAY_WORKER_S3_SECURE"] == "true"
    assert found["GAITWAY_WORKER_TLS_CA"] == "/run/gaitway/ca.pem"
    compose.setup(tmp_path, shared, tmp_path / "database.password")
    assert (tmp_path / "gaitway_worker_database_url").read_text() == database
    compose.setup(tmp_path, {}, tmp_path / "database.password")
    assert list(tmp_path.glob("gaitway_worker_*")) == []


def test_a_worker_elsewhere_finds_its_authority_where_its_container_has_it(tmp_path: Path) -> None:
    told = compose.join(tmp_path, {"GAITWAY_SHARE": "192.0.2.7"}, tmp_path / "database.password")
    added = yaml.safe_load((ROOT / "deploy/own-ca.yml").read_text())["services"]
    for service in ("setup", "api", "reconciler", "worker", "worker-gpu"):
        (mount,) = added[service]["volumes"]
        assert mount["target"] == told["GAITWAY_TLS_CA"], service
        assert added[service]["environment"]["GAITWAY_TLS_CA"] == told["GAITWAY_TLS_CA"], service


def test_shared_stores_get_a_certificate_for_their_address(tmp_path: Path) -> None:
    database = tmp_path / "database"
    database.mkdir()
    compose.setup(tmp_path, {}, database / "password")
    assert not (tmp_path / "ca.pem").exists()
    compose.setup(tmp_path, {"GAITWAY_SHARE": "192.0.2.7"}, database / "password")
    trusted = (tmp_path / "ca.pem").read_bytes()
    by = x509.load_pem_x509_certificate(trusted)
    for folder in (tmp_path, database):
        shown = x509.load_pem_x509_certificate((folder / "stores.crt").read_bytes())
        shown.verify_directly_issued_by(by)
        (name,) = shown.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
        assert name.value == ip_address("192.0.2.7")
    # Machines that have joined go on trusting it at another address.
    compose.setup(tmp_path, {"GAITWAY_SHARE": "192.0.2.8"}, database / "password")
    assert (tmp_path / "ca.pem").read_bytes() == trusted
    assert (tmp_path / "stores.key").stat().st_mode & 0o077 == 0


def test_postgresql_lets_in_from_outside_by_tls_alone(tmp_path: Path) -> None:
    compose.setup(tmp_path, {"GAITWAY_SHARE": "192.0.2.7"}, tmp_path / "database.password")
    rules = [line.split() for line in (tmp_path / "pg_hba.conf").read_text().splitlines()]
    assert {rule[3] for rule in rules if rule[0] == "host"} == {"127.0.0.1/32", "::1/128"}
    assert ["hostssl", "all", "all", "all", "scram-sha-256"] in rules
    assert {rule[-1] for rule in rules} == {"scram-sha-256"}


def test_a_worker_elsewhere_is_told_of_stores_of_the_users_own(tmp_path: Path) -> None:
    own = {
        "GAITWAY_DATABASE_URL": "postgresql://u:w@db/gaitway",
        "GAITWAY_REDIS_URL": "rediss://:word@records:6380",
        "GAITWAY_S3_ENDPOINT": "s3.example:443",
    }
    assert compose.join(tmp_path, own) == own


@pytest.mark.parametrize("address", ["", "0.0.0.0", "127.0.0.1"])  # noqa: S104
def test_without_an_address_that_others_reach_there_is_a_sentence(
    address: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(compose, "SECRETS", tmp_path)
    for name in names():
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("GAITWAY_SHARE", address)
    assert compose.main(["join"]) == 2
    assert "GAITWAY_SHARE" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("service", "process"), [("api", "API"), ("reconciler", "reconciler"), ("worker", "worker")]
)
def test_every_setting_of_a_process_is_handed_to_its_container(
    service: str, process: str, services: Mapping[str, Any]
) -> None:
    # The image says these for its own file system and its own device.
    in_the_image = {"GAITWAY_DATA_DIR", "GAITWAY_DEVICE", "GAITWAY_ALIVE_FILE"}
    wanted = {variable(field) for field in PROCESSES[process].model_fields} - in_the_image
    assert wanted - set(services[service]["environment"]) == set()


def test_the_set_up_knows_every_setting_of_the_stores(services: Mapping[str, Any]) -> None:
    stores = {variable(field) for field in StoreSettings.model_fields}
    assert stores - set(services["setup"]["environment"]) == set()
    own = compose.join(Path("unused"), dict.fromkeys(stores, "x"))
    assert set(own) == stores


def test_what_the_compose_file_asks_for_is_on_the_page_of_settings() -> None:
    text = (ROOT / "docker-compose.yml").read_text() + (ROOT / "deploy/share.yml").read_text()
    asked = set(re.findall(r"\$\{(\w+)", text))
    assert asked <= names() | {other.name for other in OTHERS}


def test_every_container_is_confined_and_keeps_its_log_small(services: Mapping[str, Any]) -> None:
    for name, service in services.items():
        assert service["read_only"], name
        assert service["cap_drop"] == ["ALL"], name
        assert service["security_opt"] == ["no-new-privileges:true"], name
        assert service["logging"] == {"driver": "local"}, name


def test_the_queue_lies_in_memory_and_refuses_what_it_has_no_room_for(services: Mapping[str, Any]) -> None:
    words = shlex.split(services["valkey"]["command"])
    options = dict(zip(words[2::2], words[3::2], strict=True))
    assert options["--appendonly"] == "no"
    assert options["--save"] == ""
    assert options["--maxmemory"] == "256mb"
    assert options["--maxmemory-policy"] == "noeviction"
    assert {volume["source"] for volume in services["valkey"]["volumes"]} == {"secrets"}


@pytest.mark.parametrize("store", ["postgres", "redis", "s3"])
def test_a_store_of_the_users_own_takes_the_place_of_ours(store: str, services: Mapping[str, Any]) -> None:
    left_out = yaml.safe_load((ROOT / f"deploy/own-{store}.yml").read_text())["services"]
    (name,) = left_out
    assert left_out[name]["profiles"] == ["not-ours"]
    for process in ("api", "reconciler", "worker", "worker-gpu"):
        assert services[process]["depends_on"][name]["required"] is False


def test_every_store_is_shared_by_tls_with_workers_elsewhere() -> None:
    shared = yaml.safe_load((ROOT / "deploy/share.yml").read_text())["services"]
    ports = {name: service["ports"][0].rpartition("}:")[2] for name, service in shared.items()}
    # The last two are those for TLS, as the command's options say.
    assert ports == {"postgres": "5432:5432", "valkey": "6379:6380", "objects": "8333:8334"}
    assert "-c ssl=on" in shared["postgres"]["entrypoint"][2]
    assert "--tls-port 6380" in shared["valkey"]["entrypoint"][2]
    assert "-s3.port.https=8334" in shared["objects"]["entrypoint"][2]


def test_a_drain_has_more_time_than_the_grace(services: Mapping[str, Any]) -> None:
    minutes = re.fullmatch(r"\$\{GAITWAY_STOP_WITHIN:-(\d+)m\}", services["worker"]["stop_grace_period"])
    assert minutes is not None
    assert timedelta(minutes=int(minutes[1])) > WorkerSettings.model_fields["grace"].default


def test_the_image_says_what_a_gpu_is_used_for(services: Mapping[str, Any]) -> None:
    """A capability here would take the place of the image's own list, CUDA's among them."""
    (device,) = services["worker-gpu"]["deploy"]["resources"]["reservations"]["devices"]
    assert device["capabilities"] == ["gpu"]
    assert "NVIDIA_DRIVER_CAPABILITIES=compute,utility,graphics" in (ROOT / "Dockerfile").read_text()


def test_the_bucket_that_is_made_is_the_one_that_is_used(services: Mapping[str, Any]) -> None:
    assert f"-bucket={StoreSettings.model_fields['s3_bucket'].default}" in shlex.split(
        services["objects"]["command"]
    )
