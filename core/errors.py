"""Errors, with messages for people; the API maps them to HTTP.

GaitwayError
├── NotFound       what was named does not exist
├── Conflict       it exists, but not in a state that allows this
├── Rejected       the request itself is wrong; it will never work as sent
├── Unavailable    the request is fine; try again after `retry_after_s`
├── Misconfigured  a setting is wrong or missing; a process that starts with it stops
└── JobFailed      the job itself fails; raised inside the training process
"""

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

from core.reasons import Reason

# The exit status of a misconfigured process, EX_CONFIG in sysexits.h: it tells a supervisor that a restart
# does not help.
EXIT_STATUS = 78


@dataclass(frozen=True)
class Problem:
    """One offending place in a document: a JSON pointer (RFC 6901) and a sentence."""

    pointer: str
    detail: str


class GaitwayError(Exception):
    """Base of all errors: a stable `code`, a constant `title`, a sentence (`detail`), and facts."""

    code: ClassVar[str] = "error"
    title: ClassVar[str] = "Something went wrong"

    def __init__(self, detail: str, **facts: object) -> None:
        super().__init__(detail)
        self.detail = detail
        self.facts = facts


class NotFound(GaitwayError):
    code = "not-found"
    title = "Not found"


class Conflict(GaitwayError):
    code = "conflict"
    title = "Not possible in the present state"


class Rejected(GaitwayError):
    """Wrong input; `problems` say where."""

    code = "invalid-request"
    title = "The request is not valid"

    def __init__(self, detail: str, problems: Sequence[Problem] = (), **facts: object) -> None:
        super().__init__(detail, **facts)
        self.problems = tuple(problems)


class BadModel(Rejected):
    """A user's model that cannot be used."""

    code = "bad-model"
    title = "The model cannot be used"

    def __init__(self, detail: str) -> None:
        super().__init__(detail, [Problem("", detail)])


class BadClips(Rejected):
    """A file of clips that cannot be used."""

    code = "bad-clips"
    title = "The clips cannot be used"

    def __init__(self, detail: str) -> None:
        super().__init__(detail, [Problem("", detail)])


class BadExport(Rejected):
    """A file that is not a whole export, or of a job that this service cannot have."""

    code = "bad-export"
    title = "The export cannot be imported"

    def __init__(self, detail: str, pointer: str = "") -> None:
        super().__init__(detail, [Problem(pointer, detail)])


class Unavailable(GaitwayError):
    code = "unavailable"
    title = "Not available now"

    def __init__(self, detail: str, *, retry_after_s: int = 5, **facts: object) -> None:
        super().__init__(detail, **facts)
        self.retry_after_s = retry_after_s


class JobNotFound(NotFound):
    code = "job-not-found"
    title = "No such job"

    def __init__(self, job_id: str) -> None:
        super().__init__(f"There is no job {job_id!r}.", job=job_id)


class EnvironmentNotFound(NotFound):
    code = "environment-not-found"
    title = "No such environment"


class ModelNotFound(NotFound):
    code = "model-not-found"
    title = "No such model"

    def __init__(self, model_id: str) -> None:
        super().__init__(f"There is no model {model_id!r}; `POST /models` makes one.", model=model_id)


class ClipsNotFound(NotFound):
    code = "clips-not-found"
    title = "No such clips"

    def __init__(self, clips_id: str) -> None:
        super().__init__(f"There are no clips {clips_id!r}; `POST /clips` makes them.", clips=clips_id)


class ArtifactNotFound(NotFound):
    code = "artifact-not-found"
    title = "No such artifact"


class ArtifactNotReady(NotFound):
    """The artifact may still come: the job that makes it has not ended."""

    code = "artifact-not-ready"
    title = "Not ready yet"

    def __init__(self, detail: str, *, retry_after_s: int = 5, **facts: object) -> None:
        super().__init__(detail, **facts)
        self.retry_after_s = retry_after_s


class StaleJob(Conflict):
    code = "stale-job"
    title = "The job has changed meanwhile"

    def __init__(self, job_id: str) -> None:
        super().__init__(f"Job {job_id} has changed meanwhile; read it again.", job=job_id)


