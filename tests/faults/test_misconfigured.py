"""What is wrong with the stores is said in one sentence: in a process' log, and by `gaitway doctor`."""

import json
import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from datetime import timedelta
from pathlib import Path
from typing import Any

import minio.time
import psutil
import pytest
from typer.testing import CliRunner

from core.configuration import names
from core.errors import EXIT_STATUS
from gaitway.cli.main import app
from gaitway.service.doctor import machine
from gaitway.service.doctor.check import Check
from tests.faults.forked import Forked, forked
from tests.faults.misconfigured_stores import SECRET, Stores, full_object_store, full_redis, serving
from worker import main as worker
from worker import reconciler

pytestmark = pytest.mark.skipif(
    shutil.which("openssl") is None, reason="no openssl to make certificates with"
)

# name: settings that differ from those that fit, the doctor's check, words of the sentence.
WRONG_SETTINGS = {
    "a wrong key": ({"S3_ACCESS_KEY": "nobody"}, "object store", "GAITWAY_S3_ACCESS_KEY is not known there"),
    "a wrong secret": (
        {"S3_SECRET_KEY": "guessed"},
        "object store",
        "GAITWAY_S3_SECRET_KEY does not belong to GAITWAY_S3_ACCESS_KEY",
    ),
    "no bucket": ({"S3_BUCKET": "elsewhere"}, "object store", "there is no bucket 'elsewhere': create it"),
    "no bucket, and no right to make one": (
        {"S3_BUCKET": "elsewhere", "S3_ACCESS_KEY": "writer"},
        "object store",
        "there is no bucket 'elsewhere': create it",
    ),
    "no right to write": (
        {"S3_ACCESS_KEY": "reader"},
        "object store",
        "GAITWAY_S3_ACCESS_KEY lacks a right in bucket 'gaitway'",
    ),
    "an impossible bucket": ({"S3_BUCKET": "a b c"}, "object store", "GAITWAY_S3_BUCKET is wrong"),
    "TLS where there is none": (
        {"S3_SECURE": "true"},
        "object store",
        "does not speak TLS: set GAITWAY_S3_SECURE=false",
    ),
    "no TLS where there is": ({"S3_ENDPOINT": "{https}"}, "object store", "GAITWAY_S3_SECURE=true"),
    "an unknown authority": (
        {"S3_ENDPOINT": "{https}", "S3_SECURE": "true"},
        "object store",
        "Let GAITWAY_TLS_CA name a file with the certificate of the authority",
    ),
    "a wrong password of PostgreSQL": (
        {"DATABASE_URL": "{pg_wrong}"},
        "postgresql",
        "The user or the password in GAITWAY_DATABASE_URL is wrong",
    ),
    "no password for PostgreSQL": (
        {"DATABASE_URL": "{pg_open}"},
        "postgresql",
        "GAITWAY_DATABASE_URL has no password and that PostgreSQL wants one",
    ),
    "no database": ({"DATABASE_URL": "{pg_elsewhere}"}, "postgresql", "has no database with the name"),
    "a user of PostgreSQL without rights": (
        {"DATABASE_URL": "{pg_reader}"},
        "postgresql",
        "The user of GAITWAY_DATABASE_URL may not use these tables",
    ),
    "TLS where PostgreSQL has none": (
        {"DATABASE_URL": "{pg_tls}"},
        "postgresql",
        "asks for TLS, which that PostgreSQL does not offer",
    ),
    "an unreadable address of PostgreSQL": (
        {"DATABASE_URL": f"postgresql://u:pass/{SECRET}@h/gaitway"},
        "postgresql",
        "GAITWAY_DATABASE_URL cannot be read",
    ),
    "no password": ({"REDIS_URL": "{redis}"}, "redis", "GAITWAY_REDIS_URL has no password"),
    "a wrong password": ({"REDIS_URL": "{wrong}"}, "redis", "the password in GAITWAY_REDIS_URL is wrong"),
    "a user who may only read": ({"REDIS_URL": "{reader}"}, "redis", "give that user `~* &* +@all`"),
    "an unreadable address": ({"REDIS_URL": "redis://:pass#word@h"}, "redis", "# is %23"),
    "an open door": (
        {"REDIS_URL": "redis://192.0.2.1:6379"},
        "settings",
        "GAITWAY_REDIS_URL names another machine and has no password",
    ),
}
FITTING = ("settings", "postgresql", "redis", "object store", "clock")


def an_hour_late() -> None:
    """A reconciler whose clock is wrong: what signs a request takes its time from there."""
    right = minio.time.utcnow
    minio.time.utcnow = lambda: right() + timedelta(hours=1)
    reconciler.main()


