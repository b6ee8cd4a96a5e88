"""The client of a Gaitway service."""

import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self, overload

import httpx

from gaitway import policy
from gaitway.calls import Calls
from gaitway.calls.previews import preview_query
from gaitway.downloading import OnBytes
from gaitway.errors import GaitwayError, WrongAddress
from gaitway.notebook import Card
from gaitway.retry import Retry
from gaitway.sweep_views import SweepView
from gaitway.transport import Transport
from gaitway.views import (
    ArtifactView,
    EnvironmentView,
    Event,
    JobView,
    MetricsRow,
    ModelView,
    Page,
    WorkerView,
)

DEFAULT_URL = "http://127.0.0.1:8000"


def address(base_url: str | None) -> str:
    """The service's address: the given one, that of GAITWAY_URL, or this machine's. Raises WrongAddress."""
    url = base_url or os.environ.get("GAITWAY_URL") or DEFAULT_URL
    if not url.lower().startswith(("http://", "https://")):
        raise WrongAddress(url)
    return url


class Client:
    """Talks to one service. Usable from several threads, and as a context manager.

    base_url: by default that of GAITWAY_URL, otherwise http://127.0.0.1:8000.
    Every method raises ApiError for a refusal (NotFound, Conflict, Rejected, Unavailable), and
    Unreachable when nothing answers. Temporary failures are retried first; a retry never has an
    effect twice, not even that of `submit`. An address without http:// is a WrongAddress.
    """

    def __init__(
        self,
        base_url: str | None = None,
        *,
        timeout_s: float = 30.0,
        retry: Retry | None = None,
        http: httpx.Client | None = None,
    ) -> None:
        url = address(base_url)
        self._transport = Transport(url, timeout_s, http)
        self._calls = Calls(self._transport.base_url, retry or Retry())

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
        return self._transport.do(self._calls.submit(spec, idempotency_key, fields))

    def get(self, job_id: str) -> JobView:
        """The job as it is now."""
        return self._transport.do(self._calls.get(job_id))

    def list(self, *, limit: int | None = None, **filters: Any) -> Iterator[JobView]:
        """Jobs in brief, newest first, fetched page by page as needed; at most `limit`.

        Each has its newest ten attempts and files of each role; `get` has all.
        filters: status, kind, environment, name, and labels (a dict, every one must match).
        """
        return self._transport.each(self._calls.list(limit, filters))

    def page(self, *, cursor: str | None = None, limit: int = 50, **filters: Any) -> Page[JobView]:
        """One page of jobs, newest first; cursor: the `next` of an earlier page."""
        return self._transport.do(self._calls.page(cursor, limit, filters))

    def cancel(self, job_id: str) -> JobView:
        """Ask a job to stop; its checkpoint, metrics and video up to then are kept.

        Raises Conflict where the job has ended.
        """
        return self._transport.do(self._calls.cancel(job_id))

    def delete(self, job_id: str) -> None:
        """Remove an ended job and its files. Raises Conflict while it runs."""
        self._transport.do(self._calls.delete(job_id))

    def specification(self, job_id: str) -> dict[str, Any]:
        """The job's specification with all defaults filled in, which can be submitted again."""
        return self._transport.do(self._calls.specification(job_id))

    # Sweeps

    def sweep(
        self, spec: Mapping[str, Any] | None = None, *, idempotency_key: str | None = None, **fields: Any
    ) -> SweepView:
        """Start a sweep, whose trials are jobs (docs/sweeps.md).

        `sweep(job={"environment": "ant"}, method="grid", parameters={"seed": [1, 2]})`; fields override those
        of `spec`, and the job's `kind` is `train` by default. Retries of the request make only one sweep.
        """
        return self._transport.do(self._calls.sweep(spec, idempotency_key, fields))

    def get_sweep(self, sweep_id: str) -> SweepView:
        """The sweep as it is now, with its trials, the best so far and the importance of its axes."""
        return self._transport.do(self._calls.get_sweep(sweep_id))

    def sweeps(self, *, limit: int | None = None, status: str | None = None) -> Iterator[SweepView]:
        """Sweeps, newest first, without their trials; at most `limit`."""
        return self._transport.each(self._calls.sweeps(limit, status))

    def cancel_sweep(self, sweep_id: str) -> SweepView:
        """Start no more trials, and cancel those that run; they keep their work."""
        return self._transport.do(self._calls.cancel_sweep(sweep_id))

    def resume_sweep(self, sweep_id: str, **budget: Any) -> SweepView:
        """Continue under another budget, which counts the trials so far: `resume_sweep(id, jobs=40)`."""
        return self._transport.do(self._calls.resume_sweep(sweep_id, budget))

    def delete_sweep(self, sweep_id: str) -> None:
        """Remove the record of an ended sweep; its jobs stay."""
        self._transport.do(self._calls.delete_sweep(sweep_id))

    def wait_for_sweep(self, sweep_id: str, timeout: float | None = None) -> SweepView:
        """The sweep once it has ended. timeout: seconds; then it raises WaitTimeout."""
        return self._transport.do(self._calls.wait_for_sweep(sweep_id, timeout))

    # Following a job

    def wait(self, job_id: str, timeout: float | None = None) -> JobView:
        """The job once it has ended, however it ended. timeout: seconds; then it raises WaitTimeout."""
        return self._transport.do(self._calls.wait(job_id, timeout))

    def events(self, job_id: str, after: str | None = None) -> Iterator[Event]:
        """The job's events, live, until it ends.

        Kinds: status, progress, metrics, artifact, phase.
        after: the id of the last event seen; later ones follow. Broken connections are resumed
        without a gap or a repetition.
        """
        return self._transport.each(self._calls.events(job_id, after))

    @overload
    def metrics(
        self, job_id: str, *, names: Sequence[str] = (), points: int | None = None
    ) -> Sequence[MetricsRow]: ...

    @overload
    def metrics(
        self,
        job_id: str,
        *,
        names: Sequence[str] = (),
        points: int | None = None,
        as_: Literal["pandas", "polars"],
    ) -> Any: ...

    def metrics(
        self,
        job_id: str,
        *,
        names: Sequence[str] = (),
        points: int | None = None,
        as_: Literal["rows", "pandas", "polars"] = "rows",
    ) -> Any:
        """All metrics so far, in the order of measurement.

        names: only these metrics. points: for pictures, at most this many values of each, the least and the
        greatest among them. as_: `pandas` or `polars` for a data frame with columns `step`, `time` and
        each metric; raises MissingExtra where that package is not installed.
        """
        return self._transport.do(self._calls.metrics(job_id, names, points, as_))

    def logs(self, job_id: str, follow: bool = False) -> Iterator[str]:
        """The job's log, line by line; follow: also new lines, until the job ends."""
        return self._transport.each(self._calls.logs(job_id, follow))

    def curve(self, job_id: str, names: Sequence[str] = ()) -> str:
        """A picture of metrics over steps, as SVG; by default of the return."""
        return self._transport.do(self._calls.curve(job_id, names))

    def show(self, job_id: str, *, every_s: float = 1.0) -> None:
        """Follow a job in a notebook: its status, curve and newest video stand below the cell until it ends.

        every_s: seconds between two looks. Raises MissingExtra outside a notebook.
        """
        self._transport.do(self._calls.show(job_id, every_s))

    def card(self, job: JobView) -> Card:
        """The pictures that a notebook shows of the job."""
        return self._transport.do(self._calls.card(job))

    # Files

    def artifacts(self, job_id: str) -> Sequence[ArtifactView]:
        """All files of the job."""
        return self._transport.do(self._calls.artifacts(job_id))

    def checkpoints(self, job_id: str) -> Sequence[ArtifactView]:
        """The kept checkpoints, ordered by step."""
        return self._transport.do(self._calls.checkpoints(job_id))

    def download(
        self, job_id: str, name: str, path: str | Path | None = None, *, on_bytes: OnBytes | None = None
    ) -> Path:
        """Download the artifact `name` to `path` (a file or a folder; by default here), and check its hash.

        A broken download is resumed, also by a later call. on_bytes: called with (bytes here, in all).
        """
        return self._transport.do(self._calls.download(job_id, name, path, on_bytes))

    def video(
        self,
        job_id: str,
        path: str | Path | None = None,
        step: int | None = None,
        *,
        on_bytes: OnBytes | None = None,
    ) -> Path:
        """Download the job's video as an MP4 to `path`; step: of this checkpoint, not the newest."""
        return self._transport.do(self._calls.newest(job_id, "video", path, step, on_bytes))

    def poster(self, job_id: str, path: str | Path | None = None, step: int | None = None) -> Path:
        """Download a still of the video."""
        return self._transport.do(self._calls.newest(job_id, "poster", path, step, None))

    def load_policy(
        self, job_id: str, step: int | None = None, deterministic: bool = True, *, best: bool = False
    ) -> policy.Policy:
        """The trained policy as a jitted function: `act(observation, key=None)` on arrays [..., size].

        It returns an action; of Q-learning the columns chosen (docs/q_learning.md), each to be held for
        `decision_steps` steps.
        step: the policy of this checkpoint; by default the final one, or that of the newest checkpoint if the
        job has no final one yet. best: the policy whose evaluation had the highest return, instead.
        deterministic: without exploration noise (otherwise `key` is needed). Call a policy that was trained
        with `action_repeat` once every `action_repeat` steps, and hold its action.
        Raises MissingExtra without the `policy` extra, and PolicyUnreadable.
        """
        return self._transport.do(self._calls.load_policy(job_id, step, deterministic, best))

    def export_policy(
        self,
        job_id: str,
        format: Literal["numpy", "onnx"],
        path: str | Path | None = None,
        *,
        best: bool = False,
        on_bytes: OnBytes | None = None,
    ) -> Path:
        """Download the final policy for programs without this package, to `path` (docs/export.md).

        format: `numpy`, `policy.npz`, which `gaitway.exported_policy` reads with NumPy alone; or `onnx`,
        `policy.onnx` for any ONNX runtime. best: the policy whose evaluation had the highest return, instead:
        `policy-best.npz` or `policy-best.onnx`. Raises NotReady until the job has ended (the artifact
        `policy.npz` is the newest checkpoint's until then), and Rejected for the tables of Q-learning.
        """
        return self._transport.do(self._calls.export_policy(job_id, format, path, best, on_bytes))

    def export(self, job_id: str, path: str | Path | None = None) -> Path:
        """Download all that is needed to run the job again elsewhere, as a zip (docs/sharing.md).

        `import_job` makes a job of it on another service."""
        return self._transport.do(self._calls.export(job_id, path))

    def share(self, job_id: str, path: str | Path | None = None) -> Path:
        """Download a report on the job: one HTML file with curves and video, which needs no network."""
        return self._transport.do(self._calls.share(job_id, path))

    def import_job(
        self, path: str | Path, *, idempotency_key: str | None = None, timeout: float = 600.0
    ) -> JobView:
        """Make an ended job of an export, from this service or another: others can resume from it.

        The user's own model in it is sent first. Retries of the request create only one job; idempotency_key
        extends this to several calls. timeout: seconds for the service to store it. Raises Rejected where the
        file is no whole export, or the service cannot have such a job (docs/sharing.md).
        """
        return self._transport.do(self._calls.import_job(path, idempotency_key, timeout))

    # Users' own models

    def add_model(
        self,
        path: str | Path,
        timeout: float = 120.0,
        *,
        name: str | None = None,
        main: str | None = None,
    ) -> ModelView:
        """Send a model (MJCF, URDF, or a zip of it and its meshes), and wait until it is validated.

        The same file is the same model; the name is the last one that it was sent by. name: by default the
        file's. main: the document of a zip that is the model, where it has several. Raises Rejected where it
        cannot be used, and WaitTimeout after `timeout` seconds without a worker that validates it.
        """
        return self._transport.do(self._calls.add_model(path, timeout, name, main))

    def model(self, model_id: str) -> ModelView:
        """A model with its contents."""
        return self._transport.do(self._calls.model(model_id))

    def models(self, *, limit: int | None = None, name: str | None = None) -> Iterator[ModelView]:
        """Models, the last sent first, fetched page by page as needed; at most `limit`.

        name: only those of this name.
        """
        return self._transport.each(self._calls.models(limit, name))

    def delete_model(self, model_id: str) -> None:
        """Remove a model. Raises Conflict while an unfinished job needs it."""
        self._transport.do(self._calls.delete_model(model_id))

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
        asked = preview_query(options, show, size)
        return self._transport.do(self._calls.preview(environment, folder, camera, asked, timeout))

    # The service

    def environments(self, family: str | None = None) -> Sequence[EnvironmentView]:
        """The environments that a job may name. family: only `gaitway`, `playground` or `brax`."""
        return self._transport.do(self._calls.environments(family))

    def environment(self, environment: str, options: Mapping[str, Any] | None = None) -> EnvironmentView:
        """One environment under these options: what it is shown and does, and what a job gets by default.

        Raises Rejected for an unknown option.
        """
        return self._transport.do(self._calls.environment(environment, options))

    def workers(self, *, limit: int | None = None) -> Iterator[WorkerView]:
        """The workers that have sent a heartbeat lately, by name; at most `limit`."""
        return self._transport.each(self._calls.workers(limit))

    def health(self) -> Mapping[str, Any]:
        """The service's readiness. Raises Unavailable when a part of it is unavailable."""
        return self._transport.do(self._calls.health())


def card_of(job: JobView, service: str | None) -> Card:
    """What a notebook shows of the job, fetched now; or why that could not be fetched."""
    if service is None:
        return Card()
    try:
        with Client(service, timeout_s=10.0, retry=Retry(attempts=1)) as client:
            return client.card(job)
    except GaitwayError as error:
        return Card(problem=str(error))
