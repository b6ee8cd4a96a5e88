"""Access check for browsers: a page of another site may not read, submit or cancel anything.

There are no accounts. A foreign page is refused because its browser sends the page's origin (`Origin`,
`Sec-Fetch-Site`) and the host name that the page used (`Host`).
"""

from collections.abc import Collection
from dataclasses import dataclass
from ipaddress import ip_address
from urllib.parse import urlsplit

from starlette.datastructures import Headers
from starlette.types import Scope

from api.errors import CrossSiteRequest, EdgeError, UnknownHost

_FOREIGN = ("cross-site", "same-site")


@dataclass(frozen=True)
class OriginCheck:
    """allowed_hosts: names of this service, besides localhost and numeric addresses.

    If a foreign name resolves to this service (DNS rebinding), the browser takes that name's page and this
    service for one site. This cannot happen with a numeric address.
    """

    allowed_hosts: Collection[str] = ()

    def refusal(self, scope: Scope) -> EdgeError | None:
        """The refusal of this request, or None."""
        headers = Headers(scope=scope)
        host = headers.get("host", "")
        if not self._is_ours(_name(host)):
            return UnknownHost(_name(host))
        if self._is_foreign(headers.get("origin"), host) or _is_embedded(headers):
            return CrossSiteRequest("A page of another site may not use this service.")
        return None

    def _is_ours(self, name: str) -> bool:
        if name == "localhost" or name.endswith(".localhost") or name in self.allowed_hosts:
            return True
        try:
            ip_address(name)
        except ValueError:
            return False
        return True

    def _is_foreign(self, origin: str | None, host: str) -> bool:
        if origin is None:
            return False
        try:
            place = urlsplit(origin).netloc
        except ValueError:  # Not a URL.
            return True
        return place != host and _name(place) not in self.allowed_hosts


def _is_embedded(headers: Headers) -> bool:
    """Whether another site's page sent this in the background; following a link from there is allowed."""
    return headers.get("sec-fetch-site") in _FOREIGN and headers.get("sec-fetch-mode") != "navigate"


def _name(host: str) -> str:
    """The host without its port, in lower case."""
    try:
        return (urlsplit(f"//{host}").hostname or "").rstrip(".")
    except ValueError:
        return ""
