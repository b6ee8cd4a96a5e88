"""One training of a body that follows clips, and how far its policy follows them from many starts.

Request: body, a robot; options (without `reference`, which is added); reference (without its clips); clips,
our own files of clips or NPZs as mjlab's; mirrored, whether it follows their mirror images, too; settings (of
PPO; what they leave out is tuned); seed; device (`cpu` or `gpu`); cache, a folder for compiled programs;
starts; close, up to which errors of root (m) and joints (rad) an episode is close; unseen, a file of clips
that are followed besides, or null; further, the steps of a training that goes on with these alone, or 0;
keep, a file for the policy, or null.
"""

import hashlib
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from bench.child import answer
from bench.children.train_ours import engine_of, keep_compiled
from core.start_up import start_lean


def work(request: dict[str, Any]) -> dict[str, Any]:
    """built_at, policy_at, tested_at: the hours when the environment was built, the policy was trained, and
    its trial was over. training: [[steps, seconds of training until then], …]; steps; engine; all, by clip,
    of all unseen clips, and of these once they are learnt: see `FollowingResult`; of C MuJoCo. further_s:
    seconds of the training that learns them."""
    start_lean()  # As a job does.
    from core.algorithms.events import TrainingProgress
    from core.algorithms.following import followed, spread_over
    from core.algorithms.run import make_run
    from core.algorithms.trained_policy import load_policy
    from core.environments import catalog
    from core.environments.task import TaskEnv
    from core.jobs.resolved import resolve_job
    from core.jobs.spec import TrainSpec
    from core.physics.choose import engine_builder

    with tempfile.TemporaryDirectory() as folder:
        sent = [Path(file) for file in (*request["clips"], request["unseen"]) if file is not None]
        identities = [f"sha256:{hashlib.sha256(file.read_bytes()).hexdigest()}" for file in sent]
        files = dict(zip(identities, canonical(sent, Path(folder)), strict=True))
        chosen, number = [{"file": identity} for identity in identities], len(request["clips"])
        seen, unseen = chosen[:number], chosen[number:]
        mirrored = [{**clip, "mirror": True} for clip in seen] if request["mirrored"] else []

        def job_on(clips: list[Any]) -> Any:
            reference = {**request["reference"], "clips": clips}
            body = {"id": request["body"], "options": {**request["options"], "reference": reference}}
            settings = {"kind": "ppo", **request["settings"]}
            return resolve_job(TrainSpec.model_validate({"environment": body, "algorithm": settings}))

        def tried(content: bytes, clips: list[Any]) -> tuple[Any, dict[str, Any]]:
            policy = load_policy(content, "ppo", is_checkpoint=False)
            judged = catalog.make(job.info, job_on(clips).options, engine_builder("native"), clips=files)
            assert isinstance(judged, TaskEnv)  # noqa: S101 - it follows a reference
            rows = spread_over(judged, request["starts"])
            return followed(judged, policy, rows, seed=request["seed"], close=request["close"])[:2]

        def trained(run: Any) -> list[tuple[int, float]]:
            return [
                (event.step, event.metrics["training/walltime"])
                for event in run.events()
                if isinstance(event, TrainingProgress)
            ]

        job = job_on([*seen, *mirrored])
        ppo = job.settings_on(request["device"])
        engine = engine_of("auto", job.info, request["device"], ppo.num_parallel_envs)
        keep_compiled(request["cache"], engine)
        environment = catalog.make(job.info, job.options, engine_builder(engine), clips=files)
        told: dict[str, Any] = {"engine": engine, "built_at": time.time()}
        run = make_run(environment, ppo, seed=request["seed"], checkpoint_every_steps=None)
        told["training"] = trained(run)
        content = run.policy()
        told |= {"steps": run.step, "policy_at": time.time()}
        if request["keep"] is not None:
            Path(request["keep"]).write_bytes(content)
        whole, by_clip = tried(content, seen)
        told |= {"all": whole.document(), "clips": {name: one.document() for name, one in by_clip.items()}}
        told |= {"tested_at": time.time(), "unseen": {}, "learnt": {}, "further_s": 0.0}
        if unseen:
            told["unseen"] = tried(content, unseen)[0].document()
        if request["further"]:
            longer = ppo.model_copy(update={"num_timesteps": run.step + request["further"]})
            environment = catalog.make(job.info, job_on(unseen).options, engine_builder(engine), clips=files)
            run = make_run(
                environment,
                longer,
                seed=request["seed"],
                checkpoint_every_steps=None,
                resume=run.checkpoint(),
                new_clips=True,
            )
            _, told["further_s"] = trained(run)[-1]
            told["learnt"] = tried(run.policy(), unseen)[0].document()
    return told


def canonical(files: list[Path], folder: Path) -> Iterator[Path]:
    """Files of clips as the service keeps them."""
    from core.clips.archive import to_bytes

    for number, file in enumerate(files):
        kept = folder / f"{number}.npz"
        kept.write_bytes(to_bytes(_clips(file)))
        yield kept


def _clips(file: Path) -> list[Any]:
    """Those of our own file, or of an NPZ as mjlab's whose `joint_pos` has the root's seven numbers first."""
    import numpy as np

    from core.clips.archive import from_file
    from core.clips.clip import Clip

    with np.load(file) as arrays:
        if "joint_pos" not in arrays:
            return from_file(file)
        positions, joints = arrays["joint_pos"], tuple(map(str, arrays["joint_names"]))
        turns = positions[:, 3:7] / np.linalg.norm(positions[:, 3:7], axis=1, keepdims=True)
        rate = float(np.ravel(arrays["fps"])[0])
        return [Clip(file.stem, rate, positions[:, :3], turns, joints, positions[:, 7:])]


if __name__ == "__main__":
    answer(work)
