"""A report on a job: one HTML file that needs no network, no script and no other file."""

import json
from base64 import b64encode
from collections import deque
from collections.abc import Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from datetime import datetime
from html import escape
from typing import Any, cast

from api.dependencies import Service
from api.sharing.curve_svg import RETURNS, curve_svg, lines_of
from api.sharing.export import versions
from api.views import MetricsRow
from core.errors import ObjectNotFound
from core.jobs import feeds
from core.jobs.filled_in import filled_in
from core.jobs.job import Artifact, Job

_POINTS = 400
_LOG_LINES = 200
# The file needs no other file and no network, and no script in it runs.
POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:; media-src data:"
_STYLE = """
:root{color-scheme:light dark;--line:#d0d7de;--soft:#57606a}
@media(prefers-color-scheme:dark){:root{--line:#3d444d;--soft:#9aa5b1}}
body{font:15px/1.5 system-ui,sans-serif;max-width:64rem;margin:2rem auto;padding:0 1rem}
body{overflow-wrap:anywhere}
h1{font-size:1.5rem;margin:0}h2{font-size:1.1rem;margin:2rem 0 .5rem}
.soft{color:var(--soft)}video,svg{max-width:100%;height:auto}
.halves{display:grid;gap:1rem;grid-template-columns:repeat(auto-fit,minmax(min(20rem,100%),1fr))}
.table{overflow-x:auto}table{border-collapse:collapse;width:100%}
td,th{text-align:left;padding:.2rem .6rem .2rem 0;border-bottom:1px solid var(--line);vertical-align:top}
pre{overflow:auto;max-height:24rem;border:1px solid var(--line);padding:.6rem}
"""


@dataclass(frozen=True)
class Report:
    """The file in three parts, of which the video is read as it is sent."""

    before: bytes
    video: Iterable[bytes]
    after: bytes

    def pieces(self) -> Iterator[bytes]:
        yield self.before
        yield from _as_base64(self.video)
        yield self.after


@contextmanager
def open_report(job: Job, service: Service) -> Generator[Report]:
    """The report; within the context its video is open. Raises RecordsUnavailable, StorageUnavailable."""
    with ExitStack() as opened:
        newest, pieces = job.newest("video"), None
        if newest is not None:
            with suppress(ObjectNotFound):  # The report then says so.
                pieces = opened.enter_context(service.objects.open(newest.key))
        yield _report(job, service, newest, pieces)


def _report(job: Job, service: Service, video: Artifact | None, pieces: Iterable[bytes] | None) -> Report:
    before = f"{_head(job)}{_facts(job)}"
    if pieces is not None:
        before += '<h2>Video</h2><video controls loop muted playsinline src="data:video/mp4;base64,'
    num_encoded = -(-video.size // 3) * 4 if video is not None and pieces is not None else 0
    after = '"></video>' if pieces is not None else _no_video(job, video)
    after += "".join(section for section in _sections(job, service))
    size = len(before.encode()) + num_encoded + len(after.encode())
    after += f'<p class="soft">This file has {_bytes(size)} and needs no network.</p></body></html>\n'
    return Report(before.encode(), pieces or (), after.encode())


def _sections(job: Job, service: Service) -> Iterator[str]:
    """The sections below the video, in order. A replay of the body in 3D would come first."""
    yield _curves(job, service)
    yield _section("Attempts", _attempts(job)) if job.attempts else ""
    yield _section("Settings", _settings(job, service))
    yield _section("Versions", _table(("", "Version"), _flat(versions(job))))
    yield _section("Files", _files(job)) if job.artifacts else ""
    yield _section("End of the log", f'<pre tabindex="0">{escape(_log(job, service))}</pre>')


def _head(job: Job) -> str:
    title = escape(job.spec.name or job.spec.environment.id)
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{title}</title><style>{_STYLE}</style></head><body><h1>{title}</h1>"
    )


