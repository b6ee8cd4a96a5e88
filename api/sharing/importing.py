"""An export, as `api.sharing.export` writes it, becomes a job of this service."""

from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from math import isfinite
from typing import Annotated, Any, TypeVar

import msgspec
from msgspec import Meta
from pydantic import BaseModel, TypeAdapter, ValidationError
from pydantic_core import from_json, to_json

from api.dependencies import Service
from api.sentences import body_problems
from api.sharing.archive import (
    FIRST_MOMENT,
    LAST_MOMENT,
    ArchiveFormat,
    ArchiveRow,
    Contents,
    JobArchive,
    Record,
    Versions,
)
from api.sharing.export import CLIPS_FOLDER, FORMAT
from api.submissions import parse
from core.accounts.principal import Ownership
from core.algorithms.catalog import reported
from core.bounds import LARGEST_STEP, LONGEST_NAME, MOST_IN_A_ROW, MOST_METRICS
from core.environments import catalog
from core.errors import BadExport, ClipsNotFound, EnvironmentNotFound, ModelNotFound, Rejected
from core.jobs.feeds import MAX_METRICS_BYTES
from core.jobs.job import Artifact, Attempt, Job, Origin, Progress, new_job_id
from core.jobs.metrics import Block, Measurement
from core.jobs.resolved import filled_in, resolve_environment
from core.jobs.spec import JOB_SPEC, JobSpec
from core.jobs.status import JobStatus
from core.jobs.store import Entry, status_entry
from core.jobs.submission import ImportedFile, ImportedRun, check_readable_uploads
from core.jobs.uploads import clip_files_of
from core.reasons import Reason
from core.storage import keys
from core.uploads import library

Document = TypeVar("Document", bound=BaseModel)

_FILES = "files/"
# No field is unknown here, so no known one is named.
_ANY: TypeAdapter[Any] = TypeAdapter(dict[str, Any])
MOST_LINES = 300_000
# A zip of a few MiB may hold gigabytes of text. Reading a million values takes a second.
MOST_VALUES = 1_000_000
MOST_LOG_BYTES = 2**26
# Rows that have the same names are of one kind; a training has two or three.
_MOST_KINDS_OF_ROWS = 200
# A row is so many numbers besides its values, each of 8 bytes.
_NUMBERS_OF_A_ROW, _NUMBER_BYTES = 3, 8
_UNFINISHED = "It was {status} when it was exported; this is what it had then."


class _Row(msgspec.Struct):
    """An `ArchiveRow`, read in a fifth of the time. What is no row here may still be one there."""

    step: Annotated[int, Meta(ge=0, le=LARGEST_STEP)]
    time: Annotated[datetime, Meta(tz=True)]
    values: Annotated[
        dict[Annotated[str, Meta(max_length=LONGEST_NAME)], float | None], Meta(max_length=MOST_IN_A_ROW)
    ]


_decoder = msgspec.json.Decoder(_Row)


@dataclass(frozen=True)
class _Log:
    """The lines of the log, which are read from the archive each time."""

    archive: JobArchive

    def __iter__(self) -> Iterator[str]:
        return (line.decode(errors="replace") for line in self.archive.lines("log.txt"))


def read_run(
    archive: JobArchive, service: Service, ownership: Ownership, readable: Collection[str] | None
) -> ImportedRun:
    """The run under a new id. All of the archive has been read and checked. Raises BadExport.

    readable: the projects whose models and clips the job may use; None: all.
    """
    _check_format(archive)
    contents = _parsed(archive, "contents.json", Contents)
    record = _parsed(archive, "job.json", Record)
    version = _parsed(archive, "versions.json", Versions).service.gaitway
    archive.document("spec.json")  # Every export has one; the record has the specification as it was sent.
    metrics = _blocks(_rows(archive))
    end = record.finished_at or _last_moment(record, metrics)
    now = service.store.now()
    job = _job(record, end, Origin(job=record.id, version=version, imported_at=now))
    _check_job(job, readable, service)
    files = _files(archive, contents, record, job.id)
    facts = {"owner": ownership.owner, "project": ownership.project}
    job = job.model_copy(update={"artifacts": tuple(file.artifact for file in files), **facts})
    _check_log(archive)
    return ImportedRun(job, files, metrics, _events(job), _Log(archive))


def _check_format(archive: JobArchive) -> None:
    found = _parsed(archive, "contents.json", ArchiveFormat).format
    if found > FORMAT:
        raise BadExport(
            f"A newer version of Gaitway wrote this export: it has the format {found}, and this service "
            f"reads formats up to {FORMAT}. Import it into a newer one."
        )


