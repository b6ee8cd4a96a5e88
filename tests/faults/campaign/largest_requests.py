"""The largest accepted forms of each request in the OpenAPI document, with what they need.

`bench largest` measures them, and the campaign `largest` sends them beside trainings. A route without a form
here makes both fail.
"""

import fnmatch
import io
import json
import os
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any
from urllib.parse import quote
from zipfile import ZIP_STORED, ZipFile

import httpx

from api.routes.bulk import MOST_AT_ONCE
from api.sharing.importing import MOST_LINES, MOST_LOG_BYTES, MOST_VALUES
from api.submissions import MAX_OPTIONS_LENGTH
from core.bounds import LONGEST_NAME, LONGEST_NOTE, MOST_ATTEMPTS, MOST_IN_A_ROW
from core.news.webhook import EVENTS
from core.settings import ApiSettings
from core.sweeps.spec import MAX_TRIALS
from tests.faults.campaign.largest_import import Import

_LARGEST_BODY: int = ApiSettings.model_fields["max_body_bytes"].default
_LARGEST_MODEL: int = ApiSettings.model_fields["max_model_bytes"].default
_LARGEST_CLIPS: int = ApiSettings.model_fields["max_clips_bytes"].default
# A letter of four bytes.
_LETTER = "\N{MATHEMATICAL BOLD SMALL A}"
_JSON, _ZIP, _XML = "application/json", "application/zip", "application/xml"


@dataclass(frozen=True)
class Form:
    """A request. accepted: the statuses of its answer. content: of its body, or the file that holds it."""

    route: str
    what: str
    method: str
    path: str
    accepted: tuple[int, ...] = (200,)
    content: bytes | Path | None = None
    headers: Mapping[str, str] = field(default_factory=dict[str, str])

    def send(self, http: httpx.Client) -> int:
        """The bytes of the answer, which nobody keeps. Raises AssertionError where it is another."""
        content = self.content.open("rb") if isinstance(self.content, Path) else self.content
        with http.stream(self.method, self.path, content=content, headers=dict(self.headers)) as answer:
            if answer.status_code not in self.accepted:
                text = answer.read().decode(errors="replace")[:500]
                raise AssertionError(f"{self.route}, {self.what}: {answer.status_code} {text}")
            return sum(len(piece) for piece in answer.iter_raw())


