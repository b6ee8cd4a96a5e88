"""A job's events, metrics and log."""

import time
from collections.abc import Sequence
from functools import partial
from typing import Any

from gaitway import frames, notebook
from gaitway.calls.asking import Asking, job_path, of_a_job
from gaitway.errors import WaitTimeout
from gaitway.following import follow_feed, follow_log
from gaitway.steps import Call, Feed, Found, read_through
from gaitway.views import Event, JobView, MetricsRow


class FollowingCalls(Asking):
    """Calls that follow a job."""

    @of_a_job
    def wait(self, job_id: str, timeout: float | None) -> Call[JobView]:
        deadline = None if timeout is None else time.monotonic() + timeout
        job = yield from self.get(job_id)
        if not job.is_final:
            yield from read_through(self.events(job_id, None, deadline))
            job = yield from self.get(job_id)
        if not job.is_final:
            raise WaitTimeout(f"Job {job_id} is still {job.status} after {timeout:g} s; it continues.")
        return job

    @of_a_job
    def events(self, job_id: str, after: str | None, deadline: float | None = None) -> Feed:
        has_ended = partial(self._has_ended, job_id)
        return follow_feed(self.retry, job_path(job_id, "events"), has_ended, after, deadline)

    def metrics(self, job_id: str, names: Sequence[str], points: int | None, as_: str) -> Call[Any]:
        frame = frames.maker(as_)  # What is missing is said before anything is fetched.
        job_id = yield from self._full_id(job_id)
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

    @of_a_job
    def logs(self, job_id: str, follow: bool) -> Feed:
        path = job_path(job_id, "logs")
        if follow:
            yield from follow_log(self.retry, path, partial(self._has_ended, job_id))
            return
        answer = yield from self._ask("GET", path)
        for line in answer.text.splitlines():
            yield Found(line)

    @of_a_job
    def curve(self, job_id: str, names: Sequence[str]) -> Call[str]:
        answer = yield from self._ask("GET", job_path(job_id, "curve"), params={"metric": list(names)})
        return answer.text

    @of_a_job
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
        """A job as a notebook shows it. video_seen: the hash of a video that is shown already."""
        curve = (yield from self.curve(job.id, ())) if job.kind == "train" else None
        video = job.newest("video")
        if video is None or video.sha256 == video_seen or video.size > notebook.MOST_BYTES:
            return notebook.Card(curve, None)
        answer = yield from self._ask("GET", video.href)
        return notebook.Card(curve, answer.content)
