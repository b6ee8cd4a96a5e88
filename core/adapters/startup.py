"""What a process makes sure of before it works: that both stores do what it will ask of them."""

import secrets

import structlog

from core.adapters.connect import job_store, object_store
from core.errors import Misconfigured, RecordsRefuse, StorageRefuses, Unavailable
from core.patience import through_outages
from core.settings import StoreSettings
from core.storage.objects import ObjectStore

log = structlog.get_logger()

_PATIENCE_S = 10.0


def check_stores(settings: StoreSettings, patience_s: float = _PATIENCE_S) -> None:
    """Return when both stores serve, or have been away for so long: what is away may come back.

    Raises Misconfigured where one answers and refuses: time alone will not mend that.
    """
    records, objects = job_store(settings), object_store(settings)
    for name, look in (("redis", records.ping), ("object_store", lambda: exercise(objects))):
        try:
            through_outages(look, patience_s, gives_up_on=(RecordsRefuse, StorageRefuses))
        except (RecordsRefuse, StorageRefuses) as error:
            raise Misconfigured(error.detail) from error
        except Unavailable as error:
            log.warning("store_away_at_start", store=name, error=error.detail)


def exercise(objects: ObjectStore) -> None:
    """Put, get and delete an object. Raises StorageUnavailable, or StorageRefuses naming a setting."""
    key = f"probes/{secrets.token_hex(8)}"
    objects.put(key, b"whether this bucket keeps what it is given")
    objects.get(key)
    objects.delete_prefix(key)