@dataclass
class Service:
    """Where the forms are sent. Each route makes what it needs, by requests of its own before it is sent.

    share: of the largest sizes of imports and models, whose bounds are large. fill_sweep: gives a sweep the
    most trials.
    """

    http: httpx.Client
    folder: Path
    share: float = 1.0
    fill_sweep: Callable[[str], None] = lambda sweep_id: None

    def __post_init__(self) -> None:
        self._imports: dict[str, Path] = {}

    def parts(self, number: int) -> int:
        return max(1, int(self.share * number))

    def imports(self) -> dict[str, Import]:
        """By what is largest in it."""
        most = self.parts
        return {
            f"{most(MOST_VALUES):,} values in rows of {MOST_IN_A_ROW}": Import(
                rows=most(MOST_VALUES) // MOST_IN_A_ROW, names=MOST_IN_A_ROW
            ),
            f"{most(MOST_LINES):,} rows": Import(rows=most(MOST_LINES), names=3),
            f"{most(MOST_LINES):,} lines of log, {most(MOST_LOG_BYTES):,} bytes": Import(
                lines=most(MOST_LINES), line_bytes=MOST_LOG_BYTES // MOST_LINES - 1
            ),
            f"{most(5000):,} files": Import(files=most(5000)),
            f"{MOST_ATTEMPTS} attempts, a record of 1 MiB": Import(attempts=MOST_ATTEMPTS, is_long=True),
            f"files of {most(2**26):,} bytes": Import(file_bytes=most(2**26)),
        }

    def archive(self, what: str) -> Path:
        if what not in self._imports:
            path = self.folder / f"{len(self._imports)}.zip"
            self._imports[what] = self.imports()[what].write(path, largest_job())
        return self._imports[what]

    def imported(self, what: str) -> str:
        """The id of the job that came from this import."""
        headers = self.headers_of_import(what)
        return self._made_by("/jobs/import", self.archive(what), headers)

    def headers_of_import(self, what: str) -> dict[str, str]:
        """Whoever sends it again with its key gets the same job, until that is deleted."""
        key = f"{list(self.imports()).index(what)}".ljust(255, "i")
        return {"Content-Type": _ZIP, "Idempotency-Key": key}

    def new_import(self, what: str) -> str:
        return self._made_by("/jobs/import", self.archive(what), {"Content-Type": _ZIP})

    def job(self) -> str:
        """A new job that no worker here can take."""
        return self._made_by("/jobs", _json(largest_job()), {"Content-Type": _JSON})

    def sweep(self) -> str:
        """A new sweep with all its trials."""
        sweep_id = self._made_by("/sweeps", _json(largest_sweep()), {"Content-Type": _JSON})
        self.fill_sweep(sweep_id)
        return sweep_id

    def ended_sweep(self) -> str:
        self.cancel_sweep(sweep_id := self.sweep())
        return sweep_id

    def cancel_sweep(self, sweep_id: str) -> None:
        """Return when it has ended."""
        path = f"/sweeps/{sweep_id}"
        self.insist("POST", f"{path}/cancel")  # Refused where it has ended.
        while self.insist("GET", path).json()["status"] in ("running", "cancelling"):
            time.sleep(0.1)

    def model(self) -> str:
        return self._made_by("/models", largest_model(), {"Content-Type": _XML})

    def clips(self) -> str:
        return self._made_by("/clips?body=ant&rate=50", b"0", {"Content-Type": "application/octet-stream"})

    def _made_by(self, path: str, content: bytes | Path, headers: Mapping[str, str]) -> str:
        """The id of what this request makes. Raises AssertionError where it makes nothing."""
        answer = self.insist("POST", path, content, headers)
        if not answer.is_success:
            raise AssertionError(f"{path}: {answer.status_code} {answer.text[:500]}")
        return answer.json()["id"]

    def insist(
        self,
        method: str,
        path: str,
        content: bytes | Path | None = None,
        headers: Mapping[str, str] | None = None,
    ) -> httpx.Response:
        """The first answer that is no outage: a loaded machine's database may take too long."""
        while True:
            body = content.open("rb") if isinstance(content, Path) else content
            answer = self.http.request(method, path, content=body, headers=dict(headers or {}))
            if answer.status_code != 503:
                return answer
            time.sleep(0.2)


def routes(document: Mapping[str, Any]) -> list[str]:
    """As `GET /jobs`. Raises LookupError where one has no form here."""
    found = [f"{method.upper()} {path}" for path, methods in document["paths"].items() for method in methods]
    if without := sorted(set(found) - set(_FORMS)):
        raise LookupError(f"These routes have no largest form in {__name__}: {', '.join(without)}.")
    return found


def forms(service: Service, document: Mapping[str, Any], only: str = "*") -> Iterator[Form]:
    """Of every route of the document that matches the pattern. What a form needs is made before it is given.

    Raises LookupError as `routes` does.
    """
    wanted = fnmatch.filter(routes(document), only)
    # Each import is sent once, is read by every other route, and is deleted.
    for route in sorted(wanted, key=lambda one: (one.startswith("DELETE"), one != "POST /jobs/import")):
        yield from _FORMS[route](service, route)


Forms = Callable[[Service, str], Iterator[Form]]


@cache
def largest_job() -> dict[str, Any]:
    """A training with every list full; only a worker with 8 GPUs would take it."""
    bodies = ["torso", *(f"aux_{n}" for n in range(1, 5))]
    rules = [
        {"field": "body_mass", "names": bodies, "range": [0.9, 1.1], "draw": f"{n:03}{'d' * 197}"}
        for n in range(64)
    ]
    return {
        "kind": "train",
        "name": _LETTER * LONGEST_NAME,
        "note": _LETTER * LONGEST_NOTE,
        "labels": {f"{n:063}": _LETTER * LONGEST_NAME for n in range(62)},
        "environment": "ant",
        "randomization": rules,
        "resources": {"accelerator": "gpu", "gpus": 8},
        "video": {"cameras": ["track"], "show": ["joints", "contacts", "centre_of_mass", "transparent"]},
    }


