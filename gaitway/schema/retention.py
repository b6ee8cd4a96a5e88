"""What a project keeps of its ended jobs."""

from datetime import datetime

from pydantic import Field

from gaitway.schema.base import View


class RetentionView(View):
    """The rules of a project; those that are null remove nothing. set_at: null where it has none."""

    project: str = Field(examples=["gaits"])
    checkpoints: int | None = Field(default=None, description="Of each ended job the newest so many stay.")
    videos_days: int | None = Field(default=None, description="Days after a job's end.")
    replays_days: int | None = Field(default=None, description="Of trajectories and recordings, too.")
    failed_days: int | None = Field(default=None, description="For failed jobs as a whole.")
    cancelled_days: int | None = Field(default=None, description="For cancelled jobs as a whole.")
    set_at: datetime | None = None
    set_by: str | None = None


class RemovedRoleView(View):
    """Files of one role. role: an artifact's, or `feed` for parts of events, metrics and log."""

    role: str = Field(examples=["checkpoint"])
    files: int
    bytes: int


class RemovalView(View):
    """What a job loses. whole: the job itself goes with all its files. rules: by which."""

    job: str = Field(examples=["019aa3c2f0b1-5be0c1d2e3"])
    name: str | None = None
    owner: str | None = None
    whole: bool = False
    rules: tuple[str, ...]
    files: int
    bytes: int


class NeededView(View):
    """A job of which something stays, because unfinished jobs or a sweep need it.

    needed_by: some of the `num_needed_by` jobs, of projects that you see.
    """

    job: str = Field(examples=["019aa3c2f0b1-5be0c1d2e3"])
    name: str | None = None
    needed_by: tuple[str, ...] = ()
    num_needed_by: int = 0
    sweep: str | None = None


class RetentionPreviewView(View):
    """What rules would remove now. jobs: how many lose something; whole_jobs: how many of these all.

    roles, largest: the most bytes first. needed: some of the `num_needed` jobs that lose less, because others
    need it. pinned: how many jobs the label `keep` protects.
    """

    project: str = Field(examples=["gaits"])
    jobs: int
    whole_jobs: int
    files: int
    bytes: int
    roles: tuple[RemovedRoleView, ...]
    largest: tuple[RemovalView, ...]
    needed: tuple[NeededView, ...]
    num_needed: int
    pinned: int
