"""How a node reaches the stores: through ssh, or as its user's machine does."""

import stat
from pathlib import Path

import pytest

from core.errors import Misconfigured
from worker.cluster.stores import StoresThere, is_local, through_tunnel, write_settings

LOCAL = {
    "GAITWAY_DATABASE_URL": "postgresql://gaitway_service:p%2Fw@/gaitway?host=%2Fd%2Fpostgres&port=5432",
    "GAITWAY_REDIS_URL": "unix:///d/valkey/valkey.sock",
    "GAITWAY_S3_ENDPOINT": "127.0.0.1:8333",
    "GAITWAY_S3_SECURE": "false",
}
REMOTE = {
    "GAITWAY_DATABASE_URL": "postgresql://me:pw@db.lab:5433/gaitway?sslmode=verify-full",
    "GAITWAY_REDIS_URL": "redis://:pw@redis.lab/0",
    "GAITWAY_S3_ENDPOINT": "s3.lab:9000",
    "GAITWAY_S3_SECURE": "false",
}


def test_sockets_and_loopback_are_forwarded_to_the_nodes_own() -> None:
    there = through_tunnel(StoresThere(LOCAL))
    assert there.settings == {
        "GAITWAY_DATABASE_URL": "postgresql://gaitway_service:p%2Fw@/gaitway?host=@FOLDER@&port=5432",
        "GAITWAY_REDIS_URL": "unix://@FOLDER@/redis.sock",
        "GAITWAY_S3_ENDPOINT": "127.0.0.1:@PORT0@",
        "GAITWAY_S3_SECURE": "false",
    }
    assert (there.forwards, there.ports) == (
        (
            "@FOLDER@/.s.PGSQL.5432:/d/postgres/.s.PGSQL.5432",
            "@FOLDER@/redis.sock:/d/valkey/valkey.sock",
            "127.0.0.1:@PORT0@:127.0.0.1:8333",
        ),
        1,
    )


def test_hosts_behind_the_login_node_are_forwarded_and_a_certificate_is_still_checked() -> None:
    there = through_tunnel(StoresThere(REMOTE))
    assert there.settings == {
        "GAITWAY_DATABASE_URL": (
            "postgresql://me:pw@db.lab/gaitway?sslmode=verify-full&hostaddr=127.0.0.1&port=@PORT0@"
        ),
        "GAITWAY_REDIS_URL": "redis://:pw@127.0.0.1:@PORT1@/0",
        "GAITWAY_S3_ENDPOINT": "127.0.0.1:@PORT2@",
        "GAITWAY_S3_SECURE": "false",
    }
    assert there.forwards == (
        "127.0.0.1:@PORT0@:db.lab:5433",
        "127.0.0.1:@PORT1@:redis.lab:6379",
        "127.0.0.1:@PORT2@:s3.lab:9000",
    )


@pytest.mark.parametrize(
    ("name", "value"), [("GAITWAY_REDIS_URL", "rediss://:pw@redis.lab/0"), ("GAITWAY_S3_SECURE", "true")]
)
def test_a_store_with_tls_is_not_reached_by_a_tunnel(name: str, value: str) -> None:
    with pytest.raises(Misconfigured, match="speaks TLS"):
        through_tunnel(StoresThere({**REMOTE, name: value}))


def test_local_stores_are_known_as_such() -> None:
    assert is_local(LOCAL)
    assert not is_local(REMOTE)
    assert is_local({**REMOTE, "GAITWAY_S3_ENDPOINT": "localhost:9000"})


def test_settings_are_files_that_only_their_user_reads(tmp_path: Path) -> None:
    folder = tmp_path / "settings"
    write_settings(folder, {"GAITWAY_A": "1", "GAITWAY_B": "2"})
    write_settings(folder, {"GAITWAY_A": "3"})
    (file,) = folder.iterdir()
    assert (file.name, file.read_text()) == ("gaitway_a", "3")
    assert [stat.S_IMODE(path.stat().st_mode) for path in (folder, file)] == [0o700, 0o600]
