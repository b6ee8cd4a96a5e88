"""What a project keeps of its ended jobs: its rules, and what they remove of a job, as pure functions.

`rules_due` says which rules concern a job, `choice` which files these are, which the record finds or sums,
and `judge` what goes. Of a job that stays, policies, exports, metrics, events and the log always stay, and
its newest checkpoint.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from typing import Annotated, Literal, NamedTuple, Protocol, cast

from pydantic import Field, TypeAdapter

from core.accounts.principal import DEFAULT_PROJECT
from core.accounts.store import Actor
from core.documents import Stored, Strict
from core.errors import Problem, Rejected
from core.jobs.job import ArtifactRole, Job
from core.jobs.status import JobStatus

# A job with this label is never touched, whatever it says.
PIN = "keep"
Days = Annotated[int, Field(ge=1, le=3650)]
Rule = Literal["checkpoints", "videos_days", "replays_days", "failed_days", "cancelled_days"]
# The files that a rule removes.
ROLES: Mapping[Rule, tuple[ArtifactRole, ...]] = {
    "checkpoints": ("checkpoint",),
    "videos_days": ("video", "poster"),
    "replays_days": ("replay", "scene", "trajectory", "recording"),
}
WORDS: Mapping[Rule, str] = {
    "checkpoints": "older checkpoints",
    "videos_days": "videos",
    "replays_days": "replays and trajectories",
    "failed_days": "the failed job",
    "cancelled_days": "the cancelled job",
}
# The jobs that a rule removes with all that they have.
_WHOLE: Mapping[Rule, JobStatus] = {
    "failed_days": JobStatus.FAILED,
    "cancelled_days": JobStatus.CANCELLED,
}
# By rule that says something: jobs that have been kept since then, or for longer, are due.
Limits = Mapping[Rule, datetime]
_ALWAYS = datetime.max.replace(tzinfo=UTC)


class RetentionRules(Strict):
    """What is removed of a project's ended jobs. A rule that is null removes nothing.

    Days count from a job's end, or from its import. A job with the label `keep` loses nothing.
    """

    checkpoints: int | None = Field(
        default=None,
        ge=1,
        le=1000,
        description="Of each job the newest so many checkpoints stay.",
        examples=[2],
    )
    videos_days: Days | None = Field(
        default=None, description="Videos and their posters go after so many days.", examples=[30]
    )
    replays_days: Days | None = Field(
        default=None,
        description="Replays, their scenes, rollouts' trajectories and recordings go after so many days.",
        examples=[90],
    )
    failed_days: Days | None = Field(
        default=None, description="Failed jobs go after so many days, with all that they have.", examples=[60]
    )
    cancelled_days: Days | None = Field(
        default=None,
        description="Cancelled jobs go after so many days, with all that they have.",
        examples=[None],
    )

    def given(self) -> dict[str, int]:
        """The rules that say something."""
        return {name: value for name, value in self.model_dump().items() if value is not None}

    def limits(self, now: datetime) -> Limits:
        """Of the rules that say something, the files' before those that remove whole jobs."""
        return {
            cast("Rule", rule): _ALWAYS if rule == "checkpoints" else now - timedelta(days=number)
            for rule, number in self.given().items()
        }


RULES = TypeAdapter(RetentionRules)


def check_rules(rules: RetentionRules) -> None:
    """Refuse rules of which none says anything."""
    if not rules.given():
        names = ", ".join(RetentionRules.model_fields)
        detail = f"No rule says anything. Give one of {names}; to keep everything, delete the rules."
        raise Rejected(detail, [Problem("", detail)])


class Retention(Stored):
    """The rules of a project, and who has set them."""

    project: str
    rules: RetentionRules
    set_at: datetime
    set_by: str | None = None


class RetainedFile(NamedTuple):
    """A file of an ended job; or all of one role, where a whole job goes. size: bytes of all.

    role: an artifact's, or `feed` for parts of events, metrics and log.
    """

    name: str
    role: str
    step: int | None
    size: int
    number: int = 1


class Choice(NamedTuple):
    """Files of an ended job: those of `roles`, of its checkpoints without the newest `keep` steps; or all."""

    roles: tuple[ArtifactRole, ...]
    keep: int
    is_whole: bool = False


class Sums(NamedTuple):
    """Number and bytes of the chosen files, by job that has some, and by role."""

    by_job: Mapping[str, tuple[int, int]]
    by_role: Mapping[str, tuple[int, int]]


class EndedJob(NamedTuple):
    """What the rules ask of a job. kept_since: its end, or its import.

    sweep: one that goes on, and has the job as a trial or names it.
    """

    id: str
    version: int
    name: str | None
    owner: str | None
    status: JobStatus
    kept_since: datetime
    is_pinned: bool = False
    sweep: str | None = None


@dataclass(frozen=True)
class Need:
    """An unfinished job, of `project`, needs a checkpoint: of this step, or None for the newest."""

    job: str
    step: int | None = None
    project: str = DEFAULT_PROJECT


@dataclass(frozen=True)
class Removal:
    """What is removed of a job, by the rule that removes it. is_whole: the job itself and all its files."""

    job: EndedJob
    files: Mapping[Rule, Sequence[RetainedFile]]
    is_whole: bool = False

    @property
    def all_files(self) -> list[RetainedFile]:
        return [file for files in self.files.values() for file in files]

    @property
    def num_files(self) -> int:
        return sum(file.number for file in self.all_files)

    @property
    def num_bytes(self) -> int:
        return sum(file.size for file in self.all_files)

    def without(self, is_needed: Callable[[RetainedFile], bool]) -> "Removal":
        """The same without files that are needed."""
        left = {rule: [file for file in files if not is_needed(file)] for rule, files in self.files.items()}
        return replace(self, files={rule: files for rule, files in left.items() if files})


