# Made by .ci/make_client.py: change gaitway/async_client/jobs.py instead.
"""Jobs: submitted, listed, followed and shown."""

import time
import uuid
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, Literal, overload

from pydantic import PrivateAttr

from gaitway import frames, notebook
from gaitway.client.following import Following
from gaitway.concurrency import card_in_a_cell
from gaitway.errors import WaitTimeout
from gaitway.notebook import Card
from gaitway.schema import JobView, Metrics, MetricsRow, OutcomeView
from gaitway.views import Event, Page

# Jobs that one request may name.
_AT_ONCE = 200


class Job(JobView):
    """A job as it was when it was read, and the client that read it; read it again for news.

    A notebook's cell that ends with it shows it; `show` follows it there.
    """

    _client: "Jobs" = PrivateAttr()

    def model_post_init(self, context: Any) -> None:
        self._client = context

    def wait(self, timeout: float | None = None) -> "Job":
        """The job once it has ended; as the client's `wait`."""
        return self._client.wait(self.id, timeout)

    def show(self, *, every_s: float = 1.0) -> None:
        """Follow it in a notebook, below the cell, until it ends; as the client's `show`."""
        self._client.show(self.id, every_s=every_s)

    def _repr_html_(self) -> str:
        return notebook.job_html(self, card_in_a_cell(self._client, self))


