"""The environment variables of our SeaweedFS, on this machine and in a container."""

from collections.abc import Callable
from pathlib import PurePath

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
