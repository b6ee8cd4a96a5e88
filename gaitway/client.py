"""The client of a Gaitway service."""

import json
import os
import tempfile
import time
import uuid
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path, PurePosixPath
from types import TracebackType
from typing import Any, Literal, Self, TypeVar
from urllib.parse import quote

import httpx
from pydantic import BaseModel

from gaitway import policy
from gaitway.downloading import OnBytes, download
from gaitway.errors import NotFound, Rejected, WaitTimeout
from gaitway.following import follow_feed, follow_log
from gaitway.sweep_views import SweepView
from gaitway.transport import Retry, Transport
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
DEFAULT_URL = "http://127.0.0.1:8000"


class Client:
    """Talks to one service. Usable from several threads, and as a context manager.

    base_url: by default that of GAITWAY_URL, otherwise http://127.0.0.1:8000.
    Every method raises ApiError for a refusal (NotFound, Conflict, Rejected, Unavailable), and
    Unreachable when nothing answers. Temporary failures are retried first; a retry never has an
    effect twice, not even that of `submit`.
    """

    def __init__(
        self,
        base_url: str | None = None,
        *,
        timeout_s: float = 30.0,
        retry: Retry | None = None,
        http: httpx.Client | None = None,
    ) -> None:
        url = base_url or os.environ.get("GAITWAY_URL") or DEFAULT_URL
        self._transport = Transport(url, retry or Retry(), timeout_s, http)

    @property
    def base_url(self) -> str:
        return self._transport.base_url

    def close(self) -> None:
        """Close the connections."""
        self._transport.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"Client({self.base_url!r})"

    # Jobs

    def submit(
        self, spec: Mapping[str, Any] | None = None, *, idempotency_key: str | None = None, **fields: Any
    ) -> JobView:
        """Queue a job: `submit(environment="ant", algorithm={"kind": "ppo", "num_timesteps": 1_000_000})`.

        fields override those of `spec`; `kind` is `train` by default. Retries of the request create
        only one job. idempotency_key: extends this to several calls; the same key with another
        specification raises Conflict.
        """
        document = {"kind": "train", **(spec or {}), **fields}
        headers = {"Idempotency-Key": idempotency_key or uuid.uuid4().hex}
        return self._job(self._transport.request("POST", "/jobs", json=document, headers=headers))

    def get(self, job_id: str) -> JobView:
        """The job as it is now."""
        return self._job(self._transport.request("GET", _path(job_id)))

    def list(self, *, limit: int | None = None, **filters: Any) -> Iterator[JobView]:
        """Jobs, newest first, fetched page by page as needed; at most `limit`.

        filters: status, kind, environment, name, and labels (a dict, every one must match).
        """
        cursor, left = None, limit
        while left is None or left > 0:
            page = self.page(cursor=cursor, limit=min(left or 100, 100), **filters)
            yield from page.items
            left = None if left is None else left - len(page)
            cursor = page.next
            if cursor is None:
                return

    def page(self, *, cursor: str | None = None, limit: int = 50, **filters: Any) -> Page[JobView]:
        """One page of jobs, newest first; cursor: the `next` of an earlier page."""
        labels: Mapping[str, str] = filters.pop("labels", None) or {}
        named = {name: value for name, value in filters.items() if value is not None}
        params = {**named, "label": [f"{name}={value}" for name, value in labels.items()], "limit": limit}
        response = self._transport.request(
            "GET", "/jobs", params=params | ({"cursor": cursor} if cursor else {})
        )
        return Page[JobView].model_validate_json(response.content)

    def cancel(self, job_id: str) -> JobView:
        """Ask a job to stop; its checkpoint, metrics and video up to then are kept.

        Raises Conflict where the job has ended.
        """
        return self._job(self._transport.request("POST", _path(job_id, "cancel")))

    def delete(self, job_id: str) -> None:
        """Remove an ended job and its files. Raises Conflict while it runs."""
        self._transport.request("DELETE", _path(job_id))

    # Sweeps

    def sweep(
        self, spec: Mapping[str, Any] | None = None, *, idempotency_key: str | None = None, **fields: Any
    ) -> SweepView:
        """Start a sweep, whose trials are jobs (docs/sweeps.md).

        `sweep(job={"environment": "ant"}, method="grid", parameters={"seed": [1, 2]})`; fields override those
        of `spec`, and the job's `kind` is `train` by default. Retries of the request make only one sweep.
        """
        document = {**(spec or {}), **fields}
        if isinstance(job := document.get("job"), Mapping):
            document["job"] = {"kind": "train", **job}
        headers = {"Idempotency-Key": idempotency_key or uuid.uuid4().hex}
        return self._sweep(self._transport.request("POST", "/sweeps", json=document, headers=headers))

    def get_sweep(self, sweep_id: str) -> SweepView:
        """The sweep as it is now, with its trials, the best so far and the importance of its axes."""
        return self._sweep(self._transport.request("GET", _sweep_path(sweep_id)))

    def sweeps(self, *, limit: int | None = None, status: str | None = None) -> Iterator[SweepView]:
        """Sweeps, newest first, without their trials; at most `limit`."""
        params: dict[str, Any] = {"limit": min(limit or 100, 100), **({"status": status} if status else {})}
        found = 0
        while True:
            answer = self._transport.request("GET", "/sweeps", params=params)
            page = Page[SweepView].model_validate_json(answer.content)
            for sweep in page:
                yield sweep
                found += 1
                if found == limit:
                    return
            if page.next is None:
                return
            params["cursor"] = page.next

    def cancel_sweep(self, sweep_id: str) -> SweepView:
        """Start no more trials, and cancel those that run; they keep their work."""
        return self._sweep(self._transport.request("POST", _sweep_path(sweep_id, "cancel")))

    def resume_sweep(self, sweep_id: str, **budget: Any) -> SweepView:
        """Continue under another budget, which counts the trials so far: `resume_sweep(id, jobs=40)`."""
        document = {"budget": budget}
        return self._sweep(self._transport.request("POST", _sweep_path(sweep_id, "resume"), json=document))

    def delete_sweep(self, sweep_id: str) -> None:
        """Remove the record of an ended sweep; its jobs stay."""
        self._transport.request("DELETE", _sweep_path(sweep_id))

    def wait_for_sweep(self, sweep_id: str, timeout: float | None = None) -> SweepView:
        """The sweep once it has ended. timeout: seconds; then it raises WaitTimeout."""
        deadline = None if timeout is None else time.monotonic() + timeout
        while not (sweep := self.get_sweep(sweep_id)).is_final:
            if deadline is not None and time.monotonic() > deadline:
                raise WaitTimeout(
                    f"Sweep {sweep_id} is still {sweep.status} after {timeout:g} s; it continues."
                )
            time.sleep(_POLL_S)
        return sweep

    # Following a job

    def wait(self, job_id: str, timeout: float | None = None) -> JobView:
        """The job once it has ended, however it ended. timeout: seconds; then it raises WaitTimeout."""
        deadline = None if timeout is None else time.monotonic() + timeout
        job = self.get(job_id)
        if not job.is_final:
            for _ in self._events(job_id, None, deadline):
                pass
            job = self.get(job_id)
        if not job.is_final:
            raise WaitTimeout(f"Job {job_id} is still {job.status} after {timeout:g} s; it continues.")
        return job

    def events(self, job_id: str, after: str | None = None) -> Iterator[Event]:
        """The job's events, live, until it ends.

        Kinds: status, progress, metrics, artifact, phase.
        after: the id of the last event seen; later ones follow. Broken connections are resumed
        without a gap or a repetition.
        """
        return self._events(job_id, after, None)

    def _events(self, job_id: str, after: str | None, deadline: float | None) -> Iterator[Event]:
        def has_ended() -> bool:
            return self.get(job_id).is_final

        return follow_feed(self._transport, _path(job_id, "events"), has_ended, after, deadline)

    def metrics(self, job_id: str) -> Sequence[MetricsRow]:
        """All metrics so far, in the order of measurement."""
        rows, after = list[MetricsRow](), ""
        while True:
            page = self._transport.request("GET", _path(job_id, "metrics"), params={"after": after}).json()
            rows += [MetricsRow.model_validate(row) for row in page["rows"]]
            if not page["rows"] or not page.get("next"):
                return rows
            after = page["next"]

    def logs(self, job_id: str, follow: bool = False) -> Iterator[str]:
        """The job's log, line by line; follow: also new lines, until the job ends."""
        if not follow:
            yield from self._transport.request("GET", _path(job_id, "logs")).text.splitlines()
        else:
            yield from follow_log(self._transport, _path(job_id, "logs"), lambda: self.get(job_id).is_final)

    # Files

    def artifacts(self, job_id: str) -> Sequence[ArtifactView]:
        """All files of the job."""
        return self._items(_path(job_id, "artifacts"), ArtifactView)

    def checkpoints(self, job_id: str) -> Sequence[ArtifactView]:
        """The kept checkpoints, ordered by step."""
        found = [artifact for artifact in self.artifacts(job_id) if artifact.role == "checkpoint"]
        return sorted(found, key=lambda artifact: artifact.step or 0)

    def download(
        self, job_id: str, name: str, path: str | Path | None = None, *, on_bytes: OnBytes | None = None
    ) -> Path:
        """Download the artifact `name` to `path` (a file or a folder; by default here), and check its hash.

        A broken download is resumed, also by a later call. on_bytes: called with (bytes here, in all).
        """
        href = _path(job_id, "artifacts", name)
        artifact = self._announced(job_id, lambda job: job.artifact(name), href)
        return download(self._transport, artifact, _target(artifact, path), on_bytes)

    def video(
        self,
        job_id: str,
        path: str | Path | None = None,
        step: int | None = None,
        *,
        on_bytes: OnBytes | None = None,
    ) -> Path:
        """Download the job's video as an MP4 to `path`; step: of this checkpoint, not the newest."""
        return self._newest(job_id, "video", path, step, on_bytes)

    def poster(self, job_id: str, path: str | Path | None = None, step: int | None = None) -> Path:
        """Download a still of the video."""
        return self._newest(job_id, "poster", path, step, None)

    def load_policy(self, job_id: str, step: int | None = None, deterministic: bool = True) -> policy.Policy:
        """The trained policy as a jitted function: `act(observation, key=None)` on arrays [..., size].

        It returns an action; of Q-learning the columns chosen (docs/q_learning.md), each to be held for
        `decision_steps` steps.
        step: the policy of this checkpoint; by default the final one, or that of the newest checkpoint if the
        job has no final one yet. deterministic: without exploration noise (otherwise `key` is needed). Call a
        policy that was trained with `action_repeat` once every `action_repeat` steps, and hold its action.
        Raises MissingExtra without the `policy` extra, and PolicyUnreadable.
        """
        job = self.get(job_id)
        final = job.newest("policy") if step is None else None
        artifact = final or job.newest("checkpoint", step)
        if artifact is None:
            kept = ", ".join(str(found.step) for found in self.checkpoints(job_id)) or "none yet"
            which = "policy" if step is None else f"checkpoint of step {step}"
            raise NotFound(404, {"detail": f"Job {job_id} has no {which}; its checkpoints: {kept}."})
        with tempfile.TemporaryDirectory(prefix="gaitway-") as folder:
            path = download(self._transport, artifact, Path(folder) / "policy")
            algorithm = job.spec.get("algorithm", {}).get("kind", "ppo")
            return policy.load(path, algorithm, is_checkpoint=final is None, deterministic=deterministic)

    def export_policy(
        self,
        job_id: str,
        format: Literal["numpy", "onnx"],
        path: str | Path | None = None,
        *,
        on_bytes: OnBytes | None = None,
    ) -> Path:
        """Download the final policy for programs without this package, to `path` (docs/export.md).

        format: `numpy`, `policy.npz`, which `gaitway.exported_policy` reads with NumPy alone; or `onnx`,
        `policy.onnx` for any ONNX runtime. Raises NotReady until the job has ended, and Rejected for the
        tables of Q-learning.
        """
        href = f"{_path(job_id, 'policy')}?format={quote(format)}"
        names = {"numpy": "policy.npz", "onnx": "policy.onnx"}
        artifact = self._announced(job_id, lambda job: job.artifact(names.get(format, "")), href)
        return download(self._transport, artifact, _target(artifact, path), on_bytes)

    # Users' own models

    def add_model(self, path: str | Path, timeout: float = 120.0) -> ModelView:
        """Send a model (MJCF, URDF, or a zip of it and its meshes), and wait until it is validated.

        The same file is the same model. Raises Rejected where it cannot be used, and WaitTimeout after
        `timeout` seconds without a worker that validates it.
        """
        body = Path(path).read_bytes()
        media_type = "application/zip" if body.startswith(b"PK") else "application/xml"
        deadline = time.monotonic() + timeout
        response = self._transport.request(
            "POST", "/models", content=body, headers={"Content-Type": media_type}
        )
        model = ModelView.model_validate_json(response.content)
        while model.status == "validating":
            if time.monotonic() > deadline:
                raise WaitTimeout(f"Model {model.id} is not validated after {timeout:g} s.")
            time.sleep(_POLL_S)
            model = self.model(model.id)
        if model.status == "refused":
            raise Rejected(422, {"detail": model.message, "type": "/problems/bad-model"})
        return model

    def model(self, model_id: str) -> ModelView:
        """A model with its contents."""
        response = self._transport.request("GET", f"/models/{quote(model_id, safe=':')}")
        return ModelView.model_validate_json(response.content)

    def models(self) -> Sequence[ModelView]:
        """All models."""
        return self._items("/models", ModelView)

    def delete_model(self, model_id: str) -> None:
        """Remove a model. Raises Conflict while an unfinished job needs it."""
        self._transport.request("DELETE", f"/models/{quote(model_id, safe=':')}")

    # Previews

    def preview(  # noqa: PLR0913 # A request's options.
        self,
        environment: str,
        folder: str | Path | None = None,
        *,
        options: Mapping[str, Any] | None = None,
        camera: str | int | None = None,
        show: Sequence[str] = (),
        size: tuple[int, int] = (640, 480),
        timeout: float = 120.0,
    ) -> Mapping[str | int, Path]:
        """The environment as an episode begins: a PNG in `folder` (by default here) from each camera.

        camera: only this one. show: what is drawn besides the body, as in a job's `video.show`. size: width
        and height in pixels. Raises Rejected for an unknown option or camera, and WaitTimeout after `timeout`
        seconds without a worker that renders it.
        """
        asked: dict[str, Any] = {
            "options": json.dumps(options or {}),
            "show": list(show),
            "width": size[0],
            "height": size[1],
        }
        path = f"/environments/{quote(environment)}/preview"
        if camera is None:
            found = PreviewView.model_validate_json(self._drawn(path, asked, timeout).content)
            bodies = {
                still.camera: self._transport.request("GET", still.href).content for still in found.stills
            }
        else:
            bodies = {camera: self._drawn(path, {**asked, "camera": camera}, timeout).content}
        target = Path(folder or ".")
        target.mkdir(parents=True, exist_ok=True)
        pictures = {seen: target / f"{environment}-{seen}.png".replace("/", "-") for seen in bodies}
        for seen, file in pictures.items():
            file.write_bytes(bodies[seen])
        return pictures

    # The service

    def environments(self, family: str | None = None) -> Sequence[EnvironmentView]:
        """The environments that a job may name. family: only `gaitway`, `playground` or `brax`."""
        query = f"?family={quote(family)}" if family else ""
        return self._items(f"/environments{query}", EnvironmentView)

    def environment(self, environment: str, options: Mapping[str, Any] | None = None) -> EnvironmentView:
        """One environment under these options: what it is shown and does, and what a job gets by default.

        Raises Rejected for an unknown option.
        """
        asked = {"options": json.dumps(options)} if options else None
        answer = self._transport.request("GET", f"/environments/{quote(environment)}", params=asked)
        return EnvironmentView.model_validate_json(answer.content)

    def workers(self) -> Sequence[WorkerView]:
        """The workers that have sent a heartbeat lately."""
        return self._items("/workers", WorkerView)

    def health(self) -> Mapping[str, Any]:
        """The service's readiness. Raises Unavailable when a part of it is unavailable."""
        return self._transport.request("GET", "/readyz").json()

    def _job(self, response: httpx.Response) -> JobView:
        return JobView.model_validate_json(response.content)

    def _sweep(self, response: httpx.Response) -> SweepView:
        return SweepView.model_validate_json(response.content)

    def _items(self, path: str, view: type[AnyView]) -> Sequence[AnyView]:
        return [view.model_validate(item) for item in self._transport.request("GET", path).json()["items"]]

    def _drawn(self, path: str, asked: Mapping[str, Any], timeout: float) -> httpx.Response:
        """The answer once a worker has rendered."""
        deadline = time.monotonic() + timeout
        while (answer := self._transport.request("GET", path, params=asked)).status_code == 202:
            if time.monotonic() > deadline:
                raise WaitTimeout(
                    f"No worker has rendered it after {timeout:g} s; all may be busy with jobs."
                )
            time.sleep(_POLL_S)
        return answer

    def _newest(
        self, job_id: str, role: str, path: str | Path | None, step: int | None, on_bytes: OnBytes | None
    ) -> Path:
        href = _path(job_id, role) + ("" if step is None else f"?step={step}")
        artifact = self._announced(job_id, lambda job: job.newest(role, step), href)
        return download(self._transport, artifact, _target(artifact, path), on_bytes)

    def _announced(
        self, job_id: str, find: Callable[[JobView], ArtifactView | None], href: str
    ) -> ArtifactView:
        """The artifact that `find` finds in the job; or raises the service's refusal."""
        artifact = find(self.get(job_id))
        if artifact is None:
            self._transport.request("GET", href, headers={"Range": "bytes=0-0"})
            artifact = find(self.get(job_id))  # it has come in between
        if artifact is None:
            raise NotFound(404, {"detail": f"Job {job_id} does not list the file at {href}."})
        return artifact


def _path(job_id: str, *parts: str) -> str:
    # Quoted, so that an id or a name with a slash or dots cannot become another address.
    return "/".join(["/jobs", *(quote(part, safe="") for part in (job_id, *parts))])


def _sweep_path(sweep_id: str, *parts: str) -> str:
    return "/".join(["/sweeps", *(quote(part, safe="") for part in (sweep_id, *parts))])


def _target(artifact: ArtifactView, path: str | Path | None) -> Path:
    """Where the file goes: `path`, or inside it when it is a folder."""
    chosen = Path(path) if path is not None else Path.cwd()
    return chosen / PurePosixPath(artifact.name).name if chosen.is_dir() else chosen
