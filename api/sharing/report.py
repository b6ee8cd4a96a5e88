"""A report on a job: one HTML file that needs no network and no other file."""

from base64 import b64encode
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from enum import Enum, auto
from html import escape

from api.dependencies import Service
from api.page_files import embedded_modules, page_files
from api.sharing.report_sections import (
    NEEDS_SCRIPTS,
    curves_of,
    curves_section,
    facts,
    section,
    sections,
    size_in_words,
)
from core.errors import ObjectNotFound
from core.jobs.job import Artifact, Job
from core.storage.objects import check_whole

# The file needs no other file and no network, and no script in it runs but the viewers of curves and replay.
POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:; media-src data:"
_VIEWERS_POLICY = (
    "default-src 'none'; style-src 'unsafe-inline'; img-src data: blob:; media-src data:; script-src "
)
_MOST_REPLAY_BYTES = 32_000_000
_CURVES, _REPLAY = "report/curves.js", "report/replay.js"
_STYLE = """
:root{color-scheme:light dark;--line:#d0d7de;--soft:#57606a;--shade:#eceff2;--paper:#fff}
:root{--curve-1:#0072b2;--curve-2:#d55e00;--accent:#0072b2}
@media(prefers-color-scheme:dark){:root{--line:#3d444d;--soft:#9aa5b1;--shade:#22262b;--paper:#15171a}
:root{--curve-1:#56b4e9;--curve-2:#e69f00;--accent:#56b4e9}}
body{font:15px/1.5 system-ui,sans-serif;max-width:64rem;margin:2rem auto;padding:0 1rem}
body{background:var(--paper);overflow-wrap:anywhere}
h1{font-size:1.5rem;margin:0}h2{font-size:1.1rem;margin:2rem 0 .5rem}
.note{white-space:pre-wrap}
.soft{color:var(--soft)}video{max-width:100%;height:auto}figure{margin:1rem 0}.chart h2{margin:0}
.halves{display:grid;gap:1rem;grid-template-columns:repeat(auto-fit,minmax(min(20rem,100%),1fr))}
.table{overflow-x:auto}table{border-collapse:collapse;width:100%}
td,th{text-align:left;padding:.2rem .6rem .2rem 0;border-bottom:1px solid var(--line);vertical-align:top}
table{overflow-wrap:break-word}td:nth-child(4):last-child{overflow-wrap:anywhere;min-width:17rem}
pre{overflow:auto;max-height:24rem;border:1px solid var(--line);padding:.6rem}
.replay .tools{display:flex;flex-wrap:wrap;gap:.4rem 1rem;align-items:center}
.replay .slider input{width:100%;margin:0}
.replay .facts{color:var(--soft)}.replay button,.replay select{font:inherit;min-height:2rem}
"""


