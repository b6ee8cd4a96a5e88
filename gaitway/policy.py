"""A trained policy as a function for notebooks. Imports JAX only when called."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gaitway.errors import MissingExtra, NotFound, PolicyUnreadable
from gaitway.schema import ArtifactView, JobView

if TYPE_CHECKING:
    import jax

Policy = Callable[..., "jax.Array"]
# (a file's content, is_checkpoint, deterministic) -> (parameters, (parameters, observation, key) -> output)
Reader = Callable[[bytes, bool, bool], tuple[Any, Any]]


READERS = ("distillation", "dqn", "ppo", "q_learning", "sac")
# Their policies are read from the files for programs elsewhere; their own files are for Brax.
_EXPORTED = ("distillation", "ppo", "sac")


def file_of(job: JobView, step: int | None, best: bool, seed: int | None) -> ArtifactView:
    """The file to load: that of this checkpoint, or of the best policy, or of the last one.

    seed: whose, of several; by default the first's. Raises NotFound; and ValueError where both `step` and
    `best` are given.
    """
    if best and step is not None:
        raise ValueError("A policy is that of a step or the best one: give one of the two.")
    own = job.newest("best_policy" if best else "policy", seed=seed) if step is None else None
    if own is not None:
        if algorithm_of(job) not in _EXPORTED:
            return own
        exported = job.artifact(f"{own.name}.npz")
        if exported is not None and exported.step == own.step:
            return exported
    if job.seeds:
        raise _absent(job, "such policy for each seed, and its checkpoints hold those of all: roll one out")
    checkpoint = None if best and own is None else job.newest("checkpoint", own.step if own else step)
    if checkpoint is not None:
        return checkpoint
    if own is not None:
        when = "" if job.is_final else ", which is written when the training ends"
        raise _absent(job, f"{own.name}.npz{when}. Its file {own.name} is for `brax.io.model.load_params`")
    if best:
        raise _absent(job, "best policy: no evaluation kept one (yet)")
    steps = [str(artifact.step) for artifact in job.artifacts if artifact.role == "checkpoint"]
    which = "policy" if step is None else f"checkpoint of step {step}"
    raise _absent(job, f"{which}; its checkpoints: {', '.join(steps) or 'none yet'}")


def _absent(job: JobView, what: str) -> NotFound:
    return NotFound(404, {"detail": f"Job {job.id} has no {what}."})


def algorithm_of(job: JobView) -> str:
    return job.spec.get("algorithm", {}).get("kind", "ppo")


def load(path: Path, algorithm: str, *, is_checkpoint: bool, deterministic: bool = True) -> Policy:
    """The policy in a file that `file_of` names, as a jitted `act(observation, key=None)` -> its output:
    an action, or for Q-learning and DQN what is chosen (docs/q_learning.md, docs/dqn.md).

    observation: the input of the algorithm's policies; for networks [..., observation_size]. An action is
    [..., action_size], each component in [-1, 1]. key: a JAX random key, needed by a stochastic policy
    (ValueError without one).
    Raises MissingExtra where JAX or msgpack is not installed, and PolicyUnreadable.
    """
    if algorithm not in READERS:
        raise PolicyUnreadable(f"This version of gaitway does not read policies of {algorithm!r}.")
    try:
        import jax

        read = _reader(algorithm)
    except ModuleNotFoundError as error:
        raise MissingExtra(
            f"A policy is loaded with JAX and msgpack, and {error.name} is not installed; "
            f"install them with `pip install 'gaitway[policy]'`."
        ) from error
    parameters, function = read(path.read_bytes(), is_checkpoint, deterministic)
    answer: Any = jax.jit(function)  # pyright: ignore[reportUnknownMemberType]
    unused = jax.random.key(0)

    def act(observation: Any, key: "jax.Array | None" = None) -> "jax.Array":
        if key is None and not deterministic:
            raise ValueError("A policy that samples needs a random key: act(observation, jax.random.key(0)).")
        return answer(parameters, observation, unused if key is None else key)

    return act


def _reader(algorithm: str) -> Reader:
    """Imports JAX."""
    from gaitway.policies import networks, tables

    match algorithm:
        case "ppo":
            return partial(networks.load, networks.PPO)
        case "distillation":
            return partial(networks.load, networks.DISTILLATION)
        case "sac":
            return partial(networks.load, networks.SAC)
        case "dqn":
            return networks.load_dqn
        case "q_learning":
            return tables.load
        case _:
            raise AssertionError(f"READERS names {algorithm}, which has no reader.")