class LeaseLost(Conflict):
    """The attempt that writes no longer holds the job; nothing was written."""

    code = "lease-lost"
    title = "The attempt no longer holds the job"

    def __init__(self, job_id: str) -> None:
        super().__init__(f"Another attempt holds job {job_id}, or it has ended.", job=job_id)


class IllegalTransition(Conflict):
    code = "illegal-transition"
    title = "The job cannot take this step"

    def __init__(self, job_id: str, status: str, wanted: str) -> None:
        super().__init__(f"Job {job_id} is {status} and cannot become {wanted}.", job=job_id, status=status)


class JobExists(Conflict):
    code = "job-exists"
    title = "The job exists already"

    def __init__(self, job_id: str) -> None:
        super().__init__(f"Job {job_id} exists already.", job=job_id)


class JobUnreadable(Conflict):
    """The record is set aside; all others are served."""

    code = "job-unreadable"
    title = "The job's record cannot be read"

    def __init__(self, job_id: str, problem: str) -> None:
        super().__init__(f"This version cannot read the record of job {job_id} ({problem}).", job=job_id)
        self.problem = problem


class JobNotFinished(Conflict):
    code = "job-not-finished"
    title = "The job has not ended"


class IdempotencyKeyReused(Conflict):
    code = "idempotency-key-reused"
    title = "The Idempotency-Key was used with another body"

    def __init__(self, key: str) -> None:
        super().__init__(f"The Idempotency-Key {key!r} was used before with another body; use a new key.")


class ModelInUse(Conflict):
    code = "model-in-use"
    title = "Jobs need the model"

    def __init__(self, model_id: str, jobs: Sequence[str], sweeps: Sequence[str] = ()) -> None:
        super().__init__(
            _needed("the model", jobs, sweeps), model=model_id, jobs=list(jobs), sweeps=list(sweeps)
        )


class ClipsInUse(Conflict):
    code = "clips-in-use"
    title = "Jobs need the clips"

    def __init__(self, clips_id: str, jobs: Sequence[str], sweeps: Sequence[str] = ()) -> None:
        super().__init__(
            _needed("the clips", jobs, sweeps), clips=clips_id, jobs=list(jobs), sweeps=list(sweeps)
        )


def _needed(what: str, jobs: Sequence[str], sweeps: Sequence[str], num_hidden: int = 0) -> str:
    """A sentence. num_hidden: how many jobs there are besides, which must not be named."""
    counted = {"jobs": len(jobs) + num_hidden, "sweeps": len(sweeps)}
    who = " and ".join(f"{number} unfinished {name}" for name, number in counted.items() if number)
    hidden = [f"{num_hidden} in projects that you do not see"] if num_hidden else []
    return f"{who} need {what} ({', '.join([*[*jobs, *sweeps][:5], *hidden])}): cancel them first."


class JobInUse(Conflict):
    code = "job-in-use"
    title = "Jobs need its checkpoint"

    def __init__(
        self, job_id: str, jobs: Sequence[str], sweeps: Sequence[str] = (), num_hidden: int = 0
    ) -> None:
        """jobs: those that may be named. num_hidden: how many others there are."""
        self.job, self.jobs, self.sweeps = job_id, tuple(jobs), tuple(sweeps)
        super().__init__(
            _needed(f"a checkpoint of job {job_id}", jobs, sweeps, num_hidden),
            job=job_id,
            jobs=list(jobs),
            sweeps=list(sweeps),
        )


class JobFinished(Conflict):
    code = "job-finished"
    title = "The job has ended"


class SweepNotFound(NotFound):
    code = "sweep-not-found"
    title = "No such sweep"

    def __init__(self, sweep_id: str) -> None:
        super().__init__(f"There is no sweep {sweep_id!r}.", sweep=sweep_id)


class StaleSweep(Conflict):
    code = "stale-sweep"
    title = "The sweep has changed meanwhile"

    def __init__(self, sweep_id: str) -> None:
        super().__init__(f"Sweep {sweep_id} has changed meanwhile; read it again.", sweep=sweep_id)


