"""All that is needed to run a job again elsewhere, as the members of a zip.

The zip is made while it is sent: no member is ever whole in memory, and nothing is written to disk.
"""

import io
import platform
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from importlib.metadata import version
from itertools import chain
from typing import Any
from zipfile import ZIP_DEFLATED, ZIP_STORED, ZipFile, ZipInfo

from pydantic_core import to_json

from api.curves import csv_lines, json_lines
from api.dependencies import Service
from api.views import job_view
from core.errors import ClipsNotFound, ModelNotFound, ObjectDamaged, ObjectNotFound
from core.jobs import feeds
from core.jobs.job import Artifact, Job
from core.jobs.metrics import Block, Newest
from core.jobs.resolved import filled_in, model_of
from core.jobs.spec import decoder_job, experts_of
from core.jobs.uploads import clip_files_of
from core.storage import keys
from core.storage.objects import check_whole, read_whole

# An older date cannot be said in a zip. A fixed one makes equal exports equal.
_WHEN = (1980, 1, 1, 0, 0, 0)
# Increase it when an older reader would misread the file.
FORMAT = 1
# Only the newest file of each of these roles is exported.
_NEWEST_ALONE = ("checkpoint", "video", "poster")
# Roles whose content is in the zip already, in a form that every program reads.
_LEFT_OUT = ("metrics", "log", "tensorboard", "wandb")
# A file up to this size is in memory at once, so that the object store is asked for it once.
_HELD_BYTES = 2**20
# The fastest: metrics take 30 % more bytes than at the usual level, and a quarter of its time.
_LEVEL = 1
# Each piece of an answer costs a change of threads.
_SENT_BYTES = 2**16
CLIPS_FOLDER = "clips/"
# Every training that ended well has these.
_EXPECTED = {"train": ("checkpoint", "policy", "video"), "rollout": ("trajectory", "video")}
_README = (
    "This is {what}, job {id} of a Gaitway service; contents.json lists all files with their SHA-256, and "
    "what is missing and why.\n"
    "To have it on another service, with its newest checkpoint to resume from and to roll out: gaitway "
    "import {id}.zip. To run it again from its first step: gaitway submit --file spec.json{model}.\n"
    "To look at it: metrics.csv, log.txt, files/video.mp4; a program elsewhere acts by files/policy.npz or "
    "files/policy.onnx.\n"
)


@dataclass(frozen=True)
class ZipMember:
    """A file of the zip. pieces: read as it is sent. compress: whether that makes it smaller."""

    path: str
    pieces: Iterable[bytes]
    compress: bool = True


class _Pipe(io.RawIOBase):
    """Takes what the zip writes. It cannot go back, so that a member's size follows its bytes."""

    def __init__(self) -> None:
        self._written = bytearray()

    def writable(self) -> bool:
        return True

    def write(self, piece: object) -> int:
        before = len(self._written)
        self._written += memoryview(piece)  # pyright: ignore[reportArgumentType] # whatever has bytes
        return len(self._written) - before

    def __len__(self) -> int:
        return len(self._written)

    def taken(self) -> bytes:
        taken = bytes(self._written)
        self._written.clear()
        return taken


def zip_stream(members: Iterable[ZipMember]) -> Iterator[bytes]:
    """The bytes of a zip (64-bit where needed) of these members, in pieces of 64 KiB or more.

    An error of a member's pieces ends it, so that what arrived has no directory and no program opens it.
    """
    pipe = _Pipe()
    with ZipFile(pipe, "w", allowZip64=True) as archive:
        for member in members:
            info = ZipInfo(member.path, _WHEN)
            info.compress_type = ZIP_DEFLATED if member.compress else ZIP_STORED
            info._compresslevel = _LEVEL  # pyright: ignore # Public from Python 3.13 on, as `compress_level`.
            info.external_attr = 0o644 << 16
            with archive.open(info, "w", force_zip64=True) as file:
                for piece in member.pieces:
                    file.write(piece)
                    if len(pipe) >= _SENT_BYTES:
                        yield pipe.taken()
    yield pipe.taken()


@dataclass
class _Contents:
    """The files that are in the zip, and those that are not, with the reason."""

    format: int = FORMAT
    files: list[dict[str, Any]] = field(default_factory=list[dict[str, Any]])
    missing: list[dict[str, str]] = field(default_factory=list[dict[str, str]])

    def lacks(self, part: str, why: str) -> None:
        self.missing.append({"part": part, "why": why})


def export(job: Job, service: Service) -> Iterator[ZipMember]:
    """The members, each read from the stores when it is sent. What is missing is named in `contents.json`.

    Raises RecordsUnavailable and StorageUnavailable, before the first member or in the middle of a later one.
    """
    contents = _Contents()
    spec = filled_in(job, service.store)
    newest = Newest(_metrics(job, service))
    yield _text("README.txt", _readme(job))
    yield _json("spec.json", spec)
    yield _json("job.json", job_view(job).model_dump(mode="json"))
    yield _json("versions.json", versions(job))
    yield ZipMember("metrics.csv", csv_lines(_metrics(job, service), newest))
    yield ZipMember("metrics.jsonl", json_lines(map(newest.of, _metrics(job, service))))
    yield ZipMember("log.txt", _log(job, service))
    yield from _model(job, service, contents)
    yield from _clips(job, service, contents)
    if (source := job.spec.source) is not None:
        contents.lacks(f"the checkpoint of job {source.job}", "that is another job, which has its own export")
    if (decoder := decoder_job(job.spec.environment)) is not None:
        contents.lacks(f"the decoder of job {decoder}", "that is another job, which has its own export")
    for expert in experts_of(job.spec):
        contents.lacks(f"the policy of job {expert}", "that is another job, which has its own export")
    yield from _files(job, service, contents)
    yield _json("contents.json", vars(contents))


