from datetime import timedelta
from pathlib import Path

import pytest
from psycopg.conninfo import conninfo_to_dict
from pydantic_settings import BaseSettings
from redis.connection import parse_url

from core.configuration import names, read, stopping_if_misconfigured
from core.errors import EXIT_STATUS, Misconfigured
from core.settings import ApiSettings, ReconcilerSettings, StoreSettings, WorkerSettings
from core.variables import variable
from gaitway.service.embedded.certificates import authority
from gaitway.service.settings_page import OTHERS, page

ROOT = Path(__file__).parents[2]
GOOD = {
    "GAITWAY_DATABASE_URL": "postgresql://gaitway:secret@record:5432/gaitway",
    "GAITWAY_REDIS_URL": "redis://:secret@records:6379/0",
    "GAITWAY_S3_ENDPOINT": "objects:8333",
    "GAITWAY_S3_ACCESS_KEY": "key",
    "GAITWAY_S3_SECRET_KEY": "secret",
    "GAITWAY_DATA_DIR": "/data",
}


@pytest.fixture(autouse=True)
def environ(monkeypatch: pytest.MonkeyPatch) -> pytest.MonkeyPatch:
    """An environment with settings that are in order, and no others."""
    for name in names() | {"GAITWAY_SECRETS_DIR"}:
        monkeypatch.delenv(name, raising=False)
    for name, value in GOOD.items():
        monkeypatch.setenv(name, value)
    return monkeypatch


def refusal(kind: type[StoreSettings] = WorkerSettings) -> str:
    with pytest.raises(Misconfigured) as refused:
        read(kind)
    return refused.value.detail


def test_settings_in_order_are_read() -> None:
    settings = read(WorkerSettings)
    assert settings.s3_endpoint == "objects:8333"
    assert settings.lease == timedelta(seconds=14)


@pytest.mark.parametrize("name", GOOD)
def test_a_missing_one_is_named_with_its_meaning(name: str, environ: pytest.MonkeyPatch) -> None:
    environ.delenv(name)
    assert refusal().startswith(f"{name} is not set. ")


def test_an_empty_variable_is_an_unset_one(environ: pytest.MonkeyPatch) -> None:
    environ.setenv("GAITWAY_S3_ENDPOINT", "")
    environ.setenv("GAITWAY_S3_REGION", "")
    assert refusal().startswith("GAITWAY_S3_ENDPOINT is not set.")


def test_all_that_is_wrong_is_said_at_once(environ: pytest.MonkeyPatch) -> None:
    environ.delenv("GAITWAY_REDIS_URL")
    environ.setenv("GAITWAY_GRACE", "soon")
    sentence = refusal()
    assert "GAITWAY_REDIS_URL is not set." in sentence
    assert "GAITWAY_GRACE is wrong: " in sentence


@pytest.mark.parametrize(
    ("name", "value", "says"),
    [
        ("GAITWAY_DATABASE_URL", "mysql://records/gaitway", "begin it with postgresql://"),
        ("GAITWAY_DATABASE_URL", "records:5432/gaitway", "begin it with postgresql://"),
        ("GAITWAY_REDIS_URL", "http://records", "redis://, rediss:// (TLS) or unix://"),
        ("GAITWAY_REDIS_URL", "redis://records:6379/0", "redis://:PASSWORD@HOST:PORT/0"),
        ("GAITWAY_REDIS_URL", "redis://192.0.2.1", "GAITWAY_REDIS_WITHOUT_PASSWORD=true"),
        ("GAITWAY_S3_ENDPOINT", "https://objects", "GAITWAY_S3_SECURE"),
        ("GAITWAY_S3_SECURE", "perhaps", "GAITWAY_S3_SECURE is wrong"),
        ("GAITWAY_S3_STYLE", "virtual", "'path' or 'host'"),
        ("GAITWAY_DEVICE", "tpu", "GAITWAY_DEVICE is wrong"),
        ("GAITWAY_DEVICE", "gpu:0,", "GAITWAY_DEVICE is wrong"),
        ("GAITWAY_DEVICE", "gpu:0 1", "GAITWAY_DEVICE is wrong"),
        ("GAITWAY_GRACE", "-1", "GAITWAY_GRACE is wrong"),
        ("GAITWAY_HEARTBEAT", "10", "GAITWAY_LEASE (14 s) has to be at least three times"),
        ("GAITWAY_SECRETS_DIR", "/nowhere/at/all", "GAITWAY_SECRETS_DIR names /nowhere/at/all"),
        ("GAITWAY_S3_BUKET", "walkers", "did you mean GAITWAY_S3_BUCKET?"),
    ],
)
def test_a_wrong_one_is_refused_with_what_it_should_be(
    name: str, value: str, says: str, environ: pytest.MonkeyPatch
) -> None:
    environ.setenv(name, value)
    assert says in refusal()