class SweepNotFinished(Conflict):
    code = "sweep-not-finished"
    title = "The sweep has not ended"


class SweepFinished(Conflict):
    code = "sweep-finished"
    title = "The sweep has ended"


class UserNotFound(NotFound):
    code = "user-not-found"
    title = "No such user"

    def __init__(self, name: str) -> None:
        super().__init__(f"There is no user {name!r}; `gaitway users list` shows all.", user=name)


class ProjectNotFound(NotFound):
    code = "project-not-found"
    title = "No such project"

    def __init__(self, name: str) -> None:
        super().__init__(f"There is no project {name!r}; `gaitway projects list` shows all.", project=name)


class RetentionNeeded(Conflict):
    code = "retention-needed"
    title = "Jobs need what the rules would remove"

    def __init__(self, project: str, needed: Mapping[str, Sequence[str]]) -> None:
        """needed: jobs that would lose something, each with the unfinished jobs that need it."""
        parts = [f"job {job} is needed by {', '.join(by[:5])}" for job, by in [*needed.items()][:5]]
        more = f"; and {len(needed) - 5} more" if len(needed) > 5 else ""
        super().__init__(
            f"The rules would remove checkpoints that unfinished jobs need: {'; '.join(parts)}{more}. "
            "Wait for their end, cancel them, give the needed job the label `keep`, or keep more.",
            project=project,
            needed={job: [*by] for job, by in [*needed.items()][:100]},
        )


class TokenNotFound(NotFound):
    code = "token-not-found"
    title = "No such token"

    def __init__(self, token_id: str) -> None:
        super().__init__(
            f"There is no token {token_id!r}; `gaitway tokens list` shows yours.", token=token_id
        )


class TooManyTokens(Conflict):
    code = "too-many-tokens"
    title = "The user has too many tokens"

    def __init__(self, name: str, most: int) -> None:
        super().__init__(
            f"{name} has {most} tokens that are valid, the most that a user may have: revoke some by "
            "`gaitway tokens revoke ID`, or let them expire.",
            user=name,
            most=most,
        )


class UserExists(Conflict):
    code = "user-exists"
    title = "The user exists already"

    def __init__(self, name: str) -> None:
        super().__init__(f"There is a user {name!r} already.", user=name)


class SubjectDiffers(Conflict):
    code = "subject-differs"
    title = "The user is not linked to this account of the identity provider"

    def __init__(self, name: str, subject: str) -> None:
        super().__init__(
            f"There is a user {name!r} here already, who is not linked to this account of the identity "
            "provider. If both are one person, an admin links them: "
            f"gaitway users link {name} {shlex.quote(subject)}",
            user=name,
            subject=subject,
        )


class SubjectTaken(Conflict):
    code = "subject-taken"
    title = "Another user has this account of the identity provider"

    def __init__(self, subject: str, owner: str) -> None:
        super().__init__(f"{subject} is the account of the user {owner}.", user=owner, subject=subject)


class ProjectExists(Conflict):
    code = "project-exists"
    title = "The project exists already"

    def __init__(self, name: str) -> None:
        super().__init__(f"There is a project {name!r} already.", project=name)


class WebhookNotFound(NotFound):
    code = "webhook-not-found"
    title = "No such webhook"

    def __init__(self, project: str, name: str) -> None:
        super().__init__(f"The project {project} has no webhook {name!r}.", project=project, webhook=name)


class WebhookExists(Conflict):
    code = "webhook-exists"
    title = "The webhook exists already"

    def __init__(self, project: str, name: str) -> None:
        super().__init__(
            f"The project {project} has a webhook {name!r} already: delete it first, or take another name.",
            project=project,
            webhook=name,
        )


class WebhookUnsigned(Conflict):
    code = "webhook-unsigned"
    title = "The webhook has no secret"

    def __init__(self, name: str) -> None:
        super().__init__(
            f"The webhook {name} has no secret: messages by Apprise are not signed.", webhook=name
        )


