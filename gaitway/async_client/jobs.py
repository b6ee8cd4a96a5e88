"""Jobs: submitted, listed, followed and shown."""

import time
import uuid
from collections.abc import AsyncIterator, Iterable, Mapping, Sequence
from typing import Any, Literal, overload

from pydantic import PrivateAttr

from gaitway import frames, notebook
from gaitway.async_client.following import AsyncFollowing
from gaitway.concurrency import async_card_in_a_cell
from gaitway.errors import WaitTimeout
from gaitway.notebook import Card
from gaitway.schema import JobView, Metrics, MetricsRow, OutcomeView
from gaitway.views import Event, Page

# Jobs that one request may name.
_AT_ONCE = 200


class AsyncJob(JobView):
    """A job as it was when it was read, and the client that read it; read it again for news.

    A notebook's cell that ends with it shows it; `show` follows it there.
    """

    _client: "AsyncJobs" = PrivateAttr()

    def model_post_init(self, context: Any) -> None:
        self._client = context

    async def wait(self, timeout: float | None = None) -> "AsyncJob":
        """The job once it has ended; as the client's `wait`."""
        return await self._client.wait(self.id, timeout)

    async def show(self, *, every_s: float = 1.0) -> None:
        """Follow it in a notebook, below the cell, until it ends; as the client's `show`."""
        await self._client.show(self.id, every_s=every_s)

    def _repr_html_(self) -> str:
        return notebook.job_html(self, async_card_in_a_cell(self._client, self))


