"""A file of clips that users send, and what a worker found in it."""

import hashlib

from core.documents import Stored
from core.errors import BadClips, ClipsInUse, ClipsNotFound
from core.storage import keys
from core.uploads.record import Upload, UploadKind, UploadStore


class ClipFacts(Stored):
    """One clip. rate: frames per second. seconds: from its first frame to its last."""

    name: str
    num_frames: int
    rate: float
    seconds: float
    warnings: list[str] = []


class ClipsDescription(Stored):
    """The contents of a file. format: how it is laid out. joints: those that the clips move, by their
    names in the body's model. num_replays: how many of the clips, from the first on, can be looked at."""

    format: str
    clips: list[ClipFacts]
    joints: list[str]
    num_replays: int = 0


class ClipFile(Upload):
    """id: see `clips_id`. sha256: of the file's bytes alone.

    body: an environment of the catalog whose body moves, or a user's own model by its id. rate: frames per
    second, for a file that does not say; None: it says.
    """

    sha256: str
    body: str
    rate: float | None = None
    description: ClipsDescription | None = None

    @property
    def file_sha256(self) -> str:
        return self.sha256


def clips_id(sha256: str, body: str, rate: float | None) -> str:
    """The id of a file with this hash that is read so: another body or rate makes other clips of it."""
    said = f"{sha256}\n{body}\n{'' if rate is None else repr(float(rate))}"
    return f"sha256:{hashlib.sha256(said.encode()).hexdigest()}"


CLIPS = UploadKind(
    name="clips",
    record=ClipFile,
    description=ClipsDescription,
    folder=keys.clip_files(),
    prefix=keys.clip_file,
    source=keys.clip_file_source,
    missing=ClipsNotFound,
    unusable=BadClips,
    in_use=ClipsInUse,
    made=lambda record: [keys.clip_archive(record.id)] if record.status == "ready" else [],
)
ClipStore = UploadStore[ClipFile]