@cache
def largest_sweep() -> dict[str, Any]:
    """A body of 1 MiB: axes of many values, and values of many bytes."""
    job = largest_job()
    fractions = [round(0.5 + n / 2500, 6) for n in range(MAX_TRIALS)]
    axes: dict[str, Any] = {
        f"algorithm.{name}": fractions
        for name in ("discounting", "gae_lambda", "learning_rate", "entropy_cost")
    }
    axes |= {f"environment.options.{name}": fractions for name in ("healthy_reward", "ctrl_cost_weight")}
    axes["seed"] = list(range(MAX_TRIALS))
    axes["timeout_s"] = [1000.0 + n for n in range(MAX_TRIALS)]
    # The settings of a trial have 2 KiB, which is the most for so many.
    axes["randomization"] = [
        [{**one, "range": [0.9, 1 + n / 100]} for one in job["randomization"][:5]] for n in range(60)
    ]
    sweep = {
        "job": job,
        "method": "random",
        "budget": {"jobs": MAX_TRIALS, "parallel": 1},
        "parameters": axes,
    }
    assert len(_json(sweep)) < _LARGEST_BODY
    return sweep


@cache
def largest_model() -> bytes:
    """A chain of bodies, as deep and as many as fit into a second of the validation."""
    legs = "".join(
        f'<body name="{n:04}{"b" * 90}" pos="0 0 .1"><joint name="j{n}" type="hinge" axis="0 1 0"/>'
        f'<geom name="g{n}" size=".02"/></body>'
        for n in range(100)
    )
    motors = "".join(f'<motor joint="j{n}"/>' for n in range(100))
    return (
        '<mujoco><worldbody><geom type="plane" size="9 9 1"/><body name="root" pos="0 0 1"><freejoint/>'
        f'<geom size=".1"/>{legs}</body></worldbody><actuator>{motors}</actuator></mujoco>'
    ).encode()


def _zip_of_a_model(size: int) -> bytes:
    """Of about this many bytes, of which a mesh takes nearly all. It is no mesh: a worker refuses it."""
    out = io.BytesIO()
    with ZipFile(out, "w", ZIP_STORED) as archive:
        archive.writestr("model.xml", b"<mujoco><asset><mesh file='m.stl'/></asset></mujoco>")
        archive.writestr("m.stl", os.urandom(size - 1000))
    return out.getvalue()


def _json(document: Any) -> bytes:
    return json.dumps(document, ensure_ascii=False, separators=(",", ":")).encode()


# ---- the forms of each route ------------------------------------------------------------------------


def _get(path: str, what: str = "", accepted: tuple[int, ...] = (200,)) -> Forms:
    def made(service: Service, route: str) -> Iterator[Form]:
        yield Form(route, what, "GET", path, accepted)

    return made


def _of_import(part: str) -> Forms:
    """Of the job of every import. part: behind the job's path."""

    def made(service: Service, route: str) -> Iterator[Form]:
        for what in service.imports():
            yield Form(route, what, "GET", f"/jobs/{service.imported(what)}{part}")

    return made


def _file(part: str) -> Forms:
    """Of the job that has large files."""

    def made(service: Service, route: str) -> Iterator[Form]:
        what = list(service.imports())[-1]
        yield Form(route, f"one of {what}", "GET", f"/jobs/{service.imported(what)}{part}")

    return made


def _submissions(service: Service, route: str) -> Iterator[Form]:
    headers = {"Content-Type": _JSON, "Idempotency-Key": "k" * 255}
    yield Form(route, "all lists full", "POST", "/jobs", (202,), _json(largest_job()), headers)
    padded = _json(largest_job()).ljust(_LARGEST_BODY)
    yield Form(route, "1 MiB", "POST", "/jobs", (202,), padded, {"Content-Type": _JSON})
    labels = {f"a b{n}": [{"c": n}] for n in range(64)}
    wrong = {**largest_job(), "labels": labels, "randomization": [{"names": ["n" * 200] * 80}] * 60}
    yield Form(route, "1 MiB, refused", "POST", "/jobs", (422,), _json(wrong), {"Content-Type": _JSON})


