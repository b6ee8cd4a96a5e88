"""What one can ask of a service, each as a call that `Client` and `AsyncClient` carry out (`gaitway.steps`).

Their methods have the names of these, and their descriptions stand in `Client`.
"""

import json
import shutil
import tempfile
import time
import uuid
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path, PurePosixPath
from typing import Any, TypeVar
from urllib.parse import quote
from zipfile import BadZipFile, ZipFile

import httpx
from pydantic import BaseModel

from gaitway import frames, notebook, policy
from gaitway.downloading import OnBytes, download, save
from gaitway.errors import NotFound, Rejected, WaitTimeout
from gaitway.following import follow_feed, follow_log
from gaitway.retry import Retry, request
from gaitway.steps import Call, Feed, Found, Request, Run, Sleep, read_through
from gaitway.sweep_views import SweepView
from gaitway.views import (
    ArtifactView,
    EnvironmentView,
    Event,
    JobView,
    MetricsRow,
    ModelView,
    Page,
    PreviewView,
    WorkerView,
)

AnyView = TypeVar("AnyView", bound=BaseModel)

_POLL_S = 0.5
_PAGE = 100
# Far beyond what a service takes: what an export holds is not unpacked unseen.
_LARGEST_MODEL = 2**30
_POLICY_FILES = {"numpy": "policy.npz", "onnx": "policy.onnx"}


