"""A file of clips that users send, and what a worker found in it."""

import hashlib
from collections.abc import Sequence

from core.documents import Stored
from core.errors import BadClips, ClipsInUse, ClipsNotFound
from core.storage import keys
from core.uploads.record import Upload, UploadKind, UploadStore

# What a worker makes of a file: the clips as trainings read them, and a replay of some with its scene.
ARCHIVE, REPLAY, SCENE = "clips.npz", "replay.bin", "scene.glb"
MOST_REPLAYED = 32
# The processor time that a worker gives a recording of key points: 13 minutes of a rat at 50 frames a second.
MOST_SOLVING_S = 500


class ClipFacts(Stored):
    """One clip. rate: frames per second. seconds: from its first frame to its last. warnings: what may be
    wrong with it."""

    name: str
    num_frames: int
    rate: float
    seconds: float
    warnings: list[str] = []


class MadeFile(Stored):
    """A file that a worker made of the one that was sent. size: bytes."""

    sha256: str
    size: int


class KeyPointFacts(Stored):
    """A key point that the clip follows. body, offset: the point of the body that it is, in m, as it was
    fitted. mean_distance, worst_distance: m between the two, over the num_seen frames that have it."""

    name: str
    body: str
    offset: tuple[float, float, float]
    num_seen: int
    mean_distance: float | None = None
    worst_distance: float | None = None


class ClipsDescription(Stored):
    """The contents of a file. format: how it is laid out. joints: those that the clips move, by their
    names in the body's model. key_points: of a recording of such. made: files made of it, by name.
    num_replayed: how many of the clips, from the first on, its replay shows. no_replay: why there is none."""

    format: str
    clips: list[ClipFacts]
    joints: list[str]
    key_points: list[KeyPointFacts] = []
    made: dict[str, MadeFile] = {}
    num_replayed: int = 0
    no_replay: str | None = None


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


def _made(record: ClipFile) -> Sequence[str]:
    names = () if record.description is None else record.description.made
    return [keys.made_of_clips(record.id, name) for name in names]


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
    made=_made,
)
ClipStore = UploadStore[ClipFile]