def _checks(service: Service, route: str) -> Iterator[Form]:
    for what, status, job in (("1 MiB", 200, largest_job()), ("1 MiB, refused", 422, {"name": "n" * 10**6})):
        body = _json(job).ljust(_LARGEST_BODY)
        yield Form(route, what, "POST", "/jobs/check", (status,), body, {"Content-Type": _JSON})


def _sweeps(service: Service, route: str) -> Iterator[Form]:
    headers = {"Content-Type": _JSON, "Idempotency-Key": "s" * 255}
    body = _json(largest_sweep()).ljust(_LARGEST_BODY)
    yield Form(route, "1 MiB, nine axes", "POST", "/sweeps", (202,), body, headers)
    axes = {f"a{n}": {f"b{k}": 0 for k in range(64)} for n in range(64)}
    wrong = _json({"job": largest_job(), "parameters": axes}).ljust(_LARGEST_BODY)
    yield Form(route, "1 MiB, refused", "POST", "/sweeps", (422,), wrong, {"Content-Type": _JSON})


def _of_sweep(
    method: str, part: str, status: int, *, is_ended: bool = False, body: bytes | None = None
) -> Forms:
    def made(service: Service, route: str) -> Iterator[Form]:
        sweep_id = service.ended_sweep() if is_ended else service.sweep()
        headers = {"Content-Type": _JSON} if body else {}
        what = f"{MAX_TRIALS - 1:,} trials"
        yield Form(route, what, method, f"/sweeps/{sweep_id}{part}", (status,), body, headers)

    return made


def _imports(service: Service, route: str) -> Iterator[Form]:
    for what in service.imports():
        headers, body = service.headers_of_import(what), service.archive(what)
        yield Form(route, what, "POST", "/jobs/import", (201,), body, headers)


def _models(service: Service, route: str) -> Iterator[Form]:
    name = f"name={quote(_LETTER * 100)}"
    body = _zip_of_a_model(service.parts(_LARGEST_MODEL))
    what = f"a zip of {len(body):,} bytes"
    # A worker refuses it, at once or later.
    yield Form(route, what, "POST", f"/models?{name}", (201, 202, 422), body, {"Content-Type": _ZIP})
    padded = largest_model().ljust(service.parts(_LARGEST_MODEL))
    what = f"XML of {len(padded):,} bytes"
    yield Form(route, what, "POST", f"/models?{name}", (201, 202, 422), padded, {"Content-Type": _XML})


def _deletions(service: Service, route: str) -> Iterator[Form]:
    for what in service.imports():
        yield Form(route, what, "DELETE", f"/jobs/{service.imported(what)}", (204,))


def _cancellation(service: Service, route: str) -> Iterator[Form]:
    yield Form(route, "", "POST", f"/jobs/{service.job()}/cancel", (200, 202))


def _of_model(method: str, status: int) -> Forms:
    def made(service: Service, route: str) -> Iterator[Form]:
        yield Form(route, "100 bodies", method, f"/models/{service.model()}", (status,))

    return made


_CLIPS = {"Content-Type": "application/octet-stream"}


def _clips(service: Service, route: str) -> Iterator[Form]:
    body = b"0" * service.parts(_LARGEST_CLIPS)
    path = f"/clips?body=ant&rate=50&name={quote(_LETTER * 100)}"
    # A worker refuses it, at once or later.
    yield Form(route, f"{len(body):,} bytes", "POST", path, (201, 202, 422), body, _CLIPS)


def _largest_name() -> bytes:
    return json.dumps({"name": _LETTER * 100}).encode().ljust(_LARGEST_BODY)


def _of_clips(method: str, part: str, status: int, body: bytes = b"") -> Forms:
    def made(service: Service, route: str) -> Iterator[Form]:
        path = f"/clips/{service.clips()}{part}"
        # Where a worker has refused them by now, there are none.
        yield Form(route, "", method, path, (status, 404), body, {"Content-Type": _JSON} if body else {})

    return made


