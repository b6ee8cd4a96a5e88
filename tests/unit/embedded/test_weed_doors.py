"""What another user of this machine, who reaches every port, gets out of SeaweedFS without a key: nothing."""

import os
import shutil
import socket
import ssl
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest

from core.adapters.s3.connection import connect_s3
from core.adapters.s3.objects import S3ObjectStore
from gaitway.service.embedded.weed import REGION, Weed

KEY, BODY = "models/secret/source", b"nobody else's"
# As weed.py has them, each with its gRPC behind it.
S3, MASTER, VOLUME, FILER, ADMIN = range(0, 10, 2)


@pytest.fixture(scope="module")
def weed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Weed]:
    with Weed(tmp_path_factory.mktemp("weed")) as weed:
        yield weed


@pytest.fixture(scope="module")
def store(weed: Weed) -> S3ObjectStore:
    client = connect_s3(weed.endpoint, weed.access_key, weed.secret_key, secure=False, region=REGION)
    store = S3ObjectStore(client, weed.bucket)
    store.put(KEY, BODY)
    return store


def port(weed: Weed, listener: int) -> int:
    return weed._ports[listener]


MASTERS_PATHS = (
    *("/dir/status", "/dir/assign", "/dir/lookup?volumeId=1", "/vol/status", "/cluster/status", "/"),
    # Without the certificate, this would remove every byte of the bucket.
    "/col/delete?collection=gaitway",
)
OTHERS_PATHS = (
    "/",
    "/1,01637037d6",
    f"/buckets/gaitway/{KEY}",
    "/buckets/gaitway/?pretty=y",
    f"/gaitway/{KEY}",
)


def test_the_master_speaks_to_whoever_has_its_certificate_alone(weed: Weed, store: S3ObjectStore) -> None:
    address = f"127.0.0.1:{port(weed, MASTER)}"
    for path in MASTERS_PATHS:
        assert httpx.get(f"http://{address}{path}", trust_env=False).status_code == 400, path
        with pytest.raises(httpx.TransportError):
            httpx.get(f"https://{address}{path}", trust_env=False, verify=False)  # noqa: S501
    assert store.get(KEY) == BODY


@pytest.mark.parametrize("listener", [VOLUME, FILER, S3, ADMIN])
def test_the_other_parts_do_nothing_without_a_signature(
    listener: int, weed: Weed, store: S3ObjectStore
) -> None:
    with httpx.Client(base_url=f"http://127.0.0.1:{port(weed, listener)}", trust_env=False) as anybody:
        for path in OTHERS_PATHS:
            for method in ("GET", "PUT", "POST", "DELETE"):
                answer = anybody.request(method, path)
                assert answer.status_code in (400, 401, 403, 404, 405), (method, path, answer.text)
                assert BODY not in answer.content
    assert store.get(KEY) == BODY


def shell(weed: Weed, commands: str, **environ: str) -> str:
    """The answer of SeaweedFS's own client for gRPC."""
    binary = shutil.which("weed", path=str(Path(sys.executable).parent) + os.pathsep + os.environ["PATH"])
    master, filer = (f"127.0.0.1:{weed._ports[at]}.{weed._ports[at + 1]}" for at in (MASTER, FILER))
    with subprocess.Popen(
        [str(binary), "shell", f"-master={master}", f"-filer={filer}"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        env={"HOME": "/nowhere", **environ},
    ) as child:
        try:
            return child.communicate(f"{commands}\nexit\n".encode(), timeout=2)[0].decode()
        except subprocess.TimeoutExpired:
            child.kill()
            return child.communicate()[0].decode()


def test_grpc_is_closed_to_clients_without_the_certificate(weed: Weed, store: S3ObjectStore) -> None:
    look = f"fs.ls /buckets/gaitway\nfs.cat /buckets/gaitway/{KEY}"
    # With it, the same command sees what is there.
    ours = {
        name: value
        for name, value in weed._process_environment().items()
        if "GRPC" in name or "HTTPS" in name
    }
    assert "models" in shell(weed, look, **ours)
    theirs = shell(weed, look)
    assert "models" not in theirs.replace(look, "")
    assert BODY.decode() not in theirs


@pytest.mark.parametrize("listener", [S3, MASTER, VOLUME, FILER, ADMIN])
def test_every_grpc_port_asks_for_the_certificate(listener: int, weed: Weed) -> None:
    anybody = ssl.create_default_context()
    anybody.check_hostname, anybody.verify_mode = False, ssl.CERT_NONE
    anybody.set_alpn_protocols(["h2"])
    with (
        socket.create_connection(("127.0.0.1", weed._ports[listener + 1]), timeout=5) as plain,
        anybody.wrap_socket(plain) as secret,
        # TLS 1.3 tells a client that it lacks a certificate only when it listens.
        pytest.raises((ssl.SSLError, ConnectionError)),
    ):
        secret.recv(1000)


def test_its_sockets_in_tmp_belong_to_its_user_alone(weed: Weed) -> None:
    found = [path for one in weed._ports for path in Path("/tmp").glob(f"seaweedfs-*-{one}.sock")]
    assert found
    assert not [path for path in found if path.stat().st_mode & 0o022]


def test_its_certificate_is_made_once_and_its_key_is_for_its_owner(weed: Weed) -> None:
    certificate, key = weed._certificate_files()
    before = certificate.read_bytes()
    assert weed._certificate_files()[0].read_bytes() == before
    assert key.stat().st_mode & 0o077 == 0