@dataclass(frozen=True)
class Calls:
    """Calls of one service."""

    base_url: str
    retry: Retry

    # Jobs

    def submit(
        self, spec: Mapping[str, Any] | None, idempotency_key: str | None, fields: Mapping[str, Any]
    ) -> Call[JobView]:
        document = {"kind": "train", **(spec or {}), **fields}
        headers = {"Idempotency-Key": idempotency_key or uuid.uuid4().hex}
        return self._job(Request("POST", "/jobs", json=document, headers=headers))

    def get(self, job_id: str) -> Call[JobView]:
        return self._job(Request("GET", job_path(job_id)))

    def list(self, limit: int | None, filters: Mapping[str, Any]) -> Feed:
        return _paged(limit, lambda cursor, number: self.page(cursor, number, filters))

    def page(self, cursor: str | None, limit: int, filters: Mapping[str, Any]) -> Call[Page[JobView]]:
        labels: Mapping[str, str] = filters.get("labels") or {}
        params = {name: value for name, value in filters.items() if value is not None and name != "labels"}
        params |= {"label": [f"{name}={value}" for name, value in labels.items()], "limit": limit}
        response = yield from self._ask(
            "GET", "/jobs", params=params | ({"cursor": cursor} if cursor else {})
        )
        page = Page[JobView].model_validate_json(response.content)
        return page.model_copy(update={"items": [job.of(self.base_url) for job in page.items]})

    def cancel(self, job_id: str) -> Call[JobView]:
        return self._job(Request("POST", job_path(job_id, "cancel")))

    def delete(self, job_id: str) -> Call[None]:
        yield from self._ask("DELETE", job_path(job_id))

    def specification(self, job_id: str) -> Call[dict[str, Any]]:
        response = yield from self._ask("GET", job_path(job_id, "specification"))
        return response.json()

    # Sweeps

    def sweep(
        self, spec: Mapping[str, Any] | None, idempotency_key: str | None, fields: Mapping[str, Any]
    ) -> Call[SweepView]:
        document = {**(spec or {}), **fields}
        if isinstance(job := document.get("job"), Mapping):
            document["job"] = {"kind": "train", **job}
        headers = {"Idempotency-Key": idempotency_key or uuid.uuid4().hex}
        return self._sweep("POST", "/sweeps", json=document, headers=headers)

    def get_sweep(self, sweep_id: str) -> Call[SweepView]:
        return self._sweep("GET", _sweep_path(sweep_id))

    def sweeps(self, limit: int | None, status: str | None) -> Feed:
        return self._all("/sweeps", SweepView, limit, {"status": status} if status is not None else {})

    def cancel_sweep(self, sweep_id: str) -> Call[SweepView]:
        return self._sweep("POST", _sweep_path(sweep_id, "cancel"))

    def resume_sweep(self, sweep_id: str, budget: Mapping[str, Any]) -> Call[SweepView]:
        return self._sweep("POST", _sweep_path(sweep_id, "resume"), json={"budget": budget})

    def delete_sweep(self, sweep_id: str) -> Call[None]:
        yield from self._ask("DELETE", _sweep_path(sweep_id))

    def wait_for_sweep(self, sweep_id: str, timeout: float | None) -> Call[SweepView]:
        deadline = None if timeout is None else time.monotonic() + timeout
        while not (sweep := (yield from self.get_sweep(sweep_id))).is_final:
            if deadline is not None and time.monotonic() > deadline:
                raise WaitTimeout(
                    f"Sweep {sweep_id} is still {sweep.status} after {timeout:g} s; it continues."
                )
            yield Sleep(_POLL_S)
        return sweep

    def _sweep(self, method: str, path: str, **content: Any) -> Call[SweepView]:
        answer = yield from self._ask(method, path, **content)
        return SweepView.model_validate_json(answer.content)

    # Following a job

    def wait(self, job_id: str, timeout: float | None) -> Call[JobView]:
        deadline = None if timeout is None else time.monotonic() + timeout
        job = yield from self.get(job_id)
        if not job.is_final:
            yield from read_through(self.events(job_id, None, deadline))
            job = yield from self.get(job_id)
        if not job.is_final:
            raise WaitTimeout(f"Job {job_id} is still {job.status} after {timeout:g} s; it continues.")
        return job

    def events(self, job_id: str, after: str | None, deadline: float | None = None) -> Feed:
        has_ended = partial(self._has_ended, job_id)
        return follow_feed(self.retry, job_path(job_id, "events"), has_ended, after, deadline)

    def metrics(self, job_id: str, names: Sequence[str], points: int | None, as_: str) -> Call[Any]:
        frame = frames.maker(as_)  # What is missing is said before anything is fetched.
        if points is None:
            rows = yield from self._metrics_pages(job_id)
            return frame([row.only(names) for row in rows if not names or row.only(names).values])
        asked = {"points": points, "metric": list(names)}
        page = yield from self._ask("GET", job_path(job_id, "metrics"), params=asked)
        return frame([MetricsRow.model_validate(row) for row in page.json()["rows"]])

    def _metrics_pages(self, job_id: str) -> Call[Sequence[MetricsRow]]:
        rows, after = list[MetricsRow](), ""
        while True:
            answer = yield from self._ask("GET", job_path(job_id, "metrics"), params={"after": after})
            page = answer.json()
            rows += [MetricsRow.model_validate(row) for row in page["rows"]]
            if not page["rows"] or not page.get("next"):
                return rows
            after = page["next"]

    def logs(self, job_id: str, follow: bool) -> Feed:
        path = job_path(job_id, "logs")
        if follow:
            yield from follow_log(self.retry, path, partial(self._has_ended, job_id))
            return
        answer = yield from self._ask("GET", path)
        for line in answer.text.splitlines():
            yield Found(line)

    def curve(self, job_id: str, names: Sequence[str]) -> Call[str]:
        answer = yield from self._ask("GET", job_path(job_id, "curve"), params={"metric": list(names)})
        return answer.text

    def show(self, job_id: str, every_s: float) -> Call[None]:
        """Shows it under a cell, and replaces what it shows as the job goes on."""
        display = notebook.Display()  # Raises MissingExtra.
        shown_at = time.monotonic()
        job = yield from self._shown(display, job_id)

        def on_event(_event: Event) -> Call[Any] | None:
            nonlocal shown_at
            if time.monotonic() - shown_at < every_s:
                return None
            shown_at = time.monotonic()
            return self._shown(display, job_id)

        if not job.is_final:
            yield from read_through(self.events(job_id, None), on_event)
            yield from self._shown(display, job_id)

    def _shown(self, display: notebook.Display, job_id: str) -> Call[JobView]:
        job = yield from self.get(job_id)
        display.show(job, (yield from self.card(job, display.video_seen)))
        return job

    def card(self, job: JobView, video_seen: str | None = None) -> Call[notebook.Card]:
        """What a notebook shows of a job. video_seen: the hash of a video that is shown already."""
        curve = (yield from self.curve(job.id, ())) if job.kind == "train" else None
        video = job.newest("video")
        if video is None or video.sha256 == video_seen or video.size > notebook.MOST_BYTES:
            return notebook.Card(curve, None)
        answer = yield from self._ask("GET", video.href)
        return notebook.Card(curve, answer.content)

    # Files

    def artifacts(self, job_id: str) -> Call[Sequence[ArtifactView]]:
        return self._items(job_path(job_id, "artifacts"), ArtifactView)

    def checkpoints(self, job_id: str) -> Call[Sequence[ArtifactView]]:
        artifacts = yield from self.artifacts(job_id)
        found = [artifact for artifact in artifacts if artifact.role == "checkpoint"]
        return sorted(found, key=lambda artifact: artifact.step or 0)

    def download(
        self, job_id: str, name: str, path: str | Path | None, on_bytes: OnBytes | None
    ) -> Call[Path]:
        href = job_path(job_id, "artifacts", name)
        artifact = yield from self._announced(job_id, lambda job: job.artifact(name), href)
        return (yield from download(self.retry, artifact, _target(artifact.name, path), on_bytes))

    def newest(
        self, job_id: str, role: str, path: str | Path | None, step: int | None, on_bytes: OnBytes | None
    ) -> Call[Path]:
        """Download the newest file of this role, or the one of this step."""
        href = job_path(job_id, role) + ("" if step is None else f"?step={step}")
        artifact = yield from self._announced(job_id, lambda job: job.newest(role, step), href)
        return (yield from download(self.retry, artifact, _target(artifact.name, path), on_bytes))

    def load_policy(self, job_id: str, step: int | None, deterministic: bool) -> Call[policy.Policy]:
        job = yield from self.get(job_id)
        final = job.newest("policy") if step is None else None
        artifact = final or job.newest("checkpoint", step)
        if artifact is None:
            checkpoints = yield from self.checkpoints(job_id)
            kept = ", ".join(str(found.step) for found in checkpoints) or "none yet"
            which = "policy" if step is None else f"checkpoint of step {step}"
            raise NotFound(404, {"detail": f"Job {job_id} has no {which}; its checkpoints: {kept}."})
        with tempfile.TemporaryDirectory(prefix="gaitway-") as folder:
            path = yield from download(self.retry, artifact, Path(folder) / "policy")
            algorithm = job.spec.get("algorithm", {}).get("kind", "ppo")
            load = partial(
                policy.load, path, algorithm, is_checkpoint=final is None, deterministic=deterministic
            )
            return (yield Run(load))

    def export_policy(
        self, job_id: str, format: str, path: str | Path | None, on_bytes: OnBytes | None
    ) -> Call[Path]:
        href = f"{job_path(job_id, 'policy')}?format={quote(format)}"
        name = _POLICY_FILES.get(format, "")
        artifact = yield from self._announced(job_id, lambda job: job.artifact(name), href)
        return (yield from download(self.retry, artifact, _target(artifact.name, path), on_bytes))

    def export(self, job_id: str, path: str | Path | None) -> Call[Path]:
        target = _target(f"{job_id}.zip", path)
        return (yield from save(self.retry, job_path(job_id, "export"), target))

    def share(self, job_id: str, path: str | Path | None) -> Call[Path]:
        target = _target(f"{job_id}.html", path)
        return (yield from save(self.retry, job_path(job_id, "report.html"), target))

    def import_job(self, path: str | Path, idempotency_key: str | None, timeout: float) -> Call[JobView]:
        file = Path(path)
        with tempfile.TemporaryDirectory(prefix="gaitway-") as folder:
            for model in (yield Run(partial(_models_in, file, Path(folder)))):
                yield from self.add_model(model, timeout)
        headers = {
            "Content-Type": "application/zip",
            "Idempotency-Key": idempotency_key or uuid.uuid4().hex,
        }
        # The service answers once it has read all of the file and stored it.
        return (
            yield from self._job(
                Request("POST", "/jobs/import", file=file, headers=headers, read_timeout_s=timeout)
            )
        )

    # Users' own models

    def add_model(self, path: str | Path, timeout: float) -> Call[ModelView]:
        body = Path(path).read_bytes()
        media_type = "application/zip" if body.startswith(b"PK") else "application/xml"
        deadline = time.monotonic() + timeout
        headers = {"Content-Type": media_type}
        response = yield from self._ask("POST", "/models", content=body, headers=headers)
        model = ModelView.model_validate_json(response.content)
        while model.status == "validating":
            if time.monotonic() > deadline:
                raise WaitTimeout(f"Model {model.id} is not validated after {timeout:g} s.")
            yield Sleep(_POLL_S)
            model = yield from self.model(model.id)
        if model.status == "refused":
            raise Rejected(422, {"detail": model.message, "type": "/problems/bad-model"})
        return model

    def model(self, model_id: str) -> Call[ModelView]:
        response = yield from self._ask("GET", f"/models/{quote(model_id, safe=':')}")
        return ModelView.model_validate_json(response.content)

    def models(self, limit: int | None) -> Feed:
        return self._all("/models", ModelView, limit)

    def delete_model(self, model_id: str) -> Call[None]:
        yield from self._ask("DELETE", f"/models/{quote(model_id, safe=':')}")

    # Previews

    def preview(
        self,
        environment: str,
        folder: str | Path | None,
        camera: str | int | None,
        asked: Mapping[str, Any],
        timeout: float,
    ) -> Call[Mapping[str | int, Path]]:
        path = f"/environments/{quote(environment)}/preview"
        bodies: dict[str | int, bytes] = {}
        if camera is None:
            drawn = yield from self._drawn(path, asked, timeout)
            for still in PreviewView.model_validate_json(drawn.content).stills:
                bodies[still.camera] = (yield from self._ask("GET", still.href)).content
        else:
            bodies[camera] = (yield from self._drawn(path, {**asked, "camera": camera}, timeout)).content
        target = Path(folder or ".")
        target.mkdir(parents=True, exist_ok=True)
        pictures = {seen: target / f"{environment}-{seen}.png".replace("/", "-") for seen in bodies}
        for seen, file in pictures.items():
            file.write_bytes(bodies[seen])
        return pictures

    # The service

    def environments(self, family: str | None) -> Call[Sequence[EnvironmentView]]:
        query = f"?family={quote(family)}" if family else ""
        return self._items(f"/environments{query}", EnvironmentView)

    def environment(self, environment: str, options: Mapping[str, Any] | None) -> Call[EnvironmentView]:
        asked = {"options": json.dumps(options)} if options else None
        answer = yield from self._ask("GET", f"/environments/{quote(environment)}", params=asked)
        return EnvironmentView.model_validate_json(answer.content)

    def workers(self, limit: int | None) -> Feed:
        return self._all("/workers", WorkerView, limit)

    def health(self) -> Call[Mapping[str, Any]]:
        return (yield from self._ask("GET", "/readyz")).json()

    def _ask(self, method: str, path: str, **more: Any) -> Call[httpx.Response]:
        return request(self.retry, Request(method, path, **more))

    def _job(self, asked: Request) -> Call[JobView]:
        response = yield from request(self.retry, asked)
        return JobView.model_validate_json(response.content).of(self.base_url)

    def _items(self, path: str, view: type[AnyView]) -> Call[Sequence[AnyView]]:
        answer = yield from self._ask("GET", path)
        return [view.model_validate(item) for item in answer.json()["items"]]

    def _all(
        self, path: str, view: type[AnyView], limit: int | None, filters: Mapping[str, Any] | None = None
    ) -> Feed:
        """The items of a listing, page by page, at most `limit`."""

        def page(cursor: str | None, number: int) -> Call[Page[AnyView]]:
            asked = {**(filters or {}), "limit": number} | ({"cursor": cursor} if cursor else {})
            answer = yield from self._ask("GET", path, params=asked)
            found = answer.json()
            return Page(items=[view.model_validate(item) for item in found["items"]], next=found.get("next"))

        return _paged(limit, page)

    def _has_ended(self, job_id: str) -> Call[bool]:
        return (yield from self.get(job_id)).is_final

    def _drawn(self, path: str, asked: Mapping[str, Any], timeout: float) -> Call[httpx.Response]:
        """The answer once a worker has rendered."""
        deadline = time.monotonic() + timeout
        while (answer := (yield from self._ask("GET", path, params=asked))).status_code == 202:
            if time.monotonic() > deadline:
                raise WaitTimeout(
                    f"No worker has rendered it after {timeout:g} s; all may be busy with jobs."
                )
            yield Sleep(_POLL_S)
        return answer

    def _announced(
        self, job_id: str, find: Callable[[JobView], ArtifactView | None], href: str
    ) -> Call[ArtifactView]:
        """The artifact that `find` finds in the job; or raises the service's refusal."""
        artifact = find((yield from self.get(job_id)))
        if artifact is None:
            yield from self._ask("GET", href, headers={"Range": "bytes=0-0"})
            artifact = find((yield from self.get(job_id)))  # it has come in between
        if artifact is None:
            raise NotFound(404, {"detail": f"Job {job_id} does not list the file at {href}."})
        return artifact