def _listing_of_jobs(service: Service, route: str) -> Iterator[Form]:
    record = f"{MOST_ATTEMPTS} attempts, a record of 1 MiB"
    for _ in range(service.parts(40)):
        service.new_import(record)
    for _ in range(service.parts(200)):
        service.job()
    yield Form(route, "200 of the longest", "GET", "/jobs?limit=200")
    labels = "&".join(f"label={n:063}:{quote(_LETTER * LONGEST_NAME)}" for n in range(8))
    search = quote("z" * LONGEST_NAME)
    yield Form(route, "search and labels", "GET", f"/jobs?limit=200&search={search}&{labels}")


def _largest_patch() -> bytes:
    job = largest_job()
    document = {"name": job["name"], "labels": dict.fromkeys(job["labels"]), "note": _LETTER * LONGEST_NOTE}
    return _json(document).ljust(_LARGEST_BODY)


def _patch(service: Service, route: str) -> Iterator[Form]:
    path, headers = f"/jobs/{service.job()}", {"Content-Type": _JSON}
    yield Form(route, "1 MiB", "PATCH", path, (200,), _largest_patch(), headers)


def _many(path: str) -> Forms:
    """Of 200 jobs, that are deleted after they have been cancelled."""

    def made(service: Service, route: str) -> Iterator[Form]:
        jobs = [service.job() for _ in range(service.parts(MOST_AT_ONCE))]
        if path.endswith("delete"):
            service.insist("POST", "/jobs/cancel", _json({"jobs": jobs}), {"Content-Type": _JSON})
        body = _json({"jobs": jobs}).ljust(_LARGEST_BODY)
        yield Form(route, f"{len(jobs)} jobs", "POST", path, (200,), body, {"Content-Type": _JSON})

    return made


def _listing_of_sweeps(service: Service, route: str) -> Iterator[Form]:
    for _ in range(service.parts(10)):
        service.ended_sweep()
    yield Form(route, f"ten with {MAX_TRIALS - 1:,} trials", "GET", "/sweeps?limit=200")


def _metrics(service: Service, route: str) -> Iterator[Form]:
    for what in list(service.imports())[:2]:
        path = f"/jobs/{service.imported(what)}/metrics"
        yield Form(route, f"{what}, JSON", "GET", f"{path}?limit=100000")
        yield Form(route, f"{what}, CSV", "GET", f"{path}?format=csv")
        yield Form(route, f"{what}, 10,000 points", "GET", f"{path}?points=10000")


def _options() -> str:
    options = {"healthy_z_range": [0.2, 1.0], "healthy_reward": 0.5}
    return quote(json.dumps(options).ljust(MAX_OPTIONS_LENGTH))


def _preview(service: Service, route: str) -> Iterator[Form]:
    path = f"/environments/ant/preview?options={_options()}&camera=track&width=1920&height=1920"
    yield Form(route, "5,000 characters, 1920 x 1920 pixels", "GET", path, (200, 202, 503))


def _of_accounts(method: str, path: str, **document: Any) -> Forms:
    """A service without accounts refuses it, once it has read it."""

    def made(service: Service, route: str) -> Iterator[Form]:
        body = _json(document) if document else None
        headers = {"Content-Type": _JSON} if document else {}
        yield Form(route, "all lists full" if document else "", method, path, (409,), body, headers)

    return made


_RETENTION = "/projects/default/retention"


def _rules(method: str, part: str) -> Forms:
    def made(service: Service, route: str) -> Iterator[Form]:
        # Rules that never remove anything here: other requests read the files.
        rules = {"checkpoints": 1000, "videos_days": 3650, "failed_days": 3650}
        body = None if method == "DELETE" else _json(rules)
        headers = {"Content-Type": _JSON} if body else {}
        yield Form(route, "", method, f"{_RETENTION}{part}", (200, 204), body, headers)

    return made


_HOOKS = "/projects/default/webhooks"


def _webhook(service: Service, route: str) -> Iterator[Form]:
    # No news is of its jobs, and its name has no address.
    document = {"name": "h" * 63, "url": f"https://h.invalid/{'p' * 1900}", "jobs": "named"}
    yield Form(route, "", "POST", _HOOKS, (201, 409), _json(document), {"Content-Type": _JSON})


