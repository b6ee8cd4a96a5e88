"""A file that users send for jobs to name, and the interfaces of the records and of the queue of such files.

There are two kinds: users' own models (`core.user_models`) and clip files (`core.clips.record`). Both are
known by a hash, are validated by a worker in a confined process, and belong to the projects that they were
sent to.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any, Generic, Literal, Protocol, TypeVar

from core.accounts.principal import Ownership
from core.documents import Stored
from core.errors import Conflict, NotFound, Rejected

UploadStatus = Literal["validating", "ready", "refused"]
KindName = Literal["model", "clips"]


class Upload(Stored):
    """id: `sha256:` and a hash. message, refused_at: why and when it was refused; of one that is being
    validated, message says how far that is, where it takes long. size: bytes.

    name: for people, as its sender gave it; several may have the same. media_type: of the file. description:
    what was found in it, of the kind's own class.
    """

    id: str
    name: str | None = None
    status: UploadStatus
    media_type: str
    size: int
    created_at: datetime
    message: str | None = None
    refused_at: datetime | None = None
    description: Any = None

    @property
    def file_sha256(self) -> str:
        """The hash of the file's bytes, in hexadecimal."""
        return self.id.removeprefix("sha256:")


Record = TypeVar("Record", bound=Upload)


@dataclass(frozen=True)
class UploadKind(Generic[Record]):
    """What tells the kinds apart.

    name: also of its dispatches. record: its class. description: the class of its field of that name. folder:
    of all such files in the bucket. prefix, source: of an id, the prefix of what is kept of it there, and the
    key of the file as it was sent. missing, unusable, in_use: the refusals for an id that nobody has, for a
    file that a worker refused, with its sentence, and for one that these jobs need. made: the keys of what a
    worker made of a file, which jobs need.
    """

    name: KindName
    record: type[Record]
    description: type[Stored]
    folder: str
    prefix: Callable[[str], str]
    source: Callable[[str], str]
    missing: Callable[[str], NotFound]
    unusable: Callable[[str], Rejected]
    in_use: Callable[[str, Sequence[str], Sequence[str]], Conflict]
    made: Callable[[Record], Sequence[str]] = lambda record: ()


@dataclass(frozen=True)
class UploadPage(Generic[Record]):
    """Some of them, newest first, and the cursor of the next page; None at the end."""

    uploads: Sequence[Record]
    next_cursor: str | None


class UploadQueue(Protocol):
    """At-least-once; both methods raise RecordsUnavailable when the queue cannot be reached."""

    def enqueue_upload(self, kind: KindName, upload_id: str) -> None:
        """Let any worker validate the file, after all jobs. Doing so twice changes nothing."""
        ...

    def contains_upload(self, kind: KindName, upload_id: str) -> bool:
        """Whether it waits, or a worker is validating it."""
        ...


class UploadStore(Protocol[Record]):
    """The records of one kind. Every method raises RecordsUnavailable when the store cannot be reached."""

    @property
    def kind(self) -> UploadKind[Record]: ...

    def find(self, upload_id: str) -> Record:
        """Raises the kind's `missing`."""
        ...

    def add(self, record: Record) -> None:
        """Store the record, in place of an earlier one; one that waits for its validation gets a dispatch."""
        ...

    def dispatched(self, upload_id: str) -> None:
        """Record that the queue has received it."""
        ...

    def rename(self, upload_id: str, name: str) -> None:
        """Give it another name. Raises the kind's `missing`."""
        ...

    def settle(self, record: Record) -> None:
        """Store the result of the validation, or how far it is; the name stays.

        Raises the kind's `missing` where it was deleted meanwhile.
        """
        ...

    def delete(self, upload_id: str) -> None:
        """Forget the record; a missing one is no error."""
        ...

    def num_waiting(self) -> int:
        """How many wait for validation."""
        ...

    def all(self) -> Sequence[Record]:
        """All of the kind, ordered by id."""
        ...

    def list(
        self,
        *,
        cursor: str | None = None,
        limit: int = 50,
        name: str | None = None,
        projects: Collection[str] | None = None,
        owner: str | None = None,
    ) -> UploadPage[Record]:
        """Some of them, the last sent first. cursor: the `next_cursor` of an earlier page, Rejected for any
        other. name, projects, owner: only those; None: of any.
        """
        ...

    def claim(self, upload_id: str, ownership: Ownership) -> None:
        """Let the project have it, too; its first sender there owns it there. Raises the kind's `missing`."""
        ...

    def owners_of(self, upload_ids: Collection[str]) -> Mapping[str, Sequence[Ownership]]:
        """The projects that have each of these, by name, and who owns it there; unknown ones are left out."""
        ...

    def release(self, upload_id: str, projects: Collection[str]) -> bool:
        """Take it from these projects. True if none has it now, and no job needs it: its record is gone.

        Raises the kind's `missing`, and its `in_use` while an unfinished job or sweep in one of these needs
        it.
        """
        ...