def _facts(job: Job) -> str:
    facts = [job.spec.kind, job.spec.environment.id, job.id, str(job.status)]
    if job.progress.total:
        facts.append(f"{job.progress.step:,} of {job.progress.total:,} steps")
    if job.started_at is not None:
        facts.append(f"started {_moment(job.started_at)}")
    if job.started_at is not None and job.finished_at is not None:
        facts.append(f"ran {(job.finished_at - job.started_at).total_seconds():,.0f} s")
    if (origin := job.imported_from) is not None:
        facts.append(f"imported: job {origin.job} of a service with Gaitway {origin.version}")
    facts += [f"{name}: {value}" for name, value in job.spec.labels.items()]
    told = f'<p class="soft">{escape(" · ".join(facts))}</p>'
    if not job.status.is_final:
        told += "<p>The job has not ended: this is how it stood when the file was made.</p>"
    elif job.reason is not None and job.reason != "completed":
        told += f"<p><strong>{escape(str(job.reason))}</strong>: {escape(job.message or '')}</p>"
    return told


def _no_video(job: Job, video: Artifact | None) -> str:
    if video is not None:
        why = f"The object store no longer has {video.name}."
    elif job.spec.video is None:
        why = "The job asks for none."
    else:
        why = (
            "There is none yet." if not job.status.is_final else f"The job ended as {job.status} without one."
        )
    return f"<h2>Video</h2><p>{escape(why)}</p>"


def _curves(job: Job, service: Service) -> str:
    with service.curves.curves(job.id, None) as (curves, _):
        rows = curves.thinned(None, _POINTS, None, None)
    names = sorted({name for row in rows for name in row.values} - set(RETURNS))
    if not rows:
        return _section("Curves", "<p>Nothing was measured.</p>")
    others = "".join(curve_svg(lines_of(rows, [name]), name) for name in names)
    more = (
        f'<details><summary>{len(names)} other metrics</summary><div class="halves">{others}</div></details>'
    )
    return _section(
        "Return", curve_svg(lines_of(rows, RETURNS), "Return") + _bests(rows) + more * bool(names)
    )


def _bests(rows: Sequence[MetricsRow]) -> str:
    lines = lines_of(rows, RETURNS)
    found = [(one.name, f"{one.values[-1]:.6g}", f"{max(one.values):.6g}") for one in lines]
    return _table(("Metric", "Last", "Best"), found) if found else ""


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
    rows = [(one.name, str(one.role), _bytes(one.size), one.sha256) for one in job.artifacts]
    return _table(("Name", "Role", "Size", "SHA-256"), rows)


def _log(job: Job, service: Service) -> str:
    lines = deque[str](maxlen=_LOG_LINES)
    for page in feeds.read_pages(job.id, "logs", store=service.store, objects=service.objects):
        lines.extend(str(entry.data.get("text", "")) for entry in page)
    return "\n".join(lines) or "The log is empty."


def _section(title: str, content: str) -> str:
    return f"<section><h2>{title}</h2>{content}</section>"


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    top = "".join(f"<th>{escape(cell)}</th>" for cell in head)
    body = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    return f'<div class="table"><table><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table></div>'


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


def _as_base64(pieces: Iterable[bytes]) -> Iterator[bytes]:
    """Encoded in multiples of 3 bytes, so that only the last piece is padded."""
    rest = b""
    for piece in pieces:
        rest += piece
        whole = len(rest) - len(rest) % 3
        yield b64encode(rest[:whole])
        rest = rest[whole:]
    yield b64encode(rest)


def _bytes(size: int) -> str:
    for number, unit in ((1e9, "GB"), (1e6, "MB"), (1e3, "kB")):
        if size >= number:
            return f"{size / number:.1f} {unit}"
    return f"{size} bytes"


def _moment(time: datetime) -> str:
    return f"{time:%Y-%m-%d %H:%M:%S} UTC"
