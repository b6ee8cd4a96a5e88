"""The deep Q-network's hyperparameters, which of them go together, and the least memory of a run."""

from typing import ClassVar, Literal

from pydantic import Field

from core.algorithms.memory import FLOAT_BYTES, MemoryNeed, MemoryPart, perceptron
from core.algorithms.off_policy.spec import OffPolicySpec, environments_part, replay_part, replay_refusal
from core.algorithms.ppo.network_spec import LayerSizes
from core.algorithms.q_learning.checks import problems_of_the_actions
from core.algorithms.q_learning.spec import ActionSetOptions, choice_space
from core.algorithms.spec import EpsilonSchedule, NumEnvs, NumTimesteps
from core.environments.info import Device, EnvironmentInfo, FiniteSpace
from core.errors import Rejected


class DQNSpec(OffPolicySpec):
    """A deep Q-network (Mnih et al., 2015), of the kind that estimates less too much (double DQN, van Hasselt
    et al., 2016): what the table of `q_learning` does, for observations that no table could list.

    A field that is not given takes the value tuned for the environment and the device, if there is
    one, and otherwise the default shown here; `GET /environments/{id}` shows the result.
    """

    fixed_by_checkpoint: ClassVar[tuple[str, ...]] = (
        "num_envs",
        "env_steps_per_update",
        "action_repeat",
        "action_set",
        "replay_rows",
        "hidden_layer_sizes",
        "activation",
        "normalize_observations",
        "normalize_observations_max_abs_value",
        "returns_to_first_state",
    )

    kind: Literal["dqn"] = "dqn"
    action_set: ActionSetOptions | None = Field(
        default=None, description="The choices: what each of the network's outputs is the value of."
    )
    num_timesteps: NumTimesteps = 500_000
    num_envs: NumEnvs = 32
    unroll_length: int = Field(
        default=1, ge=1, le=10_000, description="Actions of each environment from one learning to the next."
    )
    batch_size: int = Field(default=256, ge=1, le=2**20, description="Transitions of a gradient step.")
    min_replay_size: int = Field(
        default=1000, ge=0, le=10**9, description="Transitions that are stored before learning begins."
    )
    max_replay_size: int = Field(
        default=2**17,
        ge=1,
        le=10**9,
        description="Transitions that are kept, of all environments; checkpoints hold them.",
    )
    n_step: int = Field(
        default=1, ge=1, le=100, description="Rewards that a target adds up before it estimates the rest."
    )
    learning_rate: float = Field(default=1e-3, gt=0, le=1, description="Adam's.")
    epsilon: EpsilonSchedule = EpsilonSchedule(start=1.0)
    hidden_layer_sizes: LayerSizes = [64, 64]


def refusal(settings: DQNSpec, environment: EnvironmentInfo, device: Device) -> Rejected | None:
    """Why these values do not go together, or not with this environment; None where they do."""
    problems = [
        *problems_of_the_actions(
            settings.action_set, environment, "the network has an output for each choice"
        ),
        *settings.epsilon.problems(settings.num_actions),
    ]
    if problems:
        return Rejected(" ".join(problem.detail for problem in problems), problems)
    return replay_refusal(settings, environment, num_parts(settings, environment))


# The parameters, their gradient, Adam's two moments, and the network that follows.
_COPIES = 5
_NOTHING = FiniteSpace(0, 0)


def least_memory(settings: DQNSpec, environment: EnvironmentInfo, num_devices: int) -> MemoryNeed:
    """Bytes, all in float32. Left out: the engine's own arrays, and activations. Unknown sizes count as 0."""
    space = _choices(settings, environment)
    outputs = space.num_parts * space.num_values
    network = perceptron([environment.observation_size or 0, *settings.hidden_layer_sizes, outputs])
    return MemoryNeed(
        (
            replay_part(settings, environment, space.num_parts),
            MemoryPart(
                f"a network of {network:,} parameters with its gradient, Adam's moments and the network that "
                "follows",
                FLOAT_BYTES * _COPIES * network,
                ("hidden_layer_sizes",),
            ),
            environments_part(settings, environment),
        )
    )


def num_parts(settings: DQNSpec, environment: EnvironmentInfo) -> int:
    """How many parts of the body choose for themselves; 0 where that is not known."""
    return _choices(settings, environment).num_parts


def _choices(settings: DQNSpec, environment: EnvironmentInfo) -> FiniteSpace:
    """A run without choices, which is refused elsewhere, has none."""
    space = choice_space(settings.action_set, environment) if settings.action_set is not None else None
    return space or _NOTHING