class DeliveryNotFound(NotFound):
    code = "delivery-not-found"
    title = "No such delivery"

    def __init__(self, delivery: int | str) -> None:
        super().__init__(
            f"There is no delivery {delivery}; they are kept for a week after their end.", delivery=delivery
        )


class TooManyWebhooks(Conflict):
    code = "too-many-webhooks"
    title = "The project has too many webhooks"

    def __init__(self, project: str, most: int) -> None:
        super().__init__(
            f"The project {project} has {most} webhooks, the most that a project may have: delete some by "
            "`gaitway webhooks delete NAME`.",
            project=project,
            most=most,
        )


class QuotaNotFound(NotFound):
    code = "quota-not-found"
    title = "No such quota"

    def __init__(self, kind: str, name: str) -> None:
        super().__init__(
            f"No quota is set for the {kind} {name}; `gaitway quotas list` shows all.", kind=kind, name=name
        )


class QuotaExceeded(Conflict):
    """`detail` has the numbers, and says when there is room. facts: quota, limit, used."""

    code = "quota-exceeded"
    title = "A quota does not allow it"


class AddressesWait(Unavailable):
    code = "addresses-wait"
    title = "Too many addresses are being looked at"

    def __init__(self) -> None:
        super().__init__("Apprise looks at other addresses just now; ask again later.")


class LastAdmin(Conflict):
    code = "last-admin"
    title = "No admin would be left"

    def __init__(self, name: str) -> None:
        super().__init__(
            f"{name} is the only active admin: give another user the role first, or nobody could.", user=name
        )


class ObjectNotFound(NotFound):
    code = "object-not-found"
    title = "No such object"

    def __init__(self, key: str) -> None:
        super().__init__(f"The object store has no {key!r}.", key=key)


class ObjectDamaged(ObjectNotFound):
    """The object store cannot give the object whole, while it gives others."""

    code = "object-damaged"
    title = "The stored object is damaged"

    def __init__(self, key: str, why: str) -> None:
        GaitwayError.__init__(
            self,
            f"{key!r} is damaged in the object store: {why}. If there is a back-up of the bucket, restore "
            "this object from it.",
            key=key,
        )
        self.why = why


class StorageUnavailable(Unavailable):
    code = "storage-unavailable"
    title = "The object store cannot be reached"


class RecordsUnavailable(Unavailable):
    code = "records-unavailable"
    title = "The job records cannot be reached"


class StorageRefuses(StorageUnavailable):
    """The store answers, but refuses until a setting is changed."""

    code = "storage-refuses"
    title = "The object store refuses"


class RecordsRefuse(RecordsUnavailable):
    """The store answers, but refuses until a setting is changed."""

    code = "records-refuse"
    title = "PostgreSQL refuses the service's requests"


class NoWorker(Unavailable):
    code = "no-worker"
    title = "No worker is available"


class TooManySweeps(GaitwayError):
    code = "too-many-sweeps"
    title = "Too many sweeps are running"

    def __init__(self, most: int) -> None:
        super().__init__(
            f"{most} sweeps, the maximum, are running; cancel one, or send this one when another has ended.",
            most=most,
        )


class TooManyPreviews(Unavailable):
    code = "too-many-previews"
    title = "Too many previews are waiting"

    def __init__(self, waiting: int) -> None:
        super().__init__(f"{waiting} previews are waiting already; ask again later.", waiting=waiting)


class NothingDraws(Unavailable):
    """A worker failed to render; another one may succeed, or the same one once its fault is repaired."""

    code = "nothing-draws"
    title = "The worker cannot render"


class Misconfigured(GaitwayError):
    """`detail` names the setting and the remedy."""

    code = "misconfigured"
    title = "A setting is wrong"


class JobFailed(GaitwayError):
    """A job's failure, with the reason that its record gets."""

    code = "job-failed"
    title = "The job failed"

    def __init__(self, reason: Reason, detail: str, **facts: object) -> None:
        super().__init__(detail, **facts)
        self.reason = reason