@dataclass(frozen=True)
class _Held:
    """A stored file inside the report, in base64. size: its bytes."""

    size: int
    pieces: Iterable[bytes]

    def __len__(self) -> int:
        return -(-self.size // 3) * 4


@dataclass(frozen=True)
class _Replay:
    """The data from which the page's modules show a replay."""

    scene: _Held
    poses: _Held


class _NoReplay(Enum):
    """Why a replay that the job has is not in the report."""

    TOO_LARGE = auto()
    GONE = auto()


@dataclass(frozen=True)
class ReportFile:
    """The file in parts, of which stored files are read as they are sent. policy: under which it works."""

    policy: str
    parts: Sequence[bytes | _Held]

    def pieces(self) -> Iterator[bytes]:
        for part in self.parts:
            yield from _as_base64(part.pieces) if isinstance(part, _Held) else [part]


@contextmanager
def open_report(job: Job, service: Service) -> Generator[ReportFile]:
    """The report; within the context its files are open. Raises RecordsUnavailable, StorageUnavailable."""
    with ExitStack() as opened:

        def hold(file: Artifact | None) -> _Held | None:
            if file is not None:
                with suppress(ObjectNotFound):  # Or damaged: the report then says so.
                    check_whole(file.key, file.sha256, service.objects)
                    return _Held(file.size, opened.enter_context(service.objects.open(file.key)))
            return None

        film, replay = job.newest("video"), _replay_of(job, hold)
        parts = [*_video(job, film, hold(film)), *_replay_section(replay)]
        curves = curves_of(job, service)
        entries = [_CURVES] * bool(curves) + [_REPLAY] * isinstance(replay, _Replay)
        viewers = embedded_modules(*entries) if entries else None
        policy = POLICY if viewers is None else _VIEWERS_POLICY + viewers.policy
        after = "".join([curves_section(curves), *sections(job, service), viewers.html if viewers else ""])
        yield _whole(policy, [f"{_head(job, policy)}{facts(job)}".encode(), *parts, after.encode()])


def _whole(policy: str, parts: Sequence[bytes | _Held]) -> ReportFile:
    size = size_in_words(sum(map(len, parts)))
    end = f'<p class="soft">This file has {size} and needs no network.</p></main></body></html>\n'
    return ReportFile(policy, [*parts, end.encode()])


def _head(job: Job, policy: str) -> str:
    title = escape(job.spec.name or job.spec.environment.id)
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{title}</title><style>{_STYLE}{_viewers_style()}</style></head><body><main><h1>{title}</h1>"
    )


def _viewers_style() -> str:
    return "".join(
        page_files().by_path[path].content.decode() for path in ("vendor/uplot.css", "style/viewers.css")
    )


def _video(job: Job, film: Artifact | None, held: _Held | None) -> Iterator[bytes | _Held]:
    yield b"<h2>Video</h2>"
    if held is None:
        yield f"<p>{escape(_why_no_video(job, film))}</p>".encode()
    else:
        yield b'<video controls loop muted playsinline src="data:video/mp4;base64,'
        yield held
        yield b'"></video>'


def _why_no_video(job: Job, film: Artifact | None) -> str:
    if film is not None:
        return f"The object store does not give {film.name} whole any more."
    if job.spec.video is None:
        return "The job asks for none."
    return "There is none yet." if not job.status.is_final else f"The job ended as {job.status} without one."


def _replay_of(job: Job, hold: Callable[[Artifact | None], _Held | None]) -> _Replay | _NoReplay | None:
    """The job's replay, or why the report does without it; None where the job has none."""
    scene, poses = job.newest("scene"), job.newest("replay")
    if poses is None:
        return None
    if scene is not None and scene.size + poses.size > _MOST_REPLAY_BYTES:
        return _NoReplay.TOO_LARGE
    held_scene, held_poses = hold(scene), hold(poses)
    if held_scene is None or held_poses is None:
        return _NoReplay.GONE
    return _Replay(held_scene, held_poses)


def _replay_section(replay: _Replay | _NoReplay | None) -> Iterator[bytes | _Held]:
    """The place of the replay, and what it shows; a job without one has no such section."""
    match replay:
        case None:
            return
        case _NoReplay.TOO_LARGE:
            most = size_in_words(_MOST_REPLAY_BYTES)
            why = f"It is larger than {most}, so that only the job's page shows it."
            yield section("Replay", f"<p>{why}</p>").encode()
        case _NoReplay.GONE:
            yield section("Replay", "<p>The object store does not give it whole any more.</p>").encode()
        case _Replay():
            waiting = f"<noscript>{NEEDS_SCRIPTS}</noscript>"
            yield section("Replay", f'<div id="replay">{waiting}</div>').encode()
            for name, file in (("replay-scene", replay.scene), ("replay-poses", replay.poses)):
                yield f'<script type="text/plain" id="{name}">'.encode()
                yield file
                yield b"</script>"


def _as_base64(pieces: Iterable[bytes]) -> Iterator[bytes]:
    """Encoded in multiples of 3 bytes, so that only the last piece is padded."""
    rest = b""
    for piece in pieces:
        rest += piece
        whole = len(rest) - len(rest) % 3
        yield b64encode(rest[:whole])
        rest = rest[whole:]
    yield b64encode(rest)