def _webhook_change(service: Service, route: str) -> Iterator[Form]:
    document = {"url": f"https://h.invalid/{'p' * 1900}", "events": [*EVENTS], "jobs": "all", "active": True}
    yield Form(route, "", "PATCH", f"{_HOOKS}/none", (404,), _json(document), {"Content-Type": _JSON})


def _resend(service: Service, route: str) -> Iterator[Form]:
    yield Form(route, "", "POST", f"/deliveries/{'9' * 18}/resend", (404,))


def _of_webhook(method: str, part: str) -> Forms:
    def made(service: Service, route: str) -> Iterator[Form]:
        yield Form(route, "", method, f"{_HOOKS}/none{part}", (404,))

    return made


def _quotas(service: Service, route: str) -> Iterator[Form]:
    limits = {"weight": 1e6, "running": 2**31 - 1, "queued": 2**31 - 1, "gpu_hours": 1e9, "bytes": 2**63 - 1}
    largest = {**limits, "highest_priority": "normal"}
    headers = {"Content-Type": _JSON}
    yield Form(route, "", "PUT", "/quotas/project/default", (200,), _json(largest), headers)


def _of_quota(service: Service, route: str) -> Iterator[Form]:
    yield Form(route, "", "DELETE", "/quotas/project/none", (404,))