@pytest.mark.parametrize(
    "url",
    [
        "unix:///run/valkey.sock",
        "redis://127.0.0.1:6379/0",
        "redis://[::1]:6379",
        "redis://localhost",
        "rediss://user:word@records:6380/0",
    ],
)
def test_a_redis_with_a_password_or_on_this_machine_is_accepted(
    url: str, environ: pytest.MonkeyPatch
) -> None:
    environ.setenv("GAITWAY_REDIS_URL", url)
    assert read(ReconcilerSettings).redis_url.get_secret_value() == url


@pytest.fixture
def authority_file(tmp_path: Path) -> Path:
    path = tmp_path / "ca, of ours.pem"
    path.write_text(authority("gaitway").certificate)
    return path


def test_the_authority_is_named_in_the_addresses(authority_file: Path, environ: pytest.MonkeyPatch) -> None:
    environ.setenv("GAITWAY_TLS_CA", str(authority_file))
    environ.setenv("GAITWAY_DATABASE_URL", "postgresql://u:w@record/gaitway?sslmode=verify-full")
    environ.setenv("GAITWAY_REDIS_URL", "rediss://:w@records:6380/0")
    settings = read(ReconcilerSettings)
    assert conninfo_to_dict(settings.database_url.get_secret_value())["sslrootcert"] == str(authority_file)
    assert parse_url(settings.redis_url.get_secret_value())["ssl_ca_certs"] == str(authority_file)


@pytest.mark.parametrize(
    ("name", "url"),
    [
        ("database_url", "postgresql://u:w@record/gaitway?sslrootcert=system"),
        ("redis_url", "rediss://:w@records:6380/0?ssl_ca_certs=/theirs.pem"),
        ("redis_url", "redis://:w@records:6380/0"),
        ("redis_url", "unix:///run/valkey.sock"),
    ],
)
def test_an_address_with_an_authority_of_its_own_or_without_tls_stays_as_it_is(
    name: str, url: str, authority_file: Path, environ: pytest.MonkeyPatch
) -> None:
    environ.setenv("GAITWAY_TLS_CA", str(authority_file))
    environ.setenv(variable(name), url)
    assert getattr(read(ReconcilerSettings), name).get_secret_value() == url


@pytest.mark.parametrize(
    ("content", "says"), [(None, "No such file"), ("no certificate", "cannot be read as certificates in PEM")]
)
def test_an_authority_that_cannot_be_read_is_refused(
    content: str | None, says: str, tmp_path: Path, environ: pytest.MonkeyPatch
) -> None:
    if content is not None:
        (tmp_path / "ca.pem").write_text(content)
    environ.setenv("GAITWAY_TLS_CA", str(tmp_path / "ca.pem"))
    sentence = refusal()
    assert sentence.startswith("GAITWAY_TLS_CA is wrong: ")
    assert says in sentence


def test_an_open_redis_can_be_accepted_knowingly(environ: pytest.MonkeyPatch) -> None:
    environ.setenv("GAITWAY_REDIS_URL", "redis://records")
    environ.setenv("GAITWAY_REDIS_WITHOUT_PASSWORD", "true")
    assert read(ApiSettings).redis_without_password


def test_names_that_others_use_are_let_be(environ: pytest.MonkeyPatch) -> None:
    for name in (*(other.name for other in OTHERS), "GAITWAY_PARENT", "GAITWAY_STACK_ID"):
        if name != "GAITWAY_SECRETS_DIR":
            environ.setenv(name, "1")
    environ.setenv("GAITWAY_API_SERVICE_HOST", "10.0.0.1")  # what Kubernetes tells every container
    environ.setenv("GAITWAY_PORT", "tcp://10.0.0.1:8000")
    read(ApiSettings)


def test_half_a_key_for_workers_is_refused(environ: pytest.MonkeyPatch) -> None:
    environ.setenv("GAITWAY_WORKER_S3_ACCESS_KEY", "worker")
    with pytest.raises(Misconfigured, match="GAITWAY_WORKER_S3_SECRET_KEY go together"):
        read(ApiSettings)


