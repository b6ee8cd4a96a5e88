"""Has a file of clips examined in the confined process, and keeps what that made of it."""

import hashlib
from contextlib import suppress
from functools import partial
from pathlib import Path

import structlog

from core.clips.record import (
    ARCHIVE,
    CLIPS,
    MOST_SOLVING_S,
    REPLAY,
    SCENE,
    ClipFile,
    ClipsDescription,
    MadeFile,
)
from core.errors import NotFound, ObjectDamaged, ObjectNotFound, Unavailable
from core.jobs.job import utc_now
from core.jobs.uploads import Uploads
from core.storage import keys
from core.storage.objects import ObjectStore, save_whole
from core.uploads import library
from worker.confinement.confinement import Limits
from worker.host.disk import read_plain
from worker.validation.answer import ClipsAnswer, ClipsQuestion, read_answer, read_progress
from worker.validation.confined import ANSWER, run_to_its_end, why_without_answer

log = structlog.get_logger()

_MEDIA_TYPES = {
    ARCHIVE: "application/octet-stream",
    REPLAY: "application/octet-stream",
    SCENE: "model/gltf-binary",
}
_MOST_BYTES = 2**29
# Key points take longer than other files: `core.clips.key_points.seconds_for` says how long.
_LIMITS = Limits(wall_s=900.0, more_cpu_s=MOST_SOLVING_S)
_INTERRUPTED = "A worker was stopped while it refused the clips; send them again to learn why."


def validate_clips(
    file_id: str,
    uploads: Uploads,
    objects: ObjectStore,
    folder: Path,
    data_dir: Path,
    *,
    strictly: bool = True,
) -> None:
    """Examine a file that awaits validation, and store the findings; of a refused one, only the refusal.

    folder, strictly: as for `worker.validation.confined.validate`. Raises ClipsNotFound.
    """
    store = uploads.clips
    record = library.find(file_id, store)
    if record.status != "validating":
        return
    answer = _examined(record, uploads, objects, folder, data_dir, strictly=strictly)
    if (description := answer.description) is not None:
        description = _kept(record, description, folder, objects)
        found = record.model_copy(update={"status": "ready", "message": None, "description": description})
    else:
        told = {"status": "refused", "message": answer.refusal, "refused_at": utc_now()}
        found = record.model_copy(update=told)
    if found.status == "refused":  # First: once they are refused, they may be sent again.
        objects.delete_prefix(CLIPS.prefix(file_id))
    try:
        store.settle(found)
    except NotFound:  # Somebody has deleted it meanwhile.
        objects.delete_prefix(CLIPS.prefix(file_id))
        raise
    log.info("clips_validated", clips=file_id, status=found.status, detail=found.message)


def _examined(
    record: ClipFile,
    uploads: Uploads,
    objects: ObjectStore,
    folder: Path,
    data_dir: Path,
    *,
    strictly: bool,
) -> ClipsAnswer:
    try:
        save_whole(CLIPS.source(record.id), record.sha256, objects, folder / "clips", record.size)
    except ObjectDamaged as error:
        return ClipsAnswer(refusal=f"The stored file is damaged: {error.why}. Send it again.")
    except ObjectNotFound:
        return ClipsAnswer(refusal=_INTERRUPTED)
    if record.body.startswith("sha256:"):
        try:
            model = library.find(record.body, uploads.models)
            save_whole(keys.model_source(model.id), model.file_sha256, objects, folder / "model")
        except NotFound:
            return ClipsAnswer(refusal=f"The model {record.body}, whose clips they are, has been deleted.")
    question = ClipsQuestion(body=record.body, rate=record.rate, name=record.name or "clip")
    (folder / "question.json").write_text(question.model_dump_json())
    status = run_to_its_end(
        "clips",
        folder,
        data_dir,
        _LIMITS,
        strictly=strictly,
        look_up=partial(_look_up, record, uploads, folder),
    )
    answer = read_answer(folder / ANSWER, ClipsAnswer)
    if answer.refusal is not None or (answer.description is not None and status == 0):
        return answer
    return ClipsAnswer(refusal=why_without_answer("The reader", "file of clips", status, _LIMITS))


def _look_up(record: ClipFile, uploads: Uploads, folder: Path) -> None:
    """Store how far the reading is. Raises ClipsNotFound once somebody has deleted the file."""
    with suppress(Unavailable):
        known, message = library.find(record.id, uploads.clips), read_progress(folder)
        if message not in (None, known.message):
            uploads.clips.settle(record.model_copy(update={"message": message}))


def _kept(record: ClipFile, found: ClipsDescription, folder: Path, objects: ObjectStore) -> ClipsDescription:
    """The description, with what was made of the file, which lies in the object store now."""
    made: dict[str, MadeFile] = {}
    for name, media_type in _MEDIA_TYPES.items():
        with suppress(FileNotFoundError):
            content = read_plain(folder / name, _MOST_BYTES)
            objects.put(keys.made_of_clips(record.id, name), content, media_type=media_type)
            made[name] = MadeFile(sha256=hashlib.sha256(content).hexdigest(), size=len(content))
    return found.model_copy(update={"made": made})