def _models_in(archive: Path, folder: Path) -> list[Path]:
    """The models in an export, unpacked into the folder; of what is no whole zip, the service says so."""
    try:
        with ZipFile(archive) as opened:
            infos = [
                info
                for info in opened.infolist()
                if info.filename.startswith("model/")
                and not info.is_dir()
                and info.file_size <= _LARGEST_MODEL
            ]
            models = [folder / f"model-{number}" for number in range(len(infos))]
            for info, model in zip(infos, models, strict=True):
                with opened.open(info) as source, model.open("wb") as target:
                    shutil.copyfileobj(source, target)
    except (BadZipFile, zlib.error, RuntimeError):  # Also of an unknown compression, or with a password.
        return []
    return models


def preview_query(
    options: Mapping[str, Any] | None, show: Sequence[str], size: tuple[int, int]
) -> dict[str, Any]:
    return {
        "options": json.dumps(options or {}),
        "show": list(show),
        "width": size[0],
        "height": size[1],
    }


def _paged(limit: int | None, page: Callable[[str | None, int], Call[Page[Any]]]) -> Feed:
    """The items of one page after the other, at most `limit`. page: of a cursor, with a largest number."""
    cursor, left = None, limit
    while left is None or left > 0:
        found = yield from page(cursor, min(left or _PAGE, _PAGE))
        for item in found.items:
            yield Found(item)
        left = None if left is None else left - len(found)
        cursor = found.next
        if cursor is None:
            return


def job_path(job_id: str, *parts: str) -> str:
    # Quoted, so that an id or a name with a slash or dots cannot become another address.
    return "/".join(["/jobs", *(quote(part, safe="") for part in (job_id, *parts))])


def _sweep_path(sweep_id: str, *parts: str) -> str:
    return "/".join(["/sweeps", *(quote(part, safe="") for part in (sweep_id, *parts))])


def _target(name: str, path: str | Path | None) -> Path:
    """Where the file goes: `path`, or inside it when it is a folder."""
    chosen = Path(path) if path is not None else Path.cwd()
    return chosen / PurePosixPath(name).name if chosen.is_dir() else chosen