_MEMBERS = [f"{n:063}" for n in range(1000)]
_FORMS: dict[str, Forms] = {
    "GET /whoami": _get("/whoami"),
    "GET /session": _get("/session"),
    "POST /session": _of_accounts("POST", "/session", token="t" * 200),
    "DELETE /session": _of_accounts("DELETE", "/session"),
    "POST /session/oidc": _of_accounts("POST", "/session/oidc", back=f"#/{'b' * 1998}"),
    "GET /projects": _get("/projects"),
    "POST /projects": _of_accounts("POST", "/projects", name="p" * 63),
    "PATCH /projects/{name}": _of_accounts("PATCH", "/projects/p", add=_MEMBERS, remove=_MEMBERS),
    "GET /projects/{project}/retention": _get(_RETENTION),
    "PUT /projects/{project}/retention": _rules("PUT", ""),
    "DELETE /projects/{project}/retention": _rules("DELETE", ""),
    "POST /projects/{project}/retention/preview": _rules("POST", "/preview?limit=200"),
    "GET /projects/{project}/webhooks": _get(_HOOKS),
    # Another of the same name is refused once it has been read.
    "POST /projects/{project}/webhooks": _webhook,
    "GET /projects/{project}/webhooks/{webhook}": _of_webhook("GET", ""),
    "PATCH /projects/{project}/webhooks/{webhook}": _webhook_change,
    "DELETE /projects/{project}/webhooks/{webhook}": _of_webhook("DELETE", ""),
    "POST /projects/{project}/webhooks/{webhook}/rotate": _of_webhook("POST", "/rotate"),
    "POST /projects/{project}/webhooks/{webhook}/test": _of_webhook("POST", "/test"),
    "GET /projects/{project}/webhooks/{webhook}/deliveries": _of_webhook("GET", "/deliveries?limit=200"),
    "POST /deliveries/{delivery_id}/resend": _resend,
    "GET /jobs/{job_id}/deliveries": _of_import("/deliveries?limit=200"),
    "GET /quotas": _get("/quotas"),
    "PUT /quotas/{kind}/{name}": _quotas,
    "DELETE /quotas/{kind}/{name}": _of_quota,
    "GET /workers/settings": _of_accounts("GET", "/workers/settings"),
    "GET /users": _of_accounts("GET", "/users"),
    "POST /users": _of_accounts("POST", "/users", name="u" * 63, projects=_MEMBERS[:100]),
    "PATCH /users/{name}": _of_accounts(
        "PATCH", "/users/u", role="viewer", active=False, subject="i#" + "s" * 598
    ),
    "GET /tokens": _of_accounts("GET", "/tokens"),
    "POST /tokens": _of_accounts("POST", "/tokens", scope="read", name="n" * 100),
    "DELETE /tokens/{token_id}": _of_accounts("DELETE", "/tokens/0"),
    "GET /audit": _of_accounts("GET", "/audit?limit=200"),
    "POST /jobs": _submissions,
    "POST /jobs/check": _checks,
    "GET /jobs": _listing_of_jobs,
    "GET /jobs/{job_id}": _of_import(""),
    "PATCH /jobs/{job_id}": _patch,
    "DELETE /jobs/{job_id}": _deletions,
    "POST /jobs/cancel": _many("/jobs/cancel"),
    "POST /jobs/delete": _many("/jobs/delete"),
    "POST /jobs/{job_id}/cancel": _cancellation,
    "GET /jobs/{job_id}/events": _of_import("/events?follow=false"),
    "GET /jobs/{job_id}/metrics": _metrics,
    "GET /jobs/{job_id}/logs": _of_import("/logs"),
    "GET /jobs/{job_id}/artifacts": _of_import("/artifacts"),
    "GET /jobs/{job_id}/checkpoints": _of_import("/checkpoints"),
    "GET /jobs/{job_id}/video": _file("/video"),
    "GET /jobs/{job_id}/poster": _file("/poster"),
    "GET /jobs/{job_id}/policy": _file("/policy"),
    "GET /jobs/{job_id}/checkpoints/{step}": _file("/checkpoints/1"),
    "GET /jobs/{job_id}/artifacts/{name}": _file("/artifacts/video"),
    "GET /jobs/{job_id}/replay": _file("/replay"),
    "GET /jobs/{job_id}/replay/scene": _file("/replay/scene"),
    "GET /jobs/{job_id}/simulation": _file("/simulation"),
    "GET /jobs/{job_id}/specification": _of_import("/specification"),
    "GET /jobs/{job_id}/export": _of_import("/export"),
    "POST /jobs/import": _imports,
    "GET /jobs/{job_id}/report.html": _of_import("/report.html"),
    "POST /sweeps": _sweeps,
    "GET /sweeps": _listing_of_sweeps,
    "GET /sweeps/{sweep_id}": _of_sweep("GET", "", 200),
    "PATCH /sweeps/{sweep_id}": _of_sweep("PATCH", "", 200, body=_largest_patch()),
    "DELETE /sweeps/{sweep_id}": _of_sweep("DELETE", "", 204, is_ended=True),
    "POST /sweeps/{sweep_id}/cancel": _of_sweep("POST", "/cancel", 202),
    "POST /sweeps/{sweep_id}/resume": _of_sweep(
        "POST", "/resume", 202, is_ended=True, body=b'{"budget": {"jobs": 1000}}'.ljust(_LARGEST_BODY)
    ),
    "POST /models": _models,
    "GET /models": _get("/models?limit=200"),
    "GET /models/{model_id}": _of_model("GET", 200),
    "DELETE /models/{model_id}": _of_model("DELETE", 204),
    "POST /clips": _clips,
    "GET /clips": _get("/clips?limit=200"),
    "GET /clips/{clips_id}": _of_clips("GET", "", 200),
    "GET /clips/{clips_id}/file": _of_clips("GET", "/file", 200),
    # No worker has made a replay of them.
    "GET /clips/{clips_id}/replay": _of_clips("GET", "/replay", 404),
    "GET /clips/{clips_id}/replay/scene": _of_clips("GET", "/replay/scene", 404),
    "PATCH /clips/{clips_id}": _of_clips("PATCH", "", 200, _largest_name()),
    "DELETE /clips/{clips_id}": _of_clips("DELETE", "", 204),
    "GET /environments/{environment_id}/preview": _preview,
    "GET /environments": _get("/environments"),
    "GET /environments/{environment_id}": _get(f"/environments/ant?options={_options()}", "5,000 characters"),
    "GET /environments/{package}/{name}": _get(f"/environments/brax/ant?options={quote('{}'.ljust(5000))}"),
    "GET /algorithms": _get("/algorithms"),
    "GET /workers": _get("/workers?limit=200"),
    "GET /metrics": _get("/metrics"),
    "GET /usage": _get("/usage?since=2026-01-01T00:00:00Z"),
    "GET /slots": _get("/slots?counted_as=gpu&accelerator=gpu&gpus=64"),
    "GET /healthz": _get("/healthz"),
    "GET /readyz": _get("/readyz"),
    "GET /problems/{code}": _get("/problems/job-not-found"),
}
