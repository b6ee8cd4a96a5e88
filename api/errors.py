"""Refusals that only the HTTP edge knows; their status is part of what they are."""

from collections.abc import Sequence
from typing import ClassVar

from core.errors import GaitwayError, Problem


class EdgeError(GaitwayError):
    """A refusal for the way in which something was asked."""

    status: ClassVar[int] = 400
    code = "bad-request"
    title = "Not asked in a way that can be answered"

    @property
    def headers(self) -> dict[str, str]:
        """What the answer says besides its body."""
        return {}


class RouteNotFound(EdgeError):
    """No resource lives at this address; /docs lists those there are."""

    status = 404
    code = "route-not-found"
    title = "Nothing at this address"


class MethodNotAllowed(EdgeError):
    """The resource exists, but does not understand this method; the header Allow names those it does."""

    status = 405
    code = "method-not-allowed"
    title = "Not with this method"

    def __init__(self, method: str, allowed: str) -> None:
        super().__init__(f"This address does not take {method}; it takes {allowed}.", allowed=allowed)
        self._allowed = allowed

    @property
    def headers(self) -> dict[str, str]:
        return {"Allow": self._allowed}


class MalformedBody(EdgeError):
    """The body is not a JSON document; the sentence says at which line and column reading stopped."""

    status = 400
    code = "malformed-body"
    title = "The body is not JSON"

    def __init__(self, why: str) -> None:
        super().__init__(f"The body is not a JSON document: {why}.")
        self.problems = (Problem("", self.detail),)


class BodyTooLarge(EdgeError):
    """The body is longer than this service reads."""

    status = 413
    code = "body-too-large"
    title = "The body is too large"

    def __init__(self, limit: int) -> None:
        super().__init__(f"The body is longer than {limit:,} bytes.", limit_bytes=limit)

    @property
    def headers(self) -> dict[str, str]:
        return {"Connection": "close"}


class UnsupportedMediaType(EdgeError):
    """A job is sent as application/json, a model as application/xml or application/zip."""

    status = 415
    code = "unsupported-media-type"
    title = "Not a media type this address reads"

    def __init__(
        self, media_type: str, *, what: str = "the job", accepted: Sequence[str] = ("application/json",)
    ) -> None:
        sent = f"{media_type[:100]!r}" if media_type else "no Content-Type"
        super().__init__(f"Send {what} as {' or '.join(accepted)}; this request has {sent}.")
        self._accepted = accepted

    @property
    def headers(self) -> dict[str, str]:
        return {"Accept-Post": ", ".join(self._accepted)}


class TooManyModels(EdgeError):
    """As many models as GAITWAY_MAX_WAITING_MODELS allows are on their way in, or wait for a worker to look
    at them. Workers do that when no job waits."""

    status = 429
    code = "too-many-models"
    title = "Too many models wait already"

    def __init__(self, most: int) -> None:
        super().__init__(
            f"{most} models wait until a worker has no job and looks at them, which is the most; send this "
            "one later.",
            most=most,
        )

    @property
    def headers(self) -> dict[str, str]:
        return {"Retry-After": "30"}


class RangeNotSatisfiable(EdgeError):
    """The file ends before the range begins; the header Content-Range says how long it is."""

    status = 416
    code = "range-not-satisfiable"
    title = "The range lies outside the file"

    def __init__(self, size: int) -> None:
        super().__init__(f"The range begins after the end of the file, which has {size:,} bytes.", size=size)
        self._size = size

    @property
    def headers(self) -> dict[str, str]:
        return {"Content-Range": f"bytes */{self._size}"}


class UnknownHost(EdgeError):
    """The request names a host that is not this service's: a page of another site may have given its own name
    to this address. GAITWAY_ALLOWED_HOSTS lists further names."""

    status = 421
    code = "unknown-host"
    title = "Not a name of this service"

    def __init__(self, host: str) -> None:
        super().__init__(
            f"This service does not answer as {host[:100]!r}. If that is its name, add it to "
            "GAITWAY_ALLOWED_HOSTS where it is started."
        )


class CrossSiteRequest(EdgeError):
    """A page of another site asked a browser to change something here."""

    status = 403
    code = "cross-site-request"
    title = "Not from another site"


class UnexpectedError(EdgeError):
    """A defect of the service. Its log has the details under the same correlation id."""

    status = 500
    code = "unexpected-error"
    title = "The service failed"

    def __init__(self, correlation_id: str) -> None:
        super().__init__(
            "The service failed at this request; its log says why, under this correlation id.",
            correlation_id=correlation_id,
        )