class AsyncJobs(AsyncFollowing):
    """The methods about whole jobs."""

    async def submit(
        self, spec: Mapping[str, Any] | None = None, *, idempotency_key: str | None = None, **fields: Any
    ) -> AsyncJob:
        """Queue a job: `submit(environment="ant", algorithm={"kind": "ppo", "num_timesteps": 1_000_000})`.

        fields override those of `spec`; `kind` is `train` by default. Retries of the request create
        only one job. idempotency_key: extends this to several calls; the same key with another
        specification raises Conflict.
        """
        document = {"kind": "train", **(spec or {}), **fields}
        headers = {"Idempotency-Key": idempotency_key or uuid.uuid4().hex}
        return await self._post("/jobs", AsyncJob, json=document, headers=headers)

    async def check(self, spec: Mapping[str, Any] | None = None, **fields: Any) -> dict[str, Any]:
        """What `submit` would queue, with all defaults filled in; it raises the same, and stores nothing."""
        document = {"kind": "train", **(spec or {}), **fields}
        return (await self._request("POST", "/jobs/check", json=document)).json()

    async def get(self, job_id: str) -> AsyncJob:
        """The job as it is now."""
        return await self._get(await self._job_path(job_id), AsyncJob)

    def list(self, *, limit: int | None = None, **filters: Any) -> AsyncIterator[AsyncJob]:
        """Jobs in brief, newest first, fetched page by page as needed; at most `limit`.

        Each has its newest ten attempts and files of each role; `get` has all.
        filters: status, kind, environment, name, search, owner, project, and labels (a dict, every one must
        match). sweep: a sweep's id, `"none"`, or `"folded"` for one of its trials. sort: another order, by a
        column such as `"return"` or `"label:arm"`, with order `"desc"` (the default) or `"asc"`.
        """
        return self._all("/jobs", AsyncJob, limit, _query(filters))

    async def page(self, *, cursor: str | None = None, limit: int = 50, **filters: Any) -> Page[AsyncJob]:
        """One page of jobs, newest first; cursor: the `next` of an earlier page."""
        return await self._page("/jobs", AsyncJob, cursor, limit, _query(filters))

    async def cancel(self, job_id: str) -> AsyncJob:
        """Ask a job to stop; its checkpoint, metrics and video up to then are kept.

        Raises Conflict where the job has ended.
        """
        return await self._post(await self._job_path(job_id, "cancel"), AsyncJob)

    async def delete(self, job_id: str) -> None:
        """Remove an ended job and its files. Raises Conflict while it runs."""
        await self._request("DELETE", await self._job_path(job_id))

    async def change(self, job_id: str, **changes: Any) -> AsyncJob:
        """Change a job's name, labels and note, at any time: `change(job, name="softer knees", note=None)`.

        None removes; what is left out stays, and so do labels that `labels` does not have.
        """
        answer = await self._request("PATCH", await self._job_path(job_id), json=changes)
        return AsyncJob.model_validate_json(answer.content, context=self)

    async def cancel_all(self, job_ids: Iterable[str] = (), **filters: Any) -> Sequence[OutcomeView]:
        """Cancel these jobs, or all that match the filters of `list`; what became of each.

        One that is refused stops no other.
        """
        return await self._all_at_once("/jobs/cancel", job_ids, filters)

    async def delete_all(self, job_ids: Iterable[str] = (), **filters: Any) -> Sequence[OutcomeView]:
        """Delete these ended jobs, or all that match the filters of `list`; what became of each.

        One that is refused stops no other. The files are removed within minutes.
        """
        return await self._all_at_once("/jobs/delete", job_ids, filters)

    async def _all_at_once(
        self, path: str, job_ids: Iterable[str], filters: Mapping[str, Any]
    ) -> Sequence[OutcomeView]:
        ids = [await self._full_id(job_id) for job_id in job_ids]
        wanted: list[dict[str, Any]] = [
            {"jobs": ids[at : at + _AT_ONCE]} for at in range(0, len(ids), _AT_ONCE)
        ]
        if filters:
            wanted.append({"filter": _query(filters)})
        outcomes = list[OutcomeView]()
        while wanted:
            answer = (await self._request("POST", path, json=wanted[0])).json()
            outcomes += [OutcomeView.model_validate(item) for item in answer["items"]]
            if answer["next"] is None:
                wanted.pop(0)
            else:
                wanted[0]["cursor"] = answer["next"]
        return outcomes

    async def specification(self, job_id: str) -> dict[str, Any]:
        """The job's specification with all defaults filled in, which can be submitted again."""
        return (await self._request("GET", await self._job_path(job_id, "specification"))).json()

    async def wait(self, job_id: str, timeout: float | None = None) -> AsyncJob:
        """The job once it has ended, however it ended. timeout: seconds; then it raises WaitTimeout."""
        deadline = None if timeout is None else time.monotonic() + timeout
        job = await self.get(job_id)
        if not job.is_final:
            async for _ in self._follow(job.id, deadline=deadline):
                pass
            job = await self.get(job.id)
        if not job.is_final:
            raise WaitTimeout(f"Job {job.id} is still {job.status} after {timeout:g} s; it continues.")
        return job

    def events(self, job_id: str, after: str | None = None) -> AsyncIterator[Event]:
        """The job's events, live, until it ends.

        Kinds: status, progress, metrics, artifact, phase.
        after: the id of the last event seen; later ones follow. Broken connections are resumed
        without a gap or a repetition.
        """
        return self._follow(job_id, after)

    def logs(self, job_id: str, follow: bool = False) -> AsyncIterator[str]:
        """The job's log, line by line; follow: also new lines, until the job ends."""
        return self._follow_log(job_id) if follow else self._log(job_id)

    async def _log(self, job_id: str) -> AsyncIterator[str]:
        answer = await self._request("GET", await self._job_path(job_id, "logs"))
        for line in answer.text.splitlines():
            yield line

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
        """All metrics so far, in the order of measurement.

        names: only these metrics. points: for pictures, at most this many values of each, the least and the
        greatest among them. as_: `pandas` or `polars` for a data frame with columns `step`, `time` and
        each metric; raises MissingExtra where that package is not installed.
        """
        frame = frames.maker(as_)  # Raises before anything is fetched.
        path = await self._job_path(job_id, "metrics")
        if points is not None:
            params = {"points": points, "metric": [*names]}
            return frame((await self._get(path, Metrics, params=params)).rows)
        rows, after = list[MetricsRow](), ""
        while True:
            page = await self._get(path, Metrics, params={"after": after})
            rows += page.rows
            if not page.rows or not page.next:
                return frame(frames.only(names, rows) if names else rows)
            after = page.next

    async def show(self, job_id: str, *, every_s: float = 1.0) -> None:
        """Follow a job in a notebook: its status, return and newest video stand below the cell until it ends.

        every_s: seconds between two looks. Raises MissingExtra outside a notebook.
        """
        display = notebook.Display()
        shown_at = time.monotonic()
        job = await self._shown(display, job_id)
        if job.is_final:
            return
        async for _ in self.events(job.id):
            if time.monotonic() - shown_at >= every_s:
                shown_at = time.monotonic()
                await self._shown(display, job.id)
        await self._shown(display, job.id)

    async def _shown(self, display: notebook.Display, job_id: str) -> AsyncJob:
        job = await self.get(job_id)
        display.show(job, await self._card(job, display.video_seen))
        return job

    async def card(self, job: JobView) -> Card:
        """The return and the video that a notebook shows of the job."""
        return await self._card(job, None)

    async def _card(self, job: JobView, video_seen: str | None) -> Card:
        """video_seen: the hash of a video that is shown already."""
        rows = (
            await self.metrics(job.id, names=frames.RETURNS, points=notebook.MOST_POINTS)
            if job.kind == "train"
            else ()
        )
        returns = notebook.returns_of(rows)
        video = job.newest("video")
        if video is None or video.sha256 == video_seen or video.size > notebook.MOST_BYTES:
            return Card(returns)
        return Card(returns, (await self._request("GET", video.href)).content)


def _query(filters: Mapping[str, Any]) -> dict[str, Any]:
    labels: Mapping[str, str] = filters.get("labels") or {}
    query = {name: value for name, value in filters.items() if value is not None and name != "labels"}
    return query | {"label": [f"{name}={value}" for name, value in labels.items()]}
