"""The client of a Gaitway service, for asynchronous programs."""

from collections.abc import AsyncIterator, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self, overload

import httpx

from gaitway import policy
from gaitway.async_transport import AsyncTransport
from gaitway.calls import Calls
from gaitway.calls.previews import preview_query
from gaitway.client import Client, address
from gaitway.downloading import OnBytes
from gaitway.notebook import Card
from gaitway.retry import Retry
from gaitway.sweep_views import SweepView
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


class AsyncClient:
    """`Client` for asynchronous programs: its methods, awaited.

    `list`, `events` and `logs` are read with `async for`.

    http: an httpx.AsyncClient. Usable as an asynchronous context manager.
    """

    def __init__(
        self,
        base_url: str | None = None,
        *,
        timeout_s: float = 30.0,
        retry: Retry | None = None,
        http: httpx.AsyncClient | None = None,
    ) -> None:
        url = address(base_url)
        self._transport = AsyncTransport(url, timeout_s, http)
        self._calls = Calls(self._transport.base_url, retry or Retry())

    @property
    def base_url(self) -> str:
        return self._transport.base_url

    async def close(self) -> None:
        await self._transport.close()

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    def __repr__(self) -> str:
        return f"AsyncClient({self.base_url!r})"

    # Jobs

    async def submit(
        self, spec: Mapping[str, Any] | None = None, *, idempotency_key: str | None = None, **fields: Any
    ) -> JobView:
        return await self._transport.do(self._calls.submit(spec, idempotency_key, fields))

    async def get(self, job_id: str) -> JobView:
        return await self._transport.do(self._calls.get(job_id))

    def list(self, *, limit: int | None = None, **filters: Any) -> AsyncIterator[JobView]:
        return self._transport.each(self._calls.list(limit, filters))

    async def page(self, *, cursor: str | None = None, limit: int = 50, **filters: Any) -> Page[JobView]:
        return await self._transport.do(self._calls.page(cursor, limit, filters))

    async def cancel(self, job_id: str) -> JobView:
        return await self._transport.do(self._calls.cancel(job_id))

    async def delete(self, job_id: str) -> None:
        await self._transport.do(self._calls.delete(job_id))

    async def specification(self, job_id: str) -> dict[str, Any]:
        return await self._transport.do(self._calls.specification(job_id))

    # Sweeps

    async def sweep(
        self, spec: Mapping[str, Any] | None = None, *, idempotency_key: str | None = None, **fields: Any
    ) -> SweepView:
        return await self._transport.do(self._calls.sweep(spec, idempotency_key, fields))

    async def get_sweep(self, sweep_id: str) -> SweepView:
        return await self._transport.do(self._calls.get_sweep(sweep_id))

    def sweeps(self, *, limit: int | None = None, status: str | None = None) -> AsyncIterator[SweepView]:
        return self._transport.each(self._calls.sweeps(limit, status))

    async def cancel_sweep(self, sweep_id: str) -> SweepView:
        return await self._transport.do(self._calls.cancel_sweep(sweep_id))

    async def resume_sweep(self, sweep_id: str, **budget: Any) -> SweepView:
        return await self._transport.do(self._calls.resume_sweep(sweep_id, budget))

    async def delete_sweep(self, sweep_id: str) -> None:
        await self._transport.do(self._calls.delete_sweep(sweep_id))

    async def wait_for_sweep(self, sweep_id: str, timeout: float | None = None) -> SweepView:
        return await self._transport.do(self._calls.wait_for_sweep(sweep_id, timeout))

    # Following a job

    async def wait(self, job_id: str, timeout: float | None = None) -> JobView:
        return await self._transport.do(self._calls.wait(job_id, timeout))

    def events(self, job_id: str, after: str | None = None) -> AsyncIterator[Event]:
        return self._transport.each(self._calls.events(job_id, after))

    @overload
    async def metrics(
        self, job_id: str, *, names: Sequence[str] = (), points: int | None = None
    ) -> Sequence[MetricsRow]: ...

    @overload
    async def metrics(
        self,
        job_id: str,
        *,
        names: Sequence[str] = (),
        points: int | None = None,
        as_: Literal["pandas", "polars"],
    ) -> Any: ...

    async def metrics(
        self,
        job_id: str,
        *,
        names: Sequence[str] = (),
        points: int | None = None,
        as_: Literal["rows", "pandas", "polars"] = "rows",
    ) -> Any:
        return await self._transport.do(self._calls.metrics(job_id, names, points, as_))

    def logs(self, job_id: str, follow: bool = False) -> AsyncIterator[str]:
        return self._transport.each(self._calls.logs(job_id, follow))

    async def curve(self, job_id: str, names: Sequence[str] = ()) -> str:
        return await self._transport.do(self._calls.curve(job_id, names))

    async def show(self, job_id: str, *, every_s: float = 1.0) -> None:
        await self._transport.do(self._calls.show(job_id, every_s))

    async def card(self, job: JobView) -> Card:
        return await self._transport.do(self._calls.card(job))

    # Files

    async def artifacts(self, job_id: str) -> Sequence[ArtifactView]:
        return await self._transport.do(self._calls.artifacts(job_id))

    async def checkpoints(self, job_id: str) -> Sequence[ArtifactView]:
        return await self._transport.do(self._calls.checkpoints(job_id))

    async def download(
        self, job_id: str, name: str, path: str | Path | None = None, *, on_bytes: OnBytes | None = None
    ) -> Path:
        return await self._transport.do(self._calls.download(job_id, name, path, on_bytes))

    async def video(
        self,
        job_id: str,
        path: str | Path | None = None,
        step: int | None = None,
        *,
        on_bytes: OnBytes | None = None,
    ) -> Path:
        return await self._transport.do(self._calls.newest(job_id, "video", path, step, on_bytes))

    async def poster(self, job_id: str, path: str | Path | None = None, step: int | None = None) -> Path:
        return await self._transport.do(self._calls.newest(job_id, "poster", path, step, None))

    async def load_policy(
        self, job_id: str, step: int | None = None, deterministic: bool = True, *, best: bool = False
    ) -> policy.Policy:
        return await self._transport.do(self._calls.load_policy(job_id, step, deterministic, best))

    async def export_policy(
        self,
        job_id: str,
        format: Literal["numpy", "onnx"],
        path: str | Path | None = None,
        *,
        best: bool = False,
        on_bytes: OnBytes | None = None,
    ) -> Path:
        return await self._transport.do(self._calls.export_policy(job_id, format, path, best, on_bytes))

    async def export(self, job_id: str, path: str | Path | None = None) -> Path:
        return await self._transport.do(self._calls.export(job_id, path))

    async def share(self, job_id: str, path: str | Path | None = None) -> Path:
        return await self._transport.do(self._calls.share(job_id, path))

    async def import_job(
        self, path: str | Path, *, idempotency_key: str | None = None, timeout: float = 600.0
    ) -> JobView:
        return await self._transport.do(self._calls.import_job(path, idempotency_key, timeout))

    # Users' own models

    async def add_model(
        self,
        path: str | Path,
        timeout: float = 120.0,
        *,
        name: str | None = None,
        main: str | None = None,
    ) -> ModelView:
        return await self._transport.do(self._calls.add_model(path, timeout, name, main))

    async def model(self, model_id: str) -> ModelView:
        return await self._transport.do(self._calls.model(model_id))

    def models(self, *, limit: int | None = None, name: str | None = None) -> AsyncIterator[ModelView]:
        return self._transport.each(self._calls.models(limit, name))

    async def delete_model(self, model_id: str) -> None:
        await self._transport.do(self._calls.delete_model(model_id))

    # Previews

    async def preview(  # noqa: PLR0913 # A request's options.
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
        asked = preview_query(options, show, size)
        return await self._transport.do(self._calls.preview(environment, folder, camera, asked, timeout))

    # The service

    async def environments(self, family: str | None = None) -> Sequence[EnvironmentView]:
        return await self._transport.do(self._calls.environments(family))

    async def environment(
        self, environment: str, options: Mapping[str, Any] | None = None
    ) -> EnvironmentView:
        return await self._transport.do(self._calls.environment(environment, options))

    def workers(self, *, limit: int | None = None) -> AsyncIterator[WorkerView]:
        return self._transport.each(self._calls.workers(limit))

    async def health(self) -> Mapping[str, Any]:
        return await self._transport.do(self._calls.health())


for _name in [*vars(AsyncClient)]:
    if not _name.startswith("_") and _name != "base_url":
        # They do the same, so `help` says the same.
        getattr(AsyncClient, _name).__doc__ = getattr(Client, _name).__doc__