class Jobs(Following):
    """The methods about whole jobs."""

    def submit(
        self, spec: Mapping[str, Any] | None = None, *, idempotency_key: str | None = None, **fields: Any
    ) -> Job:
        """Queue a job: `submit(environment="ant", algorithm={"kind": "ppo", "num_timesteps": 1_000_000})`.

        fields override those of `spec`; `kind` is `train` by default. Retries of the request create
        only one job. idempotency_key: extends this to several calls; the same key with another
        specification raises Conflict.
        """
        document = {"kind": "train", **(spec or {}), **fields}
        headers = {"Idempotency-Key": idempotency_key or uuid.uuid4().hex}
        return self._post("/jobs", Job, json=document, headers=headers)

    def check(self, spec: Mapping[str, Any] | None = None, **fields: Any) -> dict[str, Any]:
        """What `submit` would queue, with all defaults filled in; it raises the same, and stores nothing."""
        document = {"kind": "train", **(spec or {}), **fields}
        return (self._request("POST", "/jobs/check", json=document)).json()

    def get(self, job_id: str) -> Job:
        """The job as it is now."""
        return self._get(self._job_path(job_id), Job)

    def list(self, *, limit: int | None = None, **filters: Any) -> Iterator[Job]:
        """Jobs in brief, newest first, fetched page by page as needed; at most `limit`.

        Each has its newest ten attempts and files of each role; `get` has all.
        filters: status, kind, environment, name, search, owner, project, and labels (a dict, every one must
        match). sweep: a sweep's id, `"none"`, or `"folded"` for one of its trials. sort: another order, by a
        column such as `"return"` or `"label:arm"`, with order `"desc"` (the default) or `"asc"`.
        """
        return self._all("/jobs", Job, limit, _query(filters))

    def page(self, *, cursor: str | None = None, limit: int = 50, **filters: Any) -> Page[Job]:
        """One page of jobs, newest first; cursor: the `next` of an earlier page."""
        return self._page("/jobs", Job, cursor, limit, _query(filters))

    def cancel(self, job_id: str) -> Job:
        """Ask a job to stop; its checkpoint, metrics and video up to then are kept.

        Raises Conflict where the job has ended.
        """
        return self._post(self._job_path(job_id, "cancel"), Job)

    def delete(self, job_id: str) -> None:
        """Remove an ended job and its files. Raises Conflict while it runs."""
        self._request("DELETE", self._job_path(job_id))

    def change(self, job_id: str, **changes: Any) -> Job:
        """Change a job's name, labels and note, at any time: `change(job, name="softer knees", note=None)`.

        None removes; what is left out stays, and so do labels that `labels` does not have.
        """
        answer = self._request("PATCH", self._job_path(job_id), json=changes)
        return Job.model_validate_json(answer.content, context=self)

    def cancel_all(self, job_ids: Iterable[str] = (), **filters: Any) -> Sequence[OutcomeView]:
        """Cancel these jobs, or all that match the filters of `list`; what became of each.

        One that is refused stops no other.
        """
        return self._all_at_once("/jobs/cancel", job_ids, filters)

    def delete_all(self, job_ids: Iterable[str] = (), **filters: Any) -> Sequence[OutcomeView]:
        """Delete these ended jobs, or all that match the filters of `list`; what became of each.

        One that is refused stops no other. The files are removed within minutes.
        """
        return self._all_at_once("/jobs/delete", job_ids, filters)

    def _all_at_once(
        self, path: str, job_ids: Iterable[str], filters: Mapping[str, Any]
    ) -> Sequence[OutcomeView]:
        ids = [self._full_id(job_id) for job_id in job_ids]
        wanted: list[dict[str, Any]] = [
            {"jobs": ids[at : at + _AT_ONCE]} for at in range(0, len(ids), _AT_ONCE)
        ]
        if filters:
            wanted.append({"filter": _query(filters)})
        outcomes = list[OutcomeView]()
        while wanted:
            answer = (self._request("POST", path, json=wanted[0])).json()
            outcomes += [OutcomeView.model_validate(item) for item in answer["items"]]
            if answer["next"] is None:
                wanted.pop(0)
            else:
                wanted[0]["cursor"] = answer["next"]
        return outcomes

    def specification(self, job_id: str) -> dict[str, Any]:
        """The job's specification with all defaults filled in, which can be submitted again."""
        return (self._request("GET", self._job_path(job_id, "specification"))).json()

    def wait(self, job_id: str, timeout: float | None = None) -> Job:
        """The job once it has ended, however it ended. timeout: seconds; then it raises WaitTimeout."""
        deadline = None if timeout is None else time.monotonic() + timeout
        job = self.get(job_id)
        if not job.is_final:
            for _ in self._follow(job.id, deadline=deadline):
                pass
            job = self.get(job.id)
        if not job.is_final:
            raise WaitTimeout(f"Job {job.id} is still {job.status} after {timeout:g} s; it continues.")
        return job

    def events(self, job_id: str, after: str | None = None) -> Iterator[Event]:
        """The job's events, live, until it ends.

        Kinds: status, progress, metrics, artifact, phase.
        after: the id of the last event seen; later ones follow. Broken connections are resumed
        without a gap or a repetition.
        """
        return self._follow(job_id, after)

    def logs(self, job_id: str, follow: bool = False) -> Iterator[str]:
        """The job's log, line by line; follow: also new lines, until the job ends."""
        return self._follow_log(job_id) if follow else self._log(job_id)

    def _log(self, job_id: str) -> Iterator[str]:
        answer = self._request("GET", self._job_path(job_id, "logs"))
        yield from answer.text.splitlines()

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
        frame = frames.maker(as_)  # Raises before anything is fetched.
        path = self._job_path(job_id, "metrics")
        if points is not None:
            params = {"points": points, "metric": [*names]}
            return frame((self._get(path, Metrics, params=params)).rows)
        rows, after = list[MetricsRow](), ""
        while True:
            page = self._get(path, Metrics, params={"after": after})
            rows += page.rows
            if not page.rows or not page.next:
                return frame(frames.only(names, rows) if names else rows)
            after = page.next

    def show(self, job_id: str, *, every_s: float = 1.0) -> None:
        """Follow a job in a notebook: its status, return and newest video stand below the cell until it ends.

        every_s: seconds between two looks. Raises MissingExtra outside a notebook.
        """
        display = notebook.Display()
        shown_at = time.monotonic()
        job = self._shown(display, job_id)
        if job.is_final:
            return
        for _ in self.events(job.id):
            if time.monotonic() - shown_at >= every_s:
                shown_at = time.monotonic()
                self._shown(display, job.id)
        self._shown(display, job.id)

    def _shown(self, display: notebook.Display, job_id: str) -> Job:
        job = self.get(job_id)
        display.show(job, self._card(job, display.video_seen))
        return job

    def card(self, job: JobView) -> Card:
        """The return and the video that a notebook shows of the job."""
        return self._card(job, None)

    def _card(self, job: JobView, video_seen: str | None) -> Card:
        """video_seen: the hash of a video that is shown already."""
        rows = (
            self.metrics(job.id, names=frames.RETURNS, points=notebook.MOST_POINTS)
            if job.kind == "train"
            else ()
        )
        returns = notebook.returns_of(rows)
        video = job.newest("video")
        if video is None or video.sha256 == video_seen or video.size > notebook.MOST_BYTES:
            return Card(returns)
        return Card(returns, (self._request("GET", video.href)).content)


def _query(filters: Mapping[str, Any]) -> dict[str, Any]:
    labels: Mapping[str, str] = filters.get("labels") or {}
    query = {name: value for name, value in filters.items() if value is not None and name != "labels"}
    return query | {"label": [f"{name}={value}" for name, value in labels.items()]}
