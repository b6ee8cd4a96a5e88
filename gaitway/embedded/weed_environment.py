"""What a SeaweedFS of ours is told through its environment, on this machine and in a container."""

from collections.abc import Callable

REGION = "us-east-1"

# Its inner ports are open to whoever reaches them; these keys shut the HTTP ones to all but itself.
_DOORS = ("JWT_SIGNING", "JWT_SIGNING_READ", "JWT_FILER_SIGNING", "JWT_FILER_SIGNING_READ")


def weed_environment(access_key: str, secret_key: str, inner_key: Callable[[], str]) -> dict[str, str]:
    """Keys that no list of processes shows. inner_key: asked once for each of its doors."""
    return {
        "AWS_ACCESS_KEY_ID": access_key,
        "AWS_SECRET_ACCESS_KEY": secret_key,
        **{f"WEED_{door}_KEY": inner_key() for door in _DOORS},
    }
