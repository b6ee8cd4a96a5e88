"""Errors of the client, with messages for people.

GaitwayError
├── ApiError           the service answered with a problem (RFC 9457)
│   ├── NotFound       what was named does not exist
│   │   └── NotReady   it may come: try again after `retry_after_s`
│   ├── Conflict       it exists, but not in a state that allows this
│   ├── Rejected       the request itself is wrong; `errors` say where
│   │   ├── Unauthenticated  the service wants a token, or no longer accepts this one
│   │   └── Forbidden        token, role or ownership do not allow it
│   └── Unavailable    try again after `retry_after_s`
├── WrongAddress       the service's address is not one of HTTP
├── Unreachable        no service answers
├── WaitTimeout        the job has not ended in the time given
├── DownloadFailed     a file could not be brought whole
├── PolicyUnreadable   a policy's file is damaged, or this version does not know its format
├── UnsafeFile         others can read the file with this user's tokens, or it is damaged
└── MissingExtra       a part of the package is not installed
"""

from collections.abc import Generator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, cast

if TYPE_CHECKING:
    import httpx


@dataclass(frozen=True)
class FieldError:
    """One offending place in what was sent: a JSON pointer (RFC 6901) and a sentence."""

    pointer: str
    detail: str


class GaitwayError(Exception):
    """Base of all errors of the client."""


class ApiError(GaitwayError):
    """The service answered with a problem. `facts` holds all its members."""

    def __init__(self, status: int, problem: Mapping[str, Any], retry_after_s: float | None = None) -> None:
        self.status = status
        self.type = str(problem.get("type", "about:blank"))
        self.title = str(problem.get("title", f"HTTP {status}"))
        self.detail = str(problem.get("detail") or self.title)
        self.errors = _field_errors(problem.get("errors"))
        self.retry_after_s = retry_after_s
        self.facts = dict(problem)
        super().__init__(self.detail)

    def __str__(self) -> str:
        # `detail` has already said what is wrong with the request as a whole.
        told = [one for one in self.errors if one.pointer or one.detail not in self.detail]
        return "\n".join([self.detail, *map(self._place, told)])

    def _place(self, error: FieldError) -> str:
        """Where it is, and what is wrong there unless `detail` has said so already."""
        pointer = error.pointer or "/"
        return f"  at {pointer}" if error.detail in self.detail else f"  {pointer}: {error.detail}"


class NotFound(ApiError):
    """404, 410."""


class NotReady(NotFound):
    """404 with Retry-After: the job that makes it has not ended."""


class Conflict(ApiError):
    """409, 412."""


class Rejected(ApiError):
    """400, 413, 415, 422 and every other refusal of the request itself."""


class Unauthenticated(Rejected):
    """401: the service has accounts, and the request had no token that it accepts."""


class Forbidden(Rejected):
    """403: the token's scope, its user's role or somebody else's ownership does not allow it."""


class Unavailable(ApiError):
    """429, 502, 503, 504."""


class Unreachable(GaitwayError):
    """Nothing answered at the address, or the connection broke each time."""

    def __init__(self, url: str, why: str) -> None:
        super().__init__(
            f"No Gaitway service answers at {url} ({why}); `gaitway up` starts one, in a clone `./run up`."
        )
        self.url = url


class WrongAddress(GaitwayError, ValueError):
    """The service's address is not one of HTTP."""

    def __init__(self, url: str) -> None:
        super().__init__(f"{url} is no address of a service: begin it with http:// or https://.")


class WaitTimeout(GaitwayError, TimeoutError):
    """Only the wait has ended; the job continues."""


class DownloadFailed(GaitwayError):
    """The bytes received are not those that the service announced."""


class PolicyUnreadable(GaitwayError):
    """The file is damaged, or of an algorithm or a format that this version of the client does not know."""


class UnsafeFile(GaitwayError):
    """The file of `gaitway login` cannot be used; the message says what to do."""


class MissingExtra(GaitwayError, ImportError):
    """Needs an optional part of the package."""


def is_refusal(response: "httpx.Response") -> bool:
    """Whether it is a problem, whose body tells more."""
    return not response.is_success and response.status_code != 304


@contextmanager
def reachable(url: str) -> Generator[None]:
    """Raises Unreachable for whatever keeps an answer from coming."""
    import httpx  # The API has these errors, too, and no need of httpx, which takes 7 MB.

    try:
        yield
    except (httpx.TransportError, httpx.StreamError) as error:
        raise Unreachable(url, str(error) or type(error).__name__) from error
    except (httpx.InvalidURL, httpx.TooManyRedirects, httpx.DecodingError) as error:
        raise Unreachable(url, str(error)) from error


def problem_of(response: "httpx.Response") -> ApiError:
    """The error for an answer with status ≥ 400; its body must have been read."""
    retry_after_s = retry_after(response)
    family = _family(response.status_code, retry_after_s)
    return family(response.status_code, _document(response), retry_after_s)


def retry_after(response: "httpx.Response") -> float | None:
    """The seconds of a Retry-After header; None where there is none or it is a date."""
    try:
        return max(0.0, float(response.headers["Retry-After"]))
    except (KeyError, ValueError):
        return None


def _family(status: int, retry_after_s: float | None) -> type[ApiError]:
    if status in (404, 410):
        return NotFound if retry_after_s is None else NotReady
    if status in (401, 403):
        return Unauthenticated if status == 401 else Forbidden
    if status in (409, 412):
        return Conflict
    if status in (429, 502, 503, 504):
        return Unavailable
    return Rejected if 400 <= status < 500 else ApiError


def _document(response: "httpx.Response") -> Mapping[str, Any]:
    try:
        document: Any = response.json()
    except ValueError:
        document = None
    if isinstance(document, dict):
        return cast("dict[str, Any]", document)
    # A proxy's page, or another kind of service: its first line is the best message there is.
    text = response.text.strip().partition("\n")[0][:200] or "no body"
    return {"detail": f"HTTP {response.status_code} from {response.request.url}: {text}"}


def _field_errors(errors: Any) -> Sequence[FieldError]:
    if not isinstance(errors, list):
        return ()
    entries = [
        cast("dict[str, Any]", error) for error in cast("list[Any]", errors) if isinstance(error, dict)
    ]
    return tuple(FieldError(str(entry.get("pointer", "")), str(entry.get("detail", ""))) for entry in entries)