def _parsed(archive: JobArchive, name: str, kind: type[Document]) -> Document:
    body = archive.document(name)
    try:
        return kind.model_validate_json(body)
    except ValidationError as error:
        raise _unreadable(name, error, body) from None


def _unreadable(name: str, error: ValidationError, body: bytes) -> BadExport:
    first = error.errors(include_url=False)[0]
    place = "/".join(map(str, first["loc"]))
    if first["type"] in ("enum", "literal_error"):
        known = f"This version of Gaitway does not know {first['input']!r:.100}, which {name} has at {place}"
        return BadExport(f"{known}: import it into the version that made it, or a newer one.")
    if first["type"] == "json_invalid":
        return BadExport(f"{name} is not that of an export: {first['msg']}.")
    [problem] = body_problems([first], from_json(body), _ANY)
    detail = f"{name} is not that of an export: {place}{': ' if place else ''}{problem.detail}"
    return BadExport(detail, f"/{name.partition(',')[0]}{problem.pointer}")


def _job(record: Record, end: datetime, origin: Origin) -> Job:
    """The record under a new id, without files. One that had not ended has ended with its export."""
    if [attempt.number for attempt in record.attempts] != list(range(1, len(record.attempts) + 1)):
        raise BadExport("job.json is not that of an export: its attempts are not numbered 1, 2, 3, ….")
    attempts = [
        Attempt(**dict(attempt), token=Job.token_of(attempt.number, "imported"))
        for attempt in record.attempts
    ]
    progress = record.progress
    metrics = progress.metrics.items()
    measured = {name: value for name, value in metrics if value is not None and isfinite(value)}
    job = Job(
        id=new_job_id(origin.imported_at),
        spec=_spec(record),
        status=record.status,
        reason=record.reason,
        message=record.message,
        created_at=record.created_at,
        started_at=record.started_at,
        finished_at=end,
        attempts=tuple(attempts),
        progress=Progress.model_validate({**dict(progress), "metrics": measured}),
        imported_from=origin,
    )
    if job.status.is_final:
        return job
    held = job.model_copy(update={"status": JobStatus.CANCELLING})
    message = _UNFINISHED.format(status=record.status)
    return held.ended(JobStatus.CANCELLED, Reason.EXPORTED_UNFINISHED, message, end)


def _spec(record: Record) -> JobSpec:
    try:
        return parse(to_json(record.spec), JOB_SPEC)
    except Rejected as error:
        raise BadExport(
            f"This version of Gaitway does not accept the job's specification: {error.detail}"
        ) from None


def _last_moment(record: Record, metrics: Iterable[Block]) -> datetime:
    """The latest time that the export has of a run that had not ended."""
    found = [record.created_at, record.started_at]
    found += [time for attempt in record.attempts for time in (attempt.started_at, attempt.ended_at)]
    tables = [table for block in metrics for table in block.tables.values()]
    found += [datetime.fromtimestamp(max(table.times), UTC) for table in tables]
    return max(time for time in found if time is not None)


def _check_job(job: Job, readable: Collection[str] | None, service: Service) -> None:
    """Refuse a job that could be stored and then not be used."""
    environment = job.spec.environment
    try:
        if catalog.find(environment.id).takes_model:
            model = str(environment.options.get("model"))
            library.find(model, service.store.models)
            owners = service.store.models.owners_of([model]).get(model, ())
            # Whoever may export it would have the model's file.
            if readable is not None and not any(one.project in readable for one in owners):
                raise ModelNotFound(model)
        for clips in clip_files_of(environment):
            library.find(clips, service.store.clips)
        # Whoever may export it would have the file.
        check_readable_uploads(environment, readable, service.store)
        resolve_environment(environment, service.store)
        for attempt in job.attempts:
            if "hyperparameters" in attempt.details:
                reported(attempt.details["hyperparameters"])
        filled_in(job, service.store)
    except ModelNotFound as error:
        raise BadExport(
            f"The job uses the model {error.facts['model']}, which this service does not have: unpack the "
            "zip, send the model by `gaitway models add model/*`, and import the zip again."
        ) from None
    except ClipsNotFound as error:
        raise BadExport(
            f"The job uses the clips {error.facts['clips']}, which this service does not have: unpack the "
            "zip, send each file in `clips/` by `gaitway clips add` as clips.json says, and import it again."
        ) from None
    except (EnvironmentNotFound, Rejected) as error:
        raise BadExport(f"This service cannot have the job: {error.detail}") from None
    except (KeyError, TypeError, ValueError) as error:  # pydantic's errors are ValueErrors.
        raise BadExport(
            "This version of Gaitway does not know the hyperparameters that an attempt used."
        ) from error