@dataclass(frozen=True)
class Verdict:
    """What the rules say of a job. needs, sweep: of jobs, or the sweep, for which they leave something."""

    job: EndedJob
    removal: Removal | None = None
    needs: Sequence[Need] = ()
    sweep: str | None = None


def rules_due(job: EndedJob, limits: Limits) -> tuple[Rule, ...]:
    """The rules that concern the job now."""
    if job.is_pinned:
        return ()
    since, status = job.kept_since, job.status
    return tuple(
        [rule for rule, limit in limits.items() if since <= limit and _WHOLE.get(rule, status) == status]
    )


def choice(rules: RetentionRules, due: Sequence[Rule], *, is_needed: bool) -> Choice:
    """The files of a job that these rules concern. is_needed: by jobs or a sweep, so that the job stays."""
    if not is_needed and any(rule in _WHOLE for rule in due):
        return Choice((), 0, is_whole=True)
    roles = list[ArtifactRole]()
    for rule in due:
        roles += ROLES.get(rule, ())
    return Choice(tuple(roles), rules.checkpoints or 1)


def judge(
    job: EndedJob, due: Sequence[Rule], files: Sequence[RetainedFile], needs: Sequence[Need]
) -> Verdict:
    """due, files: what `rules_due` says, and the files of `choice`. needs: of the job's checkpoints."""
    whole: Rule | None = next((rule for rule in due if rule in _WHOLE), None)
    if whole is not None and not needs and job.sweep is None:
        return Verdict(job, Removal(job, {whole: files}, is_whole=True))
    removed: dict[Rule, Sequence[RetainedFile]] = {}
    for rule in due:
        if its := [file for file in files if file.role in ROLES.get(rule, ())]:
            removed[rule] = its
    if job.sweep is not None:
        return Verdict(job, sweep=job.sweep if removed or whole is not None else None)
    kept_for = [*needs] if whole is not None else []
    if needs and (old := removed.get("checkpoints")):
        steps, needed = {file.step for file in old}, {need.step for need in needs}
        kept_for += [need for need in needs if need.step in steps and need not in kept_for]
        found = Removal(job, removed).without(lambda file: file.role == "checkpoint" and file.step in needed)
        return Verdict(job, found if found.files else None, kept_for)
    return Verdict(job, Removal(job, removed) if removed else None, kept_for)


_MOST_NAMED = 10


def said_of(removal: Removal, rules: RetentionRules) -> str:
    """A sentence for the job's events: which files went, by which rule."""
    parts: list[str] = []
    for rule, files in removal.files.items():
        oldest = sorted(files, key=lambda file: (file.step or 0, file.name))
        names = [file.name for file in oldest[:_MOST_NAMED]]
        more = f" and {len(files) - len(names)} more" if len(files) > len(names) else ""
        parts.append(f"`{rule}` = {getattr(rules, rule)} removed {', '.join(names)}{more}")
    return f"By the retention rules of its project, {'; '.join(parts)}."


def removed_by_rule(job: Job, role: str) -> str:
    """A sentence, with a blank before it, where a rule has removed files of this role; else empty."""
    for removed in job.removed:
        if role in ROLES.get(cast("Rule", removed.rule), ()):
            what = WORDS[cast("Rule", removed.rule)]
            when = f"{removed.at.astimezone(UTC):%Y-%m-%d}"
            return f" The retention rule `{removed.rule}` of its project removed {what} on {when}."
    return ""


class RetentionStore(Protocol):
    """The part of a JobStore that knows what projects keep. Raises RecordsUnavailable."""

    def retention(self, project: str) -> Retention | None:
        """None where there are no rules, or only such as nobody can read. Raises ProjectNotFound."""
        ...

    def retentions(self) -> Sequence[Retention]:
        """Those of all projects that have rules which can be read."""
        ...

    def set_retention(self, project: str, rules: RetentionRules, actor: Actor) -> Retention:
        """Raises ProjectNotFound."""
        ...

    def end_retention(self, project: str, actor: Actor) -> None:
        """Keep everything from now on; no error if the project has no rules. Raises ProjectNotFound."""
        ...

    def ended_jobs(
        self, project: str, *, ids: Collection[str] | None = None, after: str = "", limit: int = 1000
    ) -> Sequence[EndedJob]:
        """The project's ended jobs, the oldest first. ids: only those among these. after: the id of the last
        one of the page before."""
        ...

    def files_of_ended(
        self, job_ids: Collection[str], choice: Choice
    ) -> Mapping[str, Sequence[RetainedFile]]:
        """The chosen files by job; of whole jobs an entry for each role, and for the parts of their feeds."""
        ...

    def sums_of_ended(self, job_ids: Collection[str], choice: Choice) -> Sums:
        """Sums over the files that `files_of_ended` returns."""
        ...

    def checkpoint_needs(self, project: str) -> Mapping[str, Sequence[Need]]:
        """Who needs a checkpoint of the project's jobs, by job."""
        ...

    def remove_retained(self, removal: Removal, by: Retention) -> Sequence[str] | None:
        """Take the files, or the whole job, out of the record; returns the keys of the files.

        One transaction, with a note in the job's events, `Job.removed`, and an entry of the audit log. It
        leaves out what an unfinished job needs by now. None, and nothing is removed, where the job or the
        rules have changed since they were read, the job is pinned by now, a sweep that goes on has or names
        it by now, or all of it is needed.
        """
        ...
