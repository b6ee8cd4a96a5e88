"""A job in a notebook. IPython is imported where something is shown live."""

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING, Any

from gaitway.errors import MissingExtra
from gaitway.frames import RETURNS, sparkline

if TYPE_CHECKING:
    from gaitway.schema import JobView, MetricsRow

# A larger video is not put into a notebook, which would grow by a third more.
MOST_BYTES = 16 * 2**20
MOST_POINTS = 200
_COLOURS = {"succeeded": "#1a7f37", "failed": "#c62828", "cancelled": "#9a6700"}


@dataclass(frozen=True)
class Card:
    """The fetched parts of a job. returns: so far; video: an MP4. problem: why something is missing."""

    returns: Sequence[float] = ()
    video: bytes | None = None
    problem: str | None = None


def job_html(job: "JobView", card: Card) -> str:
    """The job's status and progress, its return and its video: markup that needs nothing else."""
    parts = [_head(job), _returns(card), _video(job, card.video)]
    if card.problem:
        parts.append(f"<p><em>{escape(card.problem)}</em></p>")
    return f'<div style="max-width:720px">{"".join(filter(None, parts))}</div>'


class Display:
    """A place under a cell, whose content is replaced. video_seen: the hash of the video that it shows.

    Raises MissingExtra without IPython, and outside a notebook.
    """

    def __init__(self) -> None:
        try:
            from IPython import display, get_ipython
        except ImportError as error:
            raise MissingExtra(
                "Showing a job live needs IPython, which notebooks have; elsewhere use `gaitway watch`."
            ) from error
        if get_ipython() is None:
            raise MissingExtra("A job is shown live in a notebook alone; elsewhere use `gaitway watch`.")
        self._ipython: Any = display
        self._places: dict[str, Any] = {}
        self.video_seen: str | None = None

    def show(self, job: "JobView", card: Card) -> None:
        """Replace what is shown; the video only by another one."""
        self._put("job", repr(job), _head(job) + _returns(card))
        if card.video is not None:
            newest = job.newest("video")
            self.video_seen = newest.sha256 if newest else None
            self._put("video", f"<video of {job.id}>", _video(job, card.video))

    def _put(self, place: str, text: str, html: str) -> None:
        bundle = {"text/plain": text, "text/html": f'<div style="max-width:720px">{html}</div>'}
        if place in self._places:
            self._places[place].update(bundle, raw=True)
        else:
            self._places[place] = self._ipython.display(bundle, raw=True, display_id=True)


def _head(job: "JobView") -> str:
    colour = _COLOURS.get(job.status, "#0b63ce")
    why = f" ({job.reason})" if job.reason and job.reason != "completed" else ""
    facts = [job.kind, job.environment or "", job.id]
    progress = job.progress
    if progress.total:
        facts.append(f"{progress.step:,} of {progress.total:,} steps")
    if progress.steps_per_second:
        facts.append(f"{progress.steps_per_second:,.0f} steps/s")
    if progress.eta_s is not None and not job.is_final:
        facts.append(f"{progress.eta_s:,.0f} s left")
    head = (
        f"<p><strong>{escape(job.name or job.environment or job.id)}</strong> "
        f'<span style="color:{colour}">{escape(job.status + why)}</span><br>'
        f"<small>{escape(' · '.join(filter(None, facts)))}</small></p>"
    )
    if progress.total and not job.is_final:
        head += f'<progress value="{progress.step}" max="{progress.total}" style="width:100%"></progress>'
    if job.message and not job.succeeded:
        head += f"<p>{escape(job.message)}</p>"
    return head


def returns_of(rows: Sequence["MetricsRow"]) -> list[float]:
    """The finite returns of evaluations in order, or, before there is one, of training."""
    for name in RETURNS:
        measured = (row.values.get(name) for row in rows)
        if returns := [value for value in measured if value is not None]:
            return returns
    return []


def _returns(card: Card) -> str:
    """The return in one line of characters, and its last value."""
    if not card.returns:
        return ""
    last = card.returns[-1]
    return f"<p>return {sparkline(card.returns)} {f'{last:,.1f}' if abs(last) >= 100 else f'{last:.4g}'}</p>"


def _video(job: "JobView", video: bytes | None) -> str:
    newest = job.newest("video")
    if video is not None:
        return (
            '<video controls loop muted playsinline style="max-width:100%" '
            f'src="data:video/mp4;base64,{_base64(video)}"></video>'
        )
    if newest is not None and newest.size > MOST_BYTES:
        size = f"{newest.size / 1e6:,.0f} MB"
        return f"<p>The video has {size}: fetch it with <code>client.video(job.id)</code>.</p>"
    return ""


def _base64(content: bytes) -> str:
    return base64.b64encode(content).decode()