def _files(archive: JobArchive, contents: Contents, record: Record, job_id: str) -> list[ImportedFile]:
    """The files that the record and the archive have; a model's and clips' are checked only."""
    listed = {file.path for file in contents.files}
    if len(listed) < len(contents.files):
        raise BadExport("contents.json lists a file twice.")
    if (
        unlisted := {name for name in archive.names if name.startswith((_FILES, "model/", CLIPS_FOLDER))}
        - listed
    ):
        raise BadExport(f"contents.json does not list {min(unlisted)}.")
    known = {f"{_FILES}{artifact.name}": artifact for artifact in record.artifacts}
    found: list[ImportedFile] = []
    for file in contents.files:
        archive.check(file.path, file.sha256, file.size)
        if not file.path.startswith(_FILES):
            continue
        artifact = known.get(file.path)
        if artifact is None or (artifact.sha256, artifact.size) != (file.sha256, file.size):
            raise BadExport(f"job.json does not name {file.path} with the hash of contents.json.")
        key = keys.imported(job_id, file.sha256, artifact.name)
        found.append(ImportedFile(Artifact(**dict(artifact), key=key), partial(archive.open, file.path)))
    return found


def _events(job: Job) -> list[Entry]:
    """Where it comes from, and the end."""
    origin = job.imported_from
    assert origin is not None  # noqa: S101
    text = f"Imported: this is job {origin.job} of a service with Gaitway {origin.version}."
    note = Entry(kind="note", time=origin.imported_at, data={"text": text})
    return [note, status_entry(job, job.finished_at)]


def _blocks(rows: Iterable[Measurement]) -> list[Block]:
    """All rows, a chunk's in each block."""
    blocks, size = list[Block](), MAX_METRICS_BYTES
    for row in rows:
        if size >= MAX_METRICS_BYTES:
            blocks.append(Block())
            size = 0
        blocks[-1].add(row)
        size += _NUMBER_BYTES * (_NUMBERS_OF_A_ROW + len(row.values))
    return blocks


def _rows(archive: JobArchive) -> Iterator[Measurement]:
    kinds, names, num_values = set[frozenset[str]](), set[str](), 0
    for number, line in _lines(archive, "metrics.jsonl"):
        row = _row(line, number)
        if (num_values := num_values + len(row.values)) > MOST_VALUES:
            raise BadExport(
                f"metrics.jsonl has more than {MOST_VALUES:,} values in its first {number:,} lines; at most "
                "that many are allowed."
            )
        if (kind := frozenset(row.values)) not in kinds:
            kinds.add(kind)
            names |= kind
            _check_names(len(names), len(kinds), number)
        yield Measurement(number, row.step, row.time.timestamp(), row.values)


def _row(line: bytes, number: int) -> _Row | ArchiveRow:
    try:
        row = _decoder.decode(line)
        if FIRST_MOMENT <= row.time < LAST_MOMENT:
            return row
    except msgspec.DecodeError:
        pass  # The other model says what is wrong.
    try:
        return ArchiveRow.model_validate_json(line)
    except ValidationError as error:
        raise _unreadable(f"metrics.jsonl, line {number},", error, line) from None


def _lines(archive: JobArchive, name: str) -> Iterator[tuple[int, bytes]]:
    """The file's lines with their numbers."""
    for number, line in enumerate(archive.lines(name), 1):
        if number > MOST_LINES:
            raise BadExport(f"{name} has more than {MOST_LINES:,} lines.")
        yield number, line


def _check_names(num_names: int, num_kinds: int, line: int) -> None:
    if num_names > MOST_METRICS:
        raise BadExport(
            f"metrics.jsonl has {num_names:,} names of metrics in its first {line:,} lines; at most "
            f"{MOST_METRICS:,} are allowed."
        )
    if num_kinds > _MOST_KINDS_OF_ROWS:
        raise BadExport(
            f"metrics.jsonl has {num_kinds:,} sets of names in its first {line:,} lines; at most "
            f"{_MOST_KINDS_OF_ROWS} are allowed."
        )


def _check_log(archive: JobArchive) -> None:
    """All of it is read before anything is stored."""
    size = 0
    for number, line in _lines(archive, "log.txt"):
        if (size := size + len(line)) > MOST_LOG_BYTES:
            raise BadExport(
                f"log.txt has more than {MOST_LOG_BYTES:,} bytes in its first {number:,} lines; at most "
                "that many are allowed."
            )
