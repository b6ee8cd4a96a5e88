"""The sections of a report that are text, and the values of its curves."""

import json
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from datetime import datetime
from html import escape
from math import isfinite
from typing import Any, cast

from api.curves import thinned
from api.dependencies import Service
from api.sharing.export import versions
from core.algorithms.events import is_of_a_seed
from core.jobs import feeds
from core.jobs.job import Job
from core.jobs.resolved import filled_in
from gaitway.battery import shown_battery
from gaitway.frames import RETURNS

Curves = dict[str, tuple[list[int], list[float]]]  # The steps and finite values of each metric.
NEEDS_SCRIPTS = "This needs scripts, which run here without a network."
_POINTS = 400
_LOG_LINES = 200


def facts(job: Job) -> str:
    """The lines below the title: the job's kind, state, times and labels."""
    told = [job.spec.kind, job.spec.environment.id, job.id, str(job.status)]
    if job.progress.total:
        told.append(f"{job.progress.step:,} of {job.progress.total:,} steps")
    if job.started_at is not None:
        told.append(f"started {_moment(job.started_at)}")
    if job.started_at is not None and job.finished_at is not None:
        told.append(f"ran {(job.finished_at - job.started_at).total_seconds():,.0f} s")
    if (origin := job.imported_from) is not None:
        told.append(f"imported: job {origin.job} of a service with Gaitway {origin.version}")
    told += [f"{name}: {value}" for name, value in job.spec.labels.items()]
    lines = f'<p class="soft">{escape(" · ".join(told))}</p>'
    if job.spec.note is not None:
        lines += f'<p class="note">{escape(job.spec.note)}</p>'
    if not job.status.is_final:
        lines += "<p>The job has not ended: this is how it stood when the file was made.</p>"
    elif job.reason is not None and job.reason != "completed":
        lines += f"<p><strong>{escape(str(job.reason))}</strong>: {escape(job.message or '')}</p>"
    return lines


def sections(job: Job, service: Service) -> Iterator[str]:
    """The sections below the curves, in order."""
    yield from _batteries(job)
    yield section("Attempts", _attempts(job)) if job.attempts else ""
    yield section("Settings", _settings(job, service))
    yield section("Versions", _table(("", "Version"), _flat(versions(job))))
    yield section("Files", _files(job)) if job.artifacts else ""
    yield section("End of the log", f'<pre tabindex="0">{escape(_log(job, service))}</pre>')


def curves_of(job: Job, service: Service) -> Curves:
    """The curves of the job's metrics, thinned; those of single seeds and those never finite are left out."""
    measured, _ = feeds.read_curves(job.id, store=service.store, objects=service.objects)
    rows = thinned(measured, _POINTS)
    found: Curves = {}
    for name in sorted({name for row in rows for name in row.values if not is_of_a_seed(name)}):
        points = [(row.step, value) for row in rows if (value := row.values.get(name)) is not None]
        points = [(step, value) for step, value in points if isfinite(value)]
        if points:
            found[name] = ([step for step, _ in points], [value for _, value in points])
    return found


def curves_section(curves: Curves) -> str:
    """The last and best returns, and the place where `report/curves.js` draws the curves."""
    if not curves:
        return section("Curves", "<p>Nothing was measured.</p>")
    bests = [
        (name, f"{values[-1]:.6g}", f"{max(values):.6g}")
        for name, (_, values) in curves.items()
        if name in RETURNS
    ]
    table = _table(("Metric", "Last", "Best"), bests) if bests else ""
    held = json.dumps(curves).replace("<", "\\u003c")  # No value ends the element.
    return section(
        "Curves",
        f'<div id="curves"><noscript>{NEEDS_SCRIPTS}</noscript></div>{table}'
        f'<script type="application/json" id="curves-data">{held}</script>',
    )


def _batteries(job: Job) -> Iterator[str]:
    """The test of its policy, of each seed's."""
    for seed in job.seeds or (None,):
        file = job.newest("battery", seed=seed)
        found = None if file is None else shown_battery(file.metadata)
        if found is not None:
            of_seed = "" if seed is None else f" of seed {seed}"
            criteria = _table(("Quantity", "Value", "Bound", "Holds"), found.criteria)
            rows = _table(found.head, found.rows)
            content = f"<p>{escape(found.verdict)}</p>{criteria}{rows}<p>{escape(found.legend)}</p>"
            yield section(f"Battery{of_seed}", content)


def _attempts(job: Job) -> str:
    rows = [
        (
            str(one.number),
            one.worker,
            one.device or "–",
            one.engine or "–",
            _moment(one.started_at),
            f"{one.reason}: {one.message or ''}" if one.reason else "still running",
        )
        for one in job.attempts
    ]
    return _table(("#", "Worker", "Device", "Engine", "Started", "Ended because"), rows)


def _settings(job: Job, service: Service) -> str:
    """Every setting, and whether the job said it."""
    sent = {path for path, _ in _flat(job.spec.model_dump(mode="json", exclude_unset=True))}
    rows = [
        (path, value, "sent" if path in sent else "filled in")
        for path, value in _flat(filled_in(job, service.store))
    ]
    return (
        f"<details><summary>All {len(rows)}</summary>{_table(('Setting', 'Value', 'From'), rows)}</details>"
    )


def _files(job: Job) -> str:
    rows = [(one.name, str(one.role), size_in_words(one.size), one.sha256) for one in job.artifacts]
    return _table(("Name", "Role", "Size", "SHA-256"), rows)


def _log(job: Job, service: Service) -> str:
    """Its last lines, for which no more of it is read than they need."""
    lines = deque[str](maxlen=_LOG_LINES)
    marks = service.store.marks([job.id])
    after = max(0, marks[job.id].num_logs - _LOG_LINES) if job.id in marks else 0
    store, objects = service.store, service.objects
    for page in feeds.read_pages(job.id, "logs", store=store, objects=objects, after=after):
        lines.extend(str(entry.data.get("text", "")) for entry in page)
    return "\n".join(lines) or "The log is empty."


def section(title: str, content: str) -> str:
    """content: HTML."""
    return f"<section><h2>{title}</h2>{content}</section>"


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    top = "".join(f"<th>{escape(cell)}</th>" if cell else "<td></td>" for cell in head)
    body = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    table = f"<table><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table>"
    return f'<div class="table" tabindex="0">{table}</div>'


def _flat(document: Any, path: str = "") -> Iterator[tuple[str, str]]:
    """Each leaf of a document with its path; lists of plain values are leaves."""
    if isinstance(document, Mapping) and document:
        for name, value in cast("Mapping[str, Any]", document).items():
            yield from _flat(value, f"{path}.{name}" if path else name)
    elif isinstance(document, list) and any(isinstance(item, dict) for item in cast("list[Any]", document)):
        for number, value in enumerate(cast("list[Any]", document)):
            yield from _flat(value, f"{path}.{number}")
    else:
        yield path, document if isinstance(document, str) else json.dumps(document, ensure_ascii=False)


def size_in_words(size: int) -> str:
    """size: bytes."""
    for number, unit in ((1e9, "GB"), (1e6, "MB"), (1e3, "kB")):
        if size >= number:
            return f"{size / number:.1f} {unit}"
    return f"{size} bytes"


def _moment(time: datetime) -> str:
    return f"{time:%Y-%m-%d %H:%M:%S} UTC"
