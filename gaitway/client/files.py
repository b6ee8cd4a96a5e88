# Made by .ci/make_client.py: change gaitway/async_client/files.py instead.
"""A job's files, and files made of a job. A file gets its name once it is whole and its hash is right."""

import hashlib
import json
import tempfile
import time
import uuid
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Literal
from urllib.parse import urlencode

import httpx

from gaitway import frames, policy
from gaitway.addresses import OnBytes, clips_in, models_in, path_of, target
from gaitway.client.catalog import Catalog
from gaitway.client.connection import Connection
from gaitway.client.jobs import Job, Jobs
from gaitway.concurrency import run, sleep
from gaitway.errors import ApiError, DownloadFailed, NotFound, Unavailable, Unreachable
from gaitway.schema import ArtifactView, JobView

_ENDINGS = {"numpy": "npz", "onnx": "onnx", "robot": "robot.onnx"}


class Downloads(Connection):
    """Downloads artifacts, and documents that the service makes as they are asked for."""

    def _download(self, artifact: ArtifactView, path: Path, on_bytes: OnBytes | None = None) -> Path:
        """Download the artifact to `path`, which is returned. on_bytes: called with (bytes here, in all).

        Bytes are gathered in `<path>.<hash>.part`, from which a later call resumes. Raises DownloadFailed
        when two downloads had another hash, ApiError, and Unreachable when the service stays unavailable.
        """
        path.parent.mkdir(parents=True, exist_ok=True)
        part = path.with_name(f"{path.name}.{artifact.sha256[:8]}.part")
        for _ in range(2):  # the second time from the beginning, in case an old part was damaged
            self._fill(part, artifact, on_bytes)
            if run(partial(_sha256, part)) == artifact.sha256:
                part.replace(path)
                return path
            part.unlink()
        raise DownloadFailed(
            f"{artifact.name} came with another SHA-256 than announced, twice; it was deleted."
        )

    def _fill(self, part: Path, artifact: ArtifactView, on_bytes: OnBytes | None) -> None:
        """Download the part to its full size, over as many connections as needed."""
        part.touch()
        if part.stat().st_size > artifact.size:
            part.write_bytes(b"")
        failures, lost_since = 0, time.monotonic()
        while (have := part.stat().st_size) < artifact.size:
            error: Exception | None = None
            try:
                self._append(part, artifact, have, on_bytes)
            except (Unreachable, Unavailable) as caught:
                error = caught
            except ApiError as caught:
                if caught.status != 416:
                    raise
                part.unlink()
                raise DownloadFailed(
                    f"The service has fewer bytes of {artifact.href} than it announced."
                ) from caught
            if part.stat().st_size > have:
                failures, lost_since = 0, time.monotonic()
                continue
            failures += 1
            if time.monotonic() - lost_since > self._retry.patience_s:
                raise error or DownloadFailed(f"{artifact.href} stops after {have} of {artifact.size} bytes.")
            sleep(self._retry.delay_s(failures, error))

    def _append(self, part: Path, artifact: ArtifactView, have: int, on_bytes: OnBytes | None) -> None:
        """Add to the part what one connection brings."""
        # Any re-encoding on the way would make byte positions meaningless.
        headers = {"Accept-Encoding": "identity"} | ({"Range": f"bytes={have}-"} if have else {})
        with self._opened(artifact.href, headers=headers) as response:
            is_rest = _is_rest(response, have)
            here = have if is_rest else 0
            with part.open("ab" if is_rest else "wb") as file:
                for chunk in response.iter_raw():
                    here += len(chunk)
                    if here > artifact.size:
                        raise DownloadFailed(
                            f"{artifact.href} has more bytes than the {artifact.size} announced."
                        )
                    file.write(chunk)
                    if on_bytes is not None:
                        on_bytes(here, artifact.size)

    def _save(self, href: str, path: Path) -> Path:
        """Save a document that the service makes as it is asked, whose size and hash nobody knows before.

        The file gets its name once it is whole; after a broken connection it is asked for again. Raises
        ApiError, and Unreachable.
        """
        path.parent.mkdir(parents=True, exist_ok=True)
        part = path.with_name(f"{path.name}.part")
        for failures in range(1, self._retry.attempts + 1):
            try:
                with self._opened(href, headers={"Accept-Encoding": "identity"}) as response:
                    with part.open("wb") as file:
                        for chunk in response.iter_bytes():
                            file.write(chunk)
                part.replace(path)
                return path
            except (Unreachable, Unavailable) as error:
                part.unlink(missing_ok=True)
                if failures == self._retry.attempts:
                    raise
                sleep(self._retry.delay_s(failures, error))
        raise AssertionError("a Retry needs at least one attempt")


