"""A job's files, and files made of a job."""

import tempfile
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path, PurePosixPath
from urllib.parse import quote

from gaitway import policy
from gaitway.calls.asking import Asking, job_path, of_a_job
from gaitway.downloading import OnBytes, download, save
from gaitway.errors import NotFound
from gaitway.steps import Call, Run
from gaitway.views import ArtifactView, JobView

_ENDINGS = {"numpy": "npz", "onnx": "onnx"}


class FileCalls(Asking):
    """Calls that fetch files."""

    @of_a_job
    def artifacts(self, job_id: str) -> Call[Sequence[ArtifactView]]:
        return self._items(job_path(job_id, "artifacts"), ArtifactView)

    @of_a_job
    def checkpoints(self, job_id: str) -> Call[Sequence[ArtifactView]]:
        artifacts = yield from self.artifacts(job_id)
        found = [artifact for artifact in artifacts if artifact.role == "checkpoint"]
        return sorted(found, key=lambda artifact: artifact.step or 0)

    @of_a_job
    def download(
        self, job_id: str, name: str, path: str | Path | None, on_bytes: OnBytes | None
    ) -> Call[Path]:
        href = job_path(job_id, "artifacts", name)
        artifact = yield from self._announced(job_id, lambda job: job.artifact(name), href)
        return (yield from download(self.retry, artifact, _target(artifact.name, path), on_bytes))

    @of_a_job
    def newest(
        self, job_id: str, role: str, path: str | Path | None, step: int | None, on_bytes: OnBytes | None
    ) -> Call[Path]:
        """Download the newest file of this role, or the one of this step."""
        href = job_path(job_id, role) + ("" if step is None else f"?step={step}")
        artifact = yield from self._announced(job_id, lambda job: job.newest(role, step), href)
        return (yield from download(self.retry, artifact, _target(artifact.name, path), on_bytes))

    @of_a_job
    def load_policy(
        self, job_id: str, step: int | None, deterministic: bool, best: bool
    ) -> Call[policy.Policy]:
        if best and step is not None:
            raise ValueError("A policy is that of a step or the best one: give one of the two.")
        job = yield from self.get(job_id)
        own = job.newest("best_policy" if best else "policy") if step is None else None
        artifact = own or (None if best else job.newest("checkpoint", step))
        if artifact is None and best:
            raise NotFound(404, {"detail": f"Job {job_id} has no best policy: no evaluation kept one (yet)."})
        if artifact is None:
            checkpoints = yield from self.checkpoints(job_id)
            kept = ", ".join(str(found.step) for found in checkpoints) or "none yet"
            which = "policy" if step is None else f"checkpoint of step {step}"
            raise NotFound(404, {"detail": f"Job {job_id} has no {which}; its checkpoints: {kept}."})
        with tempfile.TemporaryDirectory(prefix="gaitway-") as folder:
            path = yield from download(self.retry, artifact, Path(folder) / "policy")
            algorithm = job.spec.get("algorithm", {}).get("kind", "ppo")
            load = partial(
                policy.load, path, algorithm, is_checkpoint=own is None, deterministic=deterministic
            )
            return (yield Run(load))

    @of_a_job
    def export_policy(
        self, job_id: str, format: str, path: str | Path | None, best: bool, on_bytes: OnBytes | None
    ) -> Call[Path]:
        href = f"{job_path(job_id, 'policy')}?format={quote(format)}" + ("&which=best" if best else "")
        name = f"{'policy-best' if best else 'policy'}.{_ENDINGS.get(format, '')}"
        role = "best_policy" if best else "policy"
        artifact = yield from self._announced(job_id, lambda job: _finished(job, name, role), href)
        return (yield from download(self.retry, artifact, _target(artifact.name, path), on_bytes))

    @of_a_job
    def export(self, job_id: str, path: str | Path | None) -> Call[Path]:
        target = _target(f"{job_id}.zip", path)
        return (yield from save(self.retry, job_path(job_id, "export"), target))

    @of_a_job
    def share(self, job_id: str, path: str | Path | None) -> Call[Path]:
        target = _target(f"{job_id}.html", path)
        return (yield from save(self.retry, job_path(job_id, "report.html"), target))

    def _announced(
        self, job_id: str, find: Callable[[JobView], ArtifactView | None], href: str
    ) -> Call[ArtifactView]:
        """The artifact that `find` finds in the job; or raises the service's refusal."""
        artifact = find((yield from self.get(job_id)))
        if artifact is None:
            yield from self._ask("GET", href, headers={"Range": "bytes=0-0"})
            artifact = find((yield from self.get(job_id)))  # it has come in between
        if artifact is None:
            raise NotFound(404, {"detail": f"Job {job_id} does not list the file at {href}."})
        return artifact


def _finished(job: JobView, name: str, role: str) -> ArtifactView | None:
    """The file of this name, if it is of the policy with this role; there may be one of an older policy."""
    found, own = job.artifact(name), job.newest(role)
    if found is None or own is None:
        return found if job.is_final else None
    return found if found.step == own.step else None


def _target(name: str, path: str | Path | None) -> Path:
    """Where the file goes: `path`, or inside it when it is a folder."""
    chosen = Path(path) if path is not None else Path.cwd()
    return chosen / PurePosixPath(name).name if chosen.is_dir() else chosen
