"""The settings of a worker that joins by a token."""

import re
from ipaddress import ip_address
from urllib.parse import urlsplit

from fastapi import APIRouter
from pydantic import SecretStr

from api.dependencies import ServiceDep
from api.problems import refusals
from api.routes.accounts import ACCOUNTS_ON, AccountsOff
from core.errors import Conflict
from core.settings import ApiSettings
from core.variables import variable
from gaitway.schema import WorkerSettingsView

router = APIRouter(tags=["accounts"])

# Our own settings add it; the worker has another path.
_PATH_OF_AUTHORITY = re.compile(r"[?&]ssl_ca_certs=[^&]*$")


class StoresOutOfReach(Conflict):
    """The stores listen where workers on other machines cannot reach them."""

    code = "stores-out-of-reach"
    title = "Workers cannot reach the stores"


@router.get(
    "/workers/settings",
    dependencies=ACCOUNTS_ON,
    responses=refusals(AccountsOff, StoresOutOfReach),
)
def read_worker_settings(service: ServiceDep) -> WorkerSettingsView:
    """The variables under which a worker finds the stores; for tokens of the scope `worker` alone.

    Its user of PostgreSQL has rights on the tables of jobs, and none on users, tokens and the audit log.
    """
    settings = service.settings
    database, redis = settings.worker_database_url, settings.worker_redis_url or settings.redis_url
    endpoint = settings.worker_s3_endpoint or settings.s3_endpoint
    if database is None:
        raise StoresOutOfReach(
            f"Workers join by a token where {variable('worker_database_url')} is set for the API and the "
            "reconciler; docs/teams.md says how."
        )
    for field, host in (
        ("worker_database_url", _host(database)),
        ("worker_redis_url", _host(redis)),
        ("worker_s3_endpoint", urlsplit(f"//{endpoint}").hostname),
    ):
        if _is_of_this_machine(host):
            raise StoresOutOfReach(
                f"A store listens at {host or 'a socket'}, which no other machine reaches: set "
                f"{variable(field)} to its address for others, or give the worker its settings by hand."
            )
    found = {
        "database_url": database.get_secret_value(),
        "redis_url": _PATH_OF_AUTHORITY.sub("", redis.get_secret_value()),
        "s3_endpoint": endpoint,
        **_s3(settings),
    }
    authority = settings.worker_tls_ca or settings.tls_ca
    return WorkerSettingsView(
        variables={variable(field): value for field, value in found.items()},
        tls_ca=None if authority is None else authority.read_text(),
    )


def _s3(settings: ApiSettings) -> dict[str, str]:
    is_secure = settings.s3_secure if settings.worker_s3_secure is None else settings.worker_s3_secure
    found = {
        "s3_access_key": settings.worker_s3_access_key or settings.s3_access_key,
        "s3_secret_key": (settings.worker_s3_secret_key or settings.s3_secret_key).get_secret_value(),
        "s3_bucket": settings.s3_bucket,
        "s3_secure": str(is_secure).lower(),
        "s3_style": settings.s3_style,
        "redis_without_password": str(settings.redis_without_password).lower(),
    }
    return found if settings.s3_region is None else {**found, "s3_region": settings.s3_region}


def _host(address: SecretStr) -> str | None:
    """None for a socket."""
    parts = urlsplit(address.get_secret_value())
    return None if parts.scheme == "unix" else parts.hostname


def _is_of_this_machine(host: str | None) -> bool:
    try:
        return host is None or ip_address(host).is_loopback or ip_address(host).is_unspecified
    except ValueError:
        return host == "localhost"