class Files(Jobs, Catalog, Downloads):
    """The methods about files."""

    def artifacts(self, job_id: str) -> Sequence[ArtifactView]:
        """All files of the job."""
        return self._items(self._job_path(job_id, "artifacts"), ArtifactView)

    def checkpoints(self, job_id: str) -> Sequence[ArtifactView]:
        """The kept checkpoints, ordered by step."""
        found = [artifact for artifact in self.artifacts(job_id) if artifact.role == "checkpoint"]
        return sorted(found, key=lambda artifact: artifact.step or 0)

    def download(
        self, job_id: str, name: str, path: str | Path | None = None, *, on_bytes: OnBytes | None = None
    ) -> Path:
        """Download the artifact `name` to `path` (a file or a folder; by default here), and check its hash.

        A broken download is resumed, also by a later call. on_bytes: called with (bytes here, in all).
        """
        job_id = self._full_id(job_id)
        href = path_of("jobs", job_id, "artifacts", name)
        artifact = self._announced(job_id, lambda job: job.artifact(name), href)
        return self._download(artifact, target(artifact.name, path), on_bytes)

    def video(
        self,
        job_id: str,
        path: str | Path | None = None,
        step: int | None = None,
        *,
        seed: int | None = None,
        on_bytes: OnBytes | None = None,
    ) -> Path:
        """Download the job's video as an MP4 to `path`; step: of this checkpoint, not the newest.

        seed: whose, of several; by default the first's.
        """
        return self._newest(job_id, "video", path, step, seed, on_bytes)

    def poster(
        self, job_id: str, path: str | Path | None = None, step: int | None = None, *, seed: int | None = None
    ) -> Path:
        """Download a still of the video."""
        return self._newest(job_id, "poster", path, step, seed, None)

    def _newest(
        self,
        job_id: str,
        role: str,
        path: str | Path | None,
        step: int | None,
        seed: int | None,
        on_bytes: OnBytes | None,
    ) -> Path:
        job_id = self._full_id(job_id)
        href = _with_query(path_of("jobs", job_id, role), step=step, seed=seed)
        artifact = self._announced(job_id, lambda job: job.newest(role, step, seed), href)
        return self._download(artifact, target(artifact.name, path), on_bytes)

    def recording(
        self, job_id: str, path: str | Path | None = None, *, on_bytes: OnBytes | None = None
    ) -> Path:
        """Download what a rollout recorded, an HDF5 file, to `path` (docs/neuroscience.md).

        Raises NotFound for a job that records nothing."""
        return self.download(job_id, "recording.h5", path, on_bytes=on_bytes)

    def battery(self, job_id: str, *, seed: int | None = None) -> dict[str, Any]:
        """What the battery of the job's policy found, as `battery.json` has it (docs/battery.md).

        seed: whose, of several; by default the first's. Raises NotFound for a job without one.
        """
        full_id = self._full_id(job_id)
        job = self.get(full_id)
        found = job.newest("battery", seed=seed)
        name = "battery.json" if found is None else found.name
        with tempfile.TemporaryDirectory(prefix="gaitway-") as folder:
            path = self.download(full_id, name, Path(folder))
            return json.loads(path.read_bytes())

    def clip_errors(self, job_id: str, *, seed: int | None = None) -> Any:
        """How far each joint and body was off over the time of each clip, as a data frame of pandas: a row
        for each part of a clip's time, by `clip` and `time_s` (its middle); columns are `joints`, in rad, and
        `bodies`, in m, by name. Without an episode in a part, NaN.

        seed: as `battery`. Raises NotFound without a battery, ValueError where that has no clips, and
        MissingExtra.
        """
        pandas = frames.package("pandas")  # Raises before anything is fetched.
        found = (self.battery(job_id, seed=seed)).get("over_time")
        if found is None:
            raise ValueError(f"The battery of {job_id} has no errors over the time of clips.")
        return frames.errors_over_time(pandas, found)

    def test_policy(self, job_id: str, *, best: bool = False, seed: int | None = None, **battery: Any) -> Job:
        """Submit a rollout that tests the job's policy, and nothing else; its battery comes with its end.

        best: the policy whose evaluation had the highest return. seed: whose, of several. battery: `starts`,
        `seconds`, `push`, `bounds` (docs/battery.md).
        """
        full_id = self._full_id(job_id)
        which = {"which": "best"} if best else {}
        of_seed = {} if seed is None else {"seed": seed}
        policy = {"kind": "checkpoint", "job": full_id, **which, **of_seed}
        return self.submit(
            {"kind": "rollout", "policy": policy, "video": None, "num_steps": 1, "battery": battery}
        )

    def load_policy(
        self,
        job_id: str,
        step: int | None = None,
        deterministic: bool = True,
        *,
        best: bool = False,
        seed: int | None = None,
    ) -> policy.Policy:
        """The trained policy as a jitted function: `act(observation, key=None)` on arrays [..., size].

        It returns an action; of Q-learning the columns chosen (docs/q_learning.md), each to be held for
        `decision_steps` steps.
        step: the policy of this checkpoint; by default the final one, or that of the newest checkpoint if the
        job has no final one yet. best: the policy whose evaluation had the highest return, instead. seed:
        whose, of several, by default the first's; they have no policy of a checkpoint.
        deterministic: without exploration noise (otherwise `key` is needed). Call a policy that was trained
        with `action_repeat` once every `action_repeat` steps, and hold its action.
        Raises MissingExtra without the `policy` extra, and PolicyUnreadable.
        """
        job = self.get(job_id)
        artifact = policy.file_of(job, step, best, seed)
        with tempfile.TemporaryDirectory(prefix="gaitway-") as folder:
            path = self._download(artifact, Path(folder) / "policy")
            return run(
                partial(
                    policy.load,
                    path,
                    policy.algorithm_of(job),
                    is_checkpoint=artifact.role == "checkpoint",
                    deterministic=deterministic,
                )
            )

    def export_policy(
        self,
        job_id: str,
        format: Literal["numpy", "onnx", "robot"],
        path: str | Path | None = None,
        *,
        best: bool = False,
        seed: int | None = None,
        on_bytes: OnBytes | None = None,
    ) -> Path:
        """Download the final policy for programs without this package, to `path` (docs/export.md).

        format: `numpy`, `policy.npz`, which `gaitway.exported_policy` reads with NumPy alone; `onnx`,
        `policy.onnx` for any ONNX runtime; or `robot`, `policy.robot.onnx` from what a robot measures to its
        joints' targets. best: the policy whose evaluation had the highest return, instead:
        `policy-best.npz` or `policy-best.onnx`. seed: whose, of several, by default the first's:
        `policy-seed-<n>.npz`. Raises NotReady until the job has ended (the artifact `policy.npz` is the
        newest checkpoint's until then), and Rejected for the tables of Q-learning.
        """
        job_id = self._full_id(job_id)
        which = "best" if best else None
        href = _with_query(path_of("jobs", job_id, "policy"), format=format, which=which, seed=seed)
        ending = _ENDINGS.get(format, "")
        artifact = self._announced(job_id, lambda job: _finished(job, ending, best, seed), href)
        return self._download(artifact, target(artifact.name, path), on_bytes)

    def export(self, job_id: str, path: str | Path | None = None) -> Path:
        """Download all that is needed to run the job again elsewhere, as a zip (docs/sharing.md).

        `import_job` makes a job of it on another service."""
        job_id = self._full_id(job_id)
        return self._save(path_of("jobs", job_id, "export"), target(f"{job_id}.zip", path))

    def share(self, job_id: str, path: str | Path | None = None) -> Path:
        """Download a report on the job: one HTML file with curves and video, which needs no network."""
        job_id = self._full_id(job_id)
        return self._save(path_of("jobs", job_id, "report.html"), target(f"{job_id}.html", path))

    def import_job(
        self,
        path: str | Path,
        *,
        project: str | None = None,
        idempotency_key: str | None = None,
        timeout: float = 600.0,
    ) -> Job:
        """Make an ended job of an export, from this service or another: others can resume from it.

        The user's own model and clips in it are sent first. Retries of the request create only one job;
        idempotency_key extends this to several calls. project: whose members see it. timeout:
        seconds for the service to store it. Raises Rejected where the
        file is no whole export, or the service cannot have such a job (docs/sharing.md).
        """
        file = Path(path)
        with tempfile.TemporaryDirectory(prefix="gaitway-") as folder:
            for model in run(partial(models_in, file, Path(folder))):
                self.add_model(model, timeout, project=project)
            for clips, told in run(partial(clips_in, file, Path(folder))):
                self.add_clips(
                    clips, told["body"], timeout, rate=told["rate"], name=told["name"], project=project
                )
        headers = {
            "Content-Type": "application/zip",
            "Idempotency-Key": idempotency_key or uuid.uuid4().hex,
        }
        # The service answers once it has read all of the file and stored it.
        params = {"project": project} if project else {}
        return self._post(
            "/jobs/import", Job, file=file, headers=headers, params=params, read_timeout_s=timeout
        )

    def _announced(
        self, job_id: str, find: Callable[[JobView], ArtifactView | None], href: str
    ) -> ArtifactView:
        """The artifact that `find` finds in the job; or raises the service's refusal."""
        artifact = find(self.get(job_id))
        if artifact is None:
            self._request("GET", href, headers={"Range": "bytes=0-0"})
            artifact = find(self.get(job_id))  # it has come in between
        if artifact is None:
            raise NotFound(404, {"detail": f"Job {job_id} does not list the file at {href}."})
        return artifact


def _with_query(href: str, **query: str | int | None) -> str:
    parameters = {name: value for name, value in query.items() if value is not None}
    return f"{href}?{urlencode(parameters)}" if parameters else href


def _finished(job: JobView, ending: str, best: bool, seed: int | None) -> ArtifactView | None:
    """The policy in the form with this ending, if it is that of the policy's own file, and no older one."""
    stem = "policy-best" if best else "policy"
    if job.seeds:
        stem = f"{stem}-seed-{job.seeds[0] if seed is None else seed}"
    found, own = job.artifact(f"{stem}.{ending}"), job.newest("best_policy" if best else "policy", seed=seed)
    if found is None or own is None:
        return found if job.is_final else None
    return found if found.step == own.step else None


def _is_rest(response: httpx.Response, have: int) -> bool:
    """Whether the answer is the rest that was asked for, not the whole file."""
    return response.status_code == 206 and response.headers.get("Content-Range", "").startswith(
        f"bytes {have}-"
    )


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
