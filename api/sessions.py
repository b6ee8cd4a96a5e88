"""The page's session: a cookie, and what shows that the page itself sent a request that comes with it.

A browser adds the cookie to requests of other sites' pages, too, such as a form that is sent here. So a
request that changes something needs a header that only our page's script can set, and has to come from our
own origin as far as the browser says where it comes from. Before that, `api.app.OriginCheck` refuses foreign
origins.
"""

from datetime import timedelta

from fastapi import Request, Response

from api.problems import CrossSiteRequest
from core.accounts.tokens import SESSION, Secret, parse

HEADER = "X-Gaitway-Page"
_COOKIE = "gaitway_session"
# Browsers take a cookie of this prefix only over TLS, and from no other host of the domain.
_COOKIE_OVER_TLS = f"__Host-{_COOKIE}"
_ATTEMPT = "gaitway_sign_in"
_HARMLESS = ("GET", "HEAD")


def session_of(request: Request) -> Secret | None:
    """The session that the request's cookie holds; it is not checked yet."""
    text = request.cookies.get(_COOKIE_OVER_TLS) or request.cookies.get(_COOKIE)
    return None if text is None else parse(text, SESSION)


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
    return "https" in (request.url.scheme, request.headers.get("origin", "").partition(":")[0])


def keep(response: Response, session: Secret, lifetime: timedelta, *, over_tls: bool) -> None:
    """Have the browser keep the session, out of reach of scripts."""
    response.set_cookie(
        _COOKIE_OVER_TLS if over_tls else _COOKIE,
        session.text,
        max_age=int(lifetime.total_seconds()),
        secure=over_tls,
        httponly=True,
        samesite="lax",  # Links from elsewhere to a video work; forms and pictures there bring no cookie.
    )


def keep_attempt(response: Response, text: str, path: str, *, over_tls: bool) -> None:
    """Have the browser keep a sign-in that has begun at the identity provider, for ten minutes."""
    response.set_cookie(
        _ATTEMPT, text, max_age=600, path=path, secure=over_tls, httponly=True, samesite="lax"
    )


def attempt_of(request: Request) -> str:
    """What `keep_attempt` had the browser keep, or nothing."""
    return request.cookies.get(_ATTEMPT, "")


def forget_attempt(response: Response, path: str) -> None:
    """Each attempt is used once."""
    response.delete_cookie(_ATTEMPT, path=path, httponly=True, samesite="lax")


def forget(response: Response) -> None:
    """Have the browser drop the session."""
    response.delete_cookie(_COOKIE, httponly=True, samesite="lax")
    response.delete_cookie(_COOKIE_OVER_TLS, httponly=True, secure=True, samesite="lax")
