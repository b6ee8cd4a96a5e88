"""Trainings of a body, and what their policies do, as clips.

Request: body, of the catalog; settings (of PPO; what they leave out is tuned); seeds; stages, at which a
training's policy is kept; clips and unseen: of all seeds but the last, and of the last (0: all seeds are
seen); seconds of a clip; device (`cpu` or `gpu`); cache, a folder for compiled programs; out, a folder for
the files.
"""

from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any

from bench.child import answer
from bench.children.train_ours import engine_of, keep_compiled
from core.start_up import start_lean

# Episodes of a stage. The body falls in some of them.
_EPISODES = 32
# Before a clip begins, so that the body has left the pose in which episodes begin.
_BEFORE_S = 0.5


def work(request: dict[str, Any]) -> dict[str, Any]:
    """clips: of each the file, its name, its seconds, and its mean speed along the ground in m/s."""
    start_lean()  # As a job does.
    from core.clips.archive import to_bytes
    from core.jobs.resolved import resolve_job
    from core.jobs.spec import TrainSpec

    Path(request["cache"]).mkdir(parents=True, exist_ok=True)
    keep_compiled(request["cache"], "compiled")
    body = {"id": request["body"], "options": {}}
    settings = {"kind": "ppo", **request["settings"]}
    job = resolve_job(TrainSpec.model_validate({"environment": body, "algorithm": settings}))
    recorder = _Recorder(job, request["seconds"])
    seen = [list(_clips_of(seed, job, recorder, request)) for seed in request["seeds"]]
    files = dict[str, list[Any]]()
    if request["unseen"]:
        files[f"{request['body']}-unseen"] = list(islice(_in_turn([seen.pop()]), request["unseen"]))
    files[request["body"]] = list(islice(_in_turn(seen), request["clips"]))
    rows = list[dict[str, Any]]()
    for name, clips in files.items():
        file = Path(request["out"], f"{name}.npz")
        file.write_bytes(to_bytes(clips))
        rows += [_row(file.name, clip) for clip in clips]
    return {"clips": rows}


def _in_turn(seeds: list[list[list[Any]]]) -> Iterator[Any]:
    """One clip of each stage of each seed in turn."""
    stages = [stage for seed in seeds for stage in seed]
    most = max((len(stage) for stage in stages), default=0)
    return (stage[number] for number in range(most) for stage in stages if number < len(stage))


def _row(file: str, clip: Any) -> dict[str, Any]:
    import numpy as np

    way = np.linalg.norm(clip.root_position[-1, :2] - clip.root_position[0, :2])
    return {
        "file": file,
        "name": clip.name,
        "seconds": clip.duration_s,
        "speed": float(way) / clip.duration_s,
    }


def _clips_of(seed: int, job: Any, recorder: "_Recorder", request: dict[str, Any]) -> Iterator[list[Any]]:
    """The clips of each stage of a training."""
    from core.algorithms.events import TrainingProgress
    from core.algorithms.run import make_run
    from core.environments import catalog
    from core.physics.choose import engine_builder

    ppo = job.settings_on(request["device"])
    engine = engine_of("auto", job.info, request["device"], ppo.num_parallel_envs)
    environment = catalog.make(job.info, job.options, engine_builder(engine))
    run = make_run(environment, ppo, seed=seed, checkpoint_every_steps=None)
    policies = list[tuple[int, bytes]]()
    for event in run.events():
        if isinstance(event, TrainingProgress):
            due = event.total * (len(policies) + 1) / request["stages"]
            if event.step >= due or event.step >= event.total:
                policies.append((event.step, run.policy()))
    for step, content in policies:
        yield list(recorder.clips(f"{request['body']}-{seed}-{round(step / 1e3)}k", content))


class _Recorder:
    """Episodes of policies with one kind of network, in C MuJoCo; compiled once for all."""

    def __init__(self, job: Any, seconds: float) -> None:
        from core.environments import catalog
        from core.physics.choose import engine_builder

        self._environment: Any = catalog.make(job.info, job.options, engine_builder("native"))
        self._begin = round(_BEFORE_S / self._environment.dt)
        self._num_steps = round((_BEFORE_S + seconds) / self._environment.dt)
        self._episodes: Any = None

    def clips(self, name: str, policy: bytes) -> Iterator[Any]:
        """A clip of each episode in which the body does not fall."""
        import jax
        import numpy as np

        from core.algorithms.battery.run import on_the_cpu
        from core.algorithms.trained_policy import load_policy

        with on_the_cpu():
            trained = load_policy(policy, "ppo", is_checkpoint=False)
            self._episodes = self._episodes or self._compiled(trained)
            keys = jax.random.split(jax.random.key(0), _EPISODES)
            positions, fell = self._episodes(trained.parameters, keys)
        for number in np.flatnonzero(np.asarray(fell) == 0):
            rows = np.asarray(positions[number][self._begin :], float)
            yield clip_of(f"{name}-{number}", rows, self._environment.model, 1.0 / self._environment.dt)

    def _compiled(self, trained: Any) -> Any:
        import jax

        acted, act = trained.acting(self._environment)

        def episode(parameters: Any, key: jax.Array) -> tuple[jax.Array, jax.Array]:
            def step(state: Any, _: None) -> tuple[Any, tuple[jax.Array, jax.Array]]:
                state = acted.step(state, act(parameters, state, key))
                return state, (state.physics.qpos, state.done)

            _, (positions, ends) = jax.lax.scan(step, acted.reset(key), length=self._num_steps)
            return positions, jax.numpy.max(ends)

        return jax.jit(jax.vmap(episode, in_axes=(None, 0)))


def clip_of(name: str, rows: Any, model: Any, rate: float) -> Any:
    """The clip of positions [T, nq] of a body with a free root, in frames per second."""
    import numpy as np

    from core.clips.clip import Clip
    from core.clips.skeleton import skeleton_of

    skeleton = skeleton_of(model)
    start = skeleton.root_address
    turns = rows[:, start + 3 : start + 7]
    return Clip(
        name=name,
        rate=rate,
        root_position=rows[:, start : start + 3],
        root_orientation=turns / np.linalg.norm(turns, axis=1, keepdims=True),
        joints=skeleton.joints,
        joint_positions=rows[:, np.asarray(model.jnt_qposadr)[skeleton.joint_ids]],
    )


if __name__ == "__main__":
    answer(work)