def test_a_half_life_is_at_least_an_hour(environ: pytest.MonkeyPatch) -> None:
    environ.setenv("GAITWAY_SHARE_HALF_LIFE", "60")
    assert "GAITWAY_SHARE_HALF_LIFE is wrong" in refusal(ReconcilerSettings)
    environ.setenv("GAITWAY_SHARE_HALF_LIFE", "P7D")
    assert read(ReconcilerSettings).share_half_life == timedelta(days=7)


def test_a_reconciler_that_looks_too_seldom_is_refused(environ: pytest.MonkeyPatch) -> None:
    environ.setenv("GAITWAY_RECONCILE_EVERY", "10")
    assert "GAITWAY_RECONCILE_EVERY (10 s), or no lease ever runs out" in refusal(ReconcilerSettings)


@pytest.mark.parametrize(("value", "seconds"), [("90", 90), ("0.5", 0.5), ("PT1M30S", 90)])
def test_a_duration_is_seconds_or_iso_8601(value: str, seconds: float, environ: pytest.MonkeyPatch) -> None:
    environ.setenv("GAITWAY_LEASE", "600")
    environ.setenv("GAITWAY_RECONCILE_EVERY", value)
    assert read(ReconcilerSettings).reconcile_every.total_seconds() == seconds


def test_a_file_holds_a_setting_and_a_variable_wins(environ: pytest.MonkeyPatch, tmp_path: Path) -> None:
    environ.delenv("GAITWAY_S3_SECRET_KEY")
    (tmp_path / "gaitway_s3_secret_key").write_text("from a file\n")
    (tmp_path / "gaitway_s3_endpoint").write_text("elsewhere:1")
    environ.setenv("GAITWAY_SECRETS_DIR", str(tmp_path))
    settings = read(ApiSettings)
    assert settings.s3_secret_key.get_secret_value() == "from a file"
    assert settings.s3_endpoint == "objects:8333"


@pytest.mark.parametrize(
    ("name", "url"),
    [
        ("GAITWAY_REDIS_URL", "http://:hunter2@records"),
        ("GAITWAY_REDIS_URL", "redis://:a[hunter2]b@records"),
        ("GAITWAY_REDIS_URL", "redis://:hunter2]@x"),
        ("GAITWAY_DATABASE_URL", "mysql://gaitway:hunter2@records/gaitway"),
        ("GAITWAY_DATABASE_URL", "gaitway:hunter2@records/gaitway"),
    ],
)
def test_a_secret_is_in_no_sentence(name: str, url: str, environ: pytest.MonkeyPatch) -> None:
    environ.setenv(name, url)
    assert name in refusal()
    assert "hunter2" not in refusal()


@pytest.mark.parametrize("scheme", ["postgresql", "postgres"])
def test_the_address_of_the_record_is_kept_as_it_is_and_out_of_sight(
    scheme: str, environ: pytest.MonkeyPatch
) -> None:
    url = f"{scheme}://gaitway:hunter2@record/gaitway?sslmode=verify-full"
    environ.setenv("GAITWAY_DATABASE_URL", url)
    settings = read(ApiSettings)
    assert settings.database_url.get_secret_value() == url
    assert "hunter2" not in repr(settings)


def test_a_misconfigured_process_ends_with_its_own_status(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end, stopping_if_misconfigured():
        raise Misconfigured("GAITWAY_X is wrong.")
    assert end.value.code == EXIT_STATUS
    assert "GAITWAY_X is wrong." in capsys.readouterr().out


@pytest.mark.parametrize("kind", [ApiSettings, WorkerSettings, ReconcilerSettings])
def test_every_setting_says_what_it_means(kind: type[BaseSettings]) -> None:
    assert [name for name, field in kind.model_fields.items() if not field.description] == []


def test_the_page_is_the_one_that_the_settings_make() -> None:
    assert (ROOT / "docs" / "settings.md").read_text() == page(), (
        "python -m gaitway.service.settings_page > docs/settings.md"
    )


def test_the_page_names_every_variable() -> None:
    assert [name for name in names() | {other.name for other in OTHERS} if f"`{name}`" not in page()] == []


def test_a_variable_is_its_fields_name_in_capitals() -> None:
    assert variable("s3_bucket") == "GAITWAY_S3_BUCKET"
