"""Refusals that exist only in HTTP; each class has its own status."""

from collections.abc import Sequence
from typing import ClassVar

from core.errors import GaitwayError, Problem


class EdgeError(GaitwayError):
    """A refusal of how a request was made."""

    status: ClassVar[int] = 400
    code = "bad-request"
    title = "Bad request"

    @property
    def headers(self) -> dict[str, str]:
        """The headers of the answer."""
        return {}


class RouteNotFound(EdgeError):
    """There is no resource at this address; /docs lists all of them."""

    status = 404
    code = "route-not-found"
    title = "Nothing at this address"


class MethodNotAllowed(EdgeError):
    """The resource exists but does not support this method; the header Allow lists those that it supports."""

    status = 405
    code = "method-not-allowed"
    title = "Method not allowed"

    def __init__(self, method: str, allowed: str) -> None:
        super().__init__(f"This address does not support {method}; it supports {allowed}.", allowed=allowed)
        self._allowed = allowed

    @property
    def headers(self) -> dict[str, str]:
        return {"Allow": self._allowed}


class MalformedBody(EdgeError):
    """The body is not a JSON document; `detail` gives the line and column of the error."""

    status = 400
    code = "malformed-body"
    title = "The body is not JSON"

    def __init__(self, why: str) -> None:
        super().__init__(f"The body is not a JSON document: {why}.")
        self.problems = (Problem("", self.detail),)


class BodyTooLarge(EdgeError):
    """The body is longer than this service accepts."""

    status = 413
    code = "body-too-large"
    title = "The body is too large"

    def __init__(self, limit: int) -> None:
        super().__init__(f"The body is longer than {limit:,} bytes.", limit_bytes=limit)

    @property
    def headers(self) -> dict[str, str]:
        return {"Connection": "close"}


class UnsupportedMediaType(EdgeError):
    """Send a job as application/json, a model as application/xml or application/zip, and an export as
    application/zip."""

    status = 415
    code = "unsupported-media-type"
    title = "Unsupported media type"

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
    """GAITWAY_MAX_WAITING_MODELS models are being uploaded or wait for validation. Workers validate models
    when no job waits."""

    status = 429
    code = "too-many-models"
    title = "Too many models are waiting"

    def __init__(self, most: int) -> None:
        super().__init__(
            f"{most} models, the maximum, wait for a worker that has no job and can validate them; send this "
            "one later.",
            most=most,
        )

    @property
    def headers(self) -> dict[str, str]:
        return {"Retry-After": "30"}


class TooManyImports(EdgeError):
    """Exports may be of gigabytes, and each waits on the disk of the API until it is imported."""

    status = 429
    code = "too-many-imports"
    title = "Too many exports are being imported"

    def __init__(self, most: int) -> None:
        super().__init__(f"{most} exports, the maximum, are being imported; send this one later.", most=most)

    @property
    def headers(self) -> dict[str, str]:
        return {"Retry-After": "5"}


class RangeNotSatisfiable(EdgeError):
    """The file ends before the range begins; the header Content-Range gives its length."""

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
    """The request's Host is not a name of this service: a page of another site may have pointed its own name
    to this address. GAITWAY_ALLOWED_HOSTS lists further names."""

    status = 421
    code = "unknown-host"
    title = "Unknown host"

    def __init__(self, host: str) -> None:
        super().__init__(
            f"This service does not answer as {host[:100]!r}. If that is its name, add it to "
            "GAITWAY_ALLOWED_HOSTS where it is started."
        )


class CrossSiteRequest(EdgeError):
    """A page of another site sent this request through a browser."""

    status = 403
    code = "cross-site-request"
    title = "Cross-site request"


class UnexpectedError(EdgeError):
    """A defect of the service. Its log has the details under the same correlation id."""

    status = 500
    code = "unexpected-error"
    title = "The service failed"

    def __init__(self, correlation_id: str) -> None:
        super().__init__(
            "The service failed on this request; its log has the reason under this correlation id.",
            correlation_id=correlation_id,
        )