def versions(job: Job) -> dict[str, Any]:
    """The versions of this service, and those that each attempt ran with, as its worker reported them."""
    return {
        "service": {"gaitway": version("gaitway"), "python": platform.python_version()},
        "attempts": [
            {
                "number": attempt.number,
                "device": attempt.device,
                "engine": attempt.engine,
                **{name: attempt.details.get(name) for name in ("python", "commit", "versions")},
            }
            for attempt in job.attempts
        ],
    }


def _readme(job: Job) -> str:
    what = f"a {'training' if job.spec.kind == 'train' else 'rollout'} of {job.spec.environment.id}"
    has_model = model_of(job.spec.environment) is not None
    model = " (after gaitway models add model/*)" if has_model else ""
    if clip_files_of(job.spec.environment):
        model += " (after gaitway clips add of each file that clips.json lists)"
    return _README.format(id=job.id, what=what, model=model)


def _log(job: Job, service: Service) -> Iterator[bytes]:
    for page in feeds.read_pages(job.id, "logs", store=service.store, objects=service.objects):
        yield "".join(f"{entry.data.get('text', '')}\n" for entry in page).encode("utf-8", "replace")


def _metrics(job: Job, service: Service) -> Iterator[Block]:
    parts = feeds.read_metrics(job.id, store=service.store, objects=service.objects)
    return (block for block, _ in parts)


def _model(job: Job, service: Service, contents: _Contents) -> Iterator[ZipMember]:
    """The user's own model, if the job has one."""
    model_id = model_of(job.spec.environment)
    if model_id is None:
        return
    try:
        record = service.store.models.find(model_id)
        suffix = "zip" if record.media_type == "application/zip" else "xml"
        name = f"model/{model_id.removeprefix('sha256:')[:12]}.{suffix}"
        sha256 = model_id.removeprefix("sha256:")
        key, shrinks = keys.model_source(model_id), suffix != "zip"
        yield from _stored(name, key, sha256, record.size, service, compress=shrinks)
    except ObjectDamaged as error:
        contents.lacks(f"the model {model_id}", f"it is damaged: {error.why}")
    except (ModelNotFound, ObjectNotFound):
        contents.lacks(f"the model {model_id}", "it was deleted")
    else:
        contents.files.append({"path": name, "sha256": model_id.removeprefix("sha256:"), "size": record.size})


def _clips(job: Job, service: Service, contents: _Contents) -> Iterator[ZipMember]:
    """The files of clips that the job names, as they were sent, and how each is read."""
    told: list[dict[str, Any]] = []
    for file_id in clip_files_of(job.spec.environment):
        name = f"{CLIPS_FOLDER}{file_id.removeprefix('sha256:')[:12]}"
        try:
            record = service.store.clips.find(file_id)
            key = keys.clip_file_source(file_id)
            yield from _stored(name, key, record.sha256, record.size, service, compress=True)
        except ObjectDamaged as error:
            contents.lacks(f"the clips {file_id}", f"they are damaged: {error.why}")
        except (ClipsNotFound, ObjectNotFound):
            contents.lacks(f"the clips {file_id}", "they were deleted")
        else:
            contents.files.append({"path": name, "sha256": record.sha256, "size": record.size})
            told.append({"path": name, "name": record.name, "body": record.body, "rate": record.rate})
    if told:
        yield _json("clips.json", {"files": told})


def _files(job: Job, service: Service, contents: _Contents) -> Iterator[ZipMember]:
    there = [artifact for artifact in job.artifacts if artifact.role not in _LEFT_OUT]
    chosen = [file for file in there if file.role not in _NEWEST_ALONE]
    newest = (job.newest(role, seed=seed) for role in _NEWEST_ALONE for seed in job.seeds or (None,))
    chosen += {file.name: file for file in newest if file is not None}.values()
    for file in chosen:
        path = f"files/{file.name}"
        try:
            yield from _stored(path, file.key, file.sha256, file.size, service, compress=_shrinks(file))
        except ObjectDamaged as error:
            contents.lacks(file.name, f"it is damaged: {error.why}")
        except ObjectNotFound:
            contents.lacks(file.name, "the object store no longer has it")
        else:
            contents.files.append({"path": path, "sha256": file.sha256, "size": file.size})
    for role in _EXPECTED[job.spec.kind]:
        if not any(file.role == role for file in there):
            contents.lacks(role, _why_none(job, role))


def _why_none(job: Job, role: str) -> str:
    if role == "video" and job.spec.video is None:
        return "the job asks for none"
    if not job.status.is_final:
        return f"the job is {job.status} and has none yet"
    return f"the job ended as {job.status} ({job.reason}) without one"


def _shrinks(file: Artifact) -> bool:
    return file.media_type.startswith("text/") or file.media_type == "application/json"


def _stored(
    path: str, key: str, sha256: str, size: int, service: Service, *, compress: bool
) -> Iterator[ZipMember]:
    """One object; a large one is read twice, first for its hash.

    Raises ObjectNotFound or ObjectDamaged before the member begins.
    """
    if size <= _HELD_BYTES:
        yield ZipMember(path, [read_whole(key, sha256, service.objects)], compress)
        return
    check_whole(key, sha256, service.objects)
    with service.objects.open(key) as pieces:
        yield ZipMember(path, pieces, compress)


def _text(path: str, text: str) -> ZipMember:
    return ZipMember(path, [text.encode()])


def _json(path: str, document: Mapping[str, Any]) -> ZipMember:
    return ZipMember(path, [to_json(document, indent=2), b"\n"])


def first_read(members: Iterable[Any]) -> Iterator[Any]:
    """The same, of which the first is read now: an error then arises before an answer has begun."""
    rest = iter(members)
    return chain([next(rest)], rest)