# name: the process, and settings that differ from those that fit.
REFUSED: dict[str, tuple[Callable[[], None], dict[str, str]]] = {
    **{name: (reconciler.main, changed) for name, (changed, _, _) in WRONG_SETTINGS.items()},
    "a worker": (worker.main, {"S3_ACCESS_KEY": "nobody"}),
    "a worker without its GPU": (worker.main, {"DEVICE": "gpu:99"}),
    "a late clock": (an_hour_late, {}),
}


@pytest.fixture(scope="module")
def stores(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stores]:
    with serving(tmp_path_factory.mktemp("misconfigured") / "stores") as found:
        yield found


def fit(environment: pytest.MonkeyPatch, stores: Stores, data: Path) -> None:
    """Put settings that fit into the environment, and no others."""
    for name in names():
        environment.delenv(name, raising=False)
    for name, value in {**stores.environment, "GAITWAY_DATA_DIR": str(data)}.items():
        environment.setenv(name, value)


def spoil(environment: pytest.MonkeyPatch, stores: Stores, changed: dict[str, str]) -> None:
    places = {
        "https": f"127.0.0.1:{stores.https_port}",
        "redis": stores.redis(""),
        "wrong": stores.redis(":guessed@"),
        "reader": stores.redis(f"reader:{SECRET}@"),
        "pg_wrong": stores.postgres("gaitway:guessed"),
        "pg_open": stores.postgres("gaitway"),
        "pg_elsewhere": stores.postgres(f"gaitway:{SECRET}", "elsewhere"),
        "pg_reader": stores.postgres(f"reader:{SECRET}"),
        "pg_tls": stores.postgres(f"gaitway:{SECRET}") + "?sslmode=require",
    }
    for setting, value in changed.items():
        environment.setenv(f"GAITWAY_{setting}", value.format_map(places))


Refused = dict[str, Forked]


@pytest.fixture(scope="module")
def refused(stores: Stores, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Refused]:
    """A process for each wrong setting, begun side by side: each takes seconds to believe what it finds."""
    processes: Refused = {}
    with ExitStack() as stack:
        for name, (main, changed) in REFUSED.items():
            with pytest.MonkeyPatch.context() as environment:
                fit(environment, stores, tmp_path_factory.mktemp("data"))
                spoil(environment, stores, changed)
                processes[name] = stack.enter_context(forked(main))
        yield processes


