"""The page's session: a cookie, and what shows that the page itself sent a request that comes with it.

A browser adds the cookie to requests of other sites' pages, too, such as a form that is sent here. So a
request that changes something needs a header that only our page's script can set, and has to come from our
own origin as far as the browser says where it comes from. Before that, `api.app.OriginCheck` refuses foreign
origins.
"""

from datetime import timedelta
from ipaddress import ip_address

from fastapi import Request, Response

from api.problems import CrossSiteRequest
from core.accounts.tokens import SESSION, Secret, parse

HEADER = "X-Gaitway-Page"
_COOKIE = "gaitway_session"
_ATTEMPT = "gaitway_sign_in"
# Browsers take a cookie of this prefix only over TLS, for all paths, and from no other host of the domain.
_OVER_TLS = "__Host-"
_HARMLESS = ("GET", "HEAD")


def session_of(request: Request) -> Secret | None:
    """The session that the request's cookie holds; it is not checked yet."""
    return parse(_cookie(request, _COOKIE), SESSION)


def _cookie(request: Request, name: str) -> str:
    """Its value, or nothing. Over TLS the plain name does not count: anybody on the network could set it."""
    plain = "" if is_over_tls(request) else request.cookies.get(name, "")
    return request.cookies.get(f"{_OVER_TLS}{name}", plain)


def check_sender(request: Request) -> None:
    """Raises CrossSiteRequest where the request changes something and our page has not sent it."""
    if request.method in _HARMLESS:
        return
    headers = request.headers
    # Browsers leave Sec-Fetch-Site out where the page has no TLS.
    is_own = (
        headers["sec-fetch-site"] == "same-origin" if "sec-fetch-site" in headers else "origin" in headers
    )
    if HEADER not in headers or not is_own:
        raise CrossSiteRequest(
            "A session changes things only for this service's own page; programs send a token: "
            "`Authorization: Bearer gaitway_…`."
        )


def is_over_tls(request: Request) -> bool:
    """Whether the browser speaks TLS, perhaps with a proxy that passes requests on without."""
    headers = request.headers
    if request.url.scheme == "https" or "origin" in headers:
        return "https" in (request.url.scheme, headers.get("origin", "").partition(":")[0])
    # A link's request has no origin. Browsers send Sec-Fetch-Site over TLS, and without it to this machine.
    return "sec-fetch-site" in headers and not _is_this_machine(request.url.hostname or "")


def _is_this_machine(host: str) -> bool:
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return host == "localhost" or host.endswith(".localhost")


def keep(response: Response, session: Secret, lifetime: timedelta, *, over_tls: bool) -> None:
    """Have the browser keep the session, out of reach of scripts."""
    response.set_cookie(
        f"{_OVER_TLS if over_tls else ''}{_COOKIE}",
        session.text,
        max_age=int(lifetime.total_seconds()),
        secure=over_tls,
        httponly=True,
        samesite="lax",  # Links from elsewhere to a video work; forms and pictures there bring no cookie.
    )


def keep_attempt(response: Response, text: str, *, over_tls: bool) -> None:
    """Have the browser keep a sign-in that has begun at the identity provider, for ten minutes."""
    name = f"{_OVER_TLS if over_tls else ''}{_ATTEMPT}"
    response.set_cookie(name, text, max_age=600, secure=over_tls, httponly=True, samesite="lax")


def attempt_of(request: Request) -> str:
    """The sign-in that `keep_attempt` left with the browser, or None."""
    return _cookie(request, _ATTEMPT)


def forget_attempt(response: Response) -> None:
    """Each attempt is used once."""
    _delete(response, _ATTEMPT)


def forget(response: Response) -> None:
    """Have the browser drop the session."""
    _delete(response, _COOKIE)


def _delete(response: Response, name: str) -> None:
    response.delete_cookie(name, httponly=True, samesite="lax")
    response.delete_cookie(f"{_OVER_TLS}{name}", httponly=True, secure=True, samesite="lax")