@pytest.fixture
def environment(stores: Stores, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> pytest.MonkeyPatch:
    """Settings that fit, in the environment. The doctor leaves out what takes long and is not the matter."""
    fit(monkeypatch, stores, tmp_path / "data")
    for name in ("jax_devices", "physics", "renderer", "encoder"):
        monkeypatch.setattr(machine, name, lambda: Check("left out", "skip", ""))
    return monkeypatch


def doctor() -> dict[str, dict[str, str]]:
    """The findings of `gaitway doctor`, by name."""
    result = CliRunner().invoke(app, ["doctor", "--json"])
    document = json.loads(result.stdout)
    assert document["ok"] == (result.exit_code == 0)
    return {check["name"]: check for check in document["checks"]}


def end_of(process: Forked) -> tuple[int, dict[str, Any]]:
    """Its exit status and the last line of its log."""
    status, log = process.end(timeout_s=60)
    assert SECRET not in log
    return status, json.loads(log.splitlines()[-1])


def test_what_fits_passes(environment: pytest.MonkeyPatch) -> None:
    found = doctor()
    assert {found[name]["state"] for name in FITTING} == {"pass"}


@pytest.mark.parametrize("name", WRONG_SETTINGS)
def test_a_process_ends_with_the_sentence_that_the_doctor_says(
    name: str, stores: Stores, refused: Refused, environment: pytest.MonkeyPatch
) -> None:
    changed, check, words = WRONG_SETTINGS[name]
    spoil(environment, stores, changed)
    finding = doctor()[check]
    status, line = end_of(refused[name])
    assert (status, line["event"]) == (EXIT_STATUS, "misconfigured")
    assert words in line["detail"]
    assert (finding["state"], finding["detail"]) == ("fail", line["detail"])


def test_a_worker_ends_with_the_same_sentence(refused: Refused) -> None:
    status, line = end_of(refused["a worker"])
    assert status == EXIT_STATUS
    assert "GAITWAY_S3_ACCESS_KEY is not known there" in line["detail"]


def test_a_worker_without_the_gpu_it_shall_run_on_ends_with_the_doctor_s_sentence(
    refused: Refused, environment: pytest.MonkeyPatch
) -> None:
    environment.setenv("GAITWAY_DEVICE", "gpu:99")
    finding = doctor()["device"]
    status, line = end_of(refused["a worker without its GPU"])
    assert status == EXIT_STATUS
    assert "GAITWAY_DEVICE=gpu:99" in line["detail"]
    assert (finding["state"], finding["detail"]) == ("fail", line["detail"])


def test_a_clock_that_is_an_hour_off_is_named(refused: Refused, environment: pytest.MonkeyPatch) -> None:
    right = minio.time.utcnow
    environment.setattr(minio.time, "utcnow", lambda: right() + timedelta(hours=1))
    finding = doctor()["object store"]
    status, line = end_of(refused["a late clock"])
    assert status == EXIT_STATUS
    assert "clock and the store's are more than 15 minutes apart" in line["detail"]
    assert "NTP" in line["detail"]
    assert (finding["state"], finding["detail"]) == ("fail", line["detail"])


def test_an_authority_of_one_s_own_is_trusted_by_name(
    stores: Stores, environment: pytest.MonkeyPatch
) -> None:
    environment.setenv("GAITWAY_S3_ENDPOINT", f"127.0.0.1:{stores.https_port}")
    environment.setenv("GAITWAY_S3_SECURE", "true")
    environment.setenv("GAITWAY_TLS_CA", str(stores.authority))
    found = doctor()
    assert [found[check]["state"] for check in ("object store", "clock")] == ["pass", "pass"]


def test_a_redis_in_protected_mode_is_named(environment: pytest.MonkeyPatch, stores: Stores) -> None:
    # It knows who comes from another address of this machine, and not from the loopback, as a stranger.
    addresses = [
        here.address for found in psutil.net_if_addrs().values() for here in found if here.family == 2
    ]
    outer = [address for address in addresses if not address.startswith("127.")]
    if not outer:
        pytest.skip("this machine has no address but the loopback's")
    from core.adapters.wiring import connect_redis

    environment.setenv("GAITWAY_REDIS_WITHOUT_PASSWORD", "true")
    environment.setenv("GAITWAY_REDIS_URL", f"redis://{outer[0]}:{stores.redis_port}")
    with connect_redis(stores.redis(f":{SECRET}@")) as client:
        client.config_set("requirepass", "")
        with forked(reconciler.main) as process:
            status, line = end_of(process)
        client.config_set("requirepass", SECRET)
    assert status == EXIT_STATUS
    assert "protected mode" in line["detail"]
    assert "requirepass" in line["detail"]


def first_words_of(process: Forked) -> str:
    """The sentence of the first line of the log; what is away may come back, so it does not end."""
    line = json.loads(process.log.readline())
    assert process.process.is_alive()
    assert SECRET not in line["error"]
    return line["error"]


@pytest.mark.parametrize(
    ("setting", "value", "check", "words"),
    [
        (
            "DATABASE_URL",
            "postgresql://u:w@127.0.0.1:1/gaitway",
            "postgresql",
            "PostgreSQL does not answer at GAITWAY_DATABASE_URL",
        ),
        ("REDIS_URL", "redis://127.0.0.1:1", "redis", "Redis does not answer at GAITWAY_REDIS_URL"),
        (
            "S3_ENDPOINT",
            "127.0.0.1:1",
            "object store",
            "127.0.0.1:1 (GAITWAY_S3_ENDPOINT): Connection refused",
        ),
    ],
)
def test_a_process_waits_for_a_store_where_nobody_answers_and_says_so(
    setting: str, value: str, check: str, words: str, environment: pytest.MonkeyPatch
) -> None:
    environment.setenv(f"GAITWAY_{setting}", value)
    with forked(reconciler.main) as process:
        finding = doctor()[check]
        sentence = first_words_of(process)
    assert words in sentence
    assert "Start it, or correct the setting." in sentence
    assert (finding["state"], finding["detail"]) == ("fail", sentence)


def test_a_full_object_store_is_named(environment: pytest.MonkeyPatch, tmp_path: Path) -> None:
    with full_object_store(tmp_path / "full") as settings:
        for name, value in settings.items():
            environment.setenv(name, value)
        with forked(reconciler.main) as process:
            finding = doctor()["object store"]
            sentence = first_words_of(process)
    assert "no room or no volume to write to: free or add disk space" in sentence
    assert (finding["state"], finding["detail"]) == ("fail", sentence)


def test_a_redis_whose_disk_is_full_is_named(environment: pytest.MonkeyPatch, tmp_path: Path) -> None:
    with full_redis(tmp_path / "full") as url:
        environment.setenv("GAITWAY_REDIS_URL", url)
        with forked(reconciler.main) as process:
            finding = doctor()["redis"]
            sentence = first_words_of(process)
    assert "cannot write its own files (MISCONF): free or add space on the volume" in sentence
    assert (finding["state"], finding["detail"]) == ("fail", sentence)


def test_nothing_is_left_in_the_bucket(stores: Stores, environment: pytest.MonkeyPatch) -> None:
    from core.adapters.wiring import object_store
    from core.configuration import read
    from core.settings import StoreSettings

    assert os.environ["GAITWAY_S3_ACCESS_KEY"] == "all"
    assert doctor()["object store"]["state"] == "pass"
    assert [found.key for found in object_store(read(StoreSettings)).list("probes/")] == []
