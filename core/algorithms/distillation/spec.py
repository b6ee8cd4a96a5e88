"""The hyperparameters of distillation: one policy learns what trained ones, its experts, would do."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import Field

from core.algorithms.memory import MemoryNeed
from core.algorithms.ppo import spec as ppo
from core.algorithms.ppo.network_spec import IntentionNetwork, LayerSizes, Place
from core.algorithms.spec import BaseSpec, NumEnvs, NumEvalEnvs, NumEvals, NumTimesteps, rejected
from core.bounds import LONGEST_NAME
from core.documents import Strict
from core.environments.info import POLICY_GROUP, Device, EnvironmentInfo
from core.errors import Rejected
from core.patterns import PATTERNS, Patterns, matching

EXPERTS = "/algorithm/experts"
_ClipName = Annotated[str, Field(max_length=LONGEST_NAME)]


class Expert(Strict):
    """The policy of another job. The last three fields are filled in by a submission."""

    job: Annotated[str, Field(pattern=r"^[0-9a-f]{12}-[0-9a-f]{10}$")] = Field(
        description="A training of this body that succeeded, by ppo, sac or distillation."
    )
    which: Literal["last", "best"] = Field(
        default="last", description="Its policy at the end, or that of its best evaluation."
    )
    clips: Patterns | None = Field(
        default=None,
        description="The clips for which it answers, by the names that they have in this job; null: those of "
        f"its own job, cut, mirrored and sped up as there. {PATTERNS}",
    )
    clip_names: Annotated[list[_ClipName], Field(max_length=100_000)] | None = Field(
        default=None,
        description="Those of its own job, by their names here, where `clips` is null. Filled in.",
    )
    sees: ppo.ObservationName = Field(
        default=POLICY_GROUP, description="Which observation, of several by name. Filled in."
    )
    places: Annotated[list[Place], Field(min_length=1, max_length=1000)] | None = Field(
        default=None, description="[start, size] of each part of it that it sees; null: all. Filled in."
    )

    def answers_for(self, clips: Sequence[str]) -> set[str]:
        """The clips of this job for which it answers. clips: all of them, by name."""
        return set(self.clip_names or ()) if self.clips is None else set(matching(self.clips, clips))


class DistillationSpec(BaseSpec):
    """One policy of several experts, or a student of one teacher: in the states that it comes to, it learns
    the action that an expert would take there (DAgger; Ross et al., 2011), with the networks of PPO."""

    fixed_by_checkpoint: ClassVar[tuple[str, ...]] = (
        "num_envs",
        "env_steps_per_update",
        "policy_hidden_layer_sizes",
        "network_shape",
        "encoder_places",
        "activation",
        "policy_obs_key",
        "normalize_observations",
        "normalize_observations_max_abs_value",
    )
    checkpoint_holds_envs: ClassVar[bool] = True
    arguments: ClassVar[tuple[str, ...]] = ("learning_rate", "max_grad_norm", "beta")
    reads_critic: ClassVar[bool] = True

    kind: Literal["distillation"] = "distillation"
    experts: Annotated[list[Expert], Field(max_length=64)] = Field(
        default=[],
        description="Whose actions are learnt. Every clip of the job has exactly one; a job without clips "
        "has one expert.",
    )
    num_timesteps: NumTimesteps = 3_000_000
    num_envs: NumEnvs = 256
    episode_length: int = Field(
        default=1000, ge=1, le=10**6, description="Steps after which an episode is cut off."
    )
    reset_pool_size: int = Field(
        default=128,
        ge=1,
        le=2**16,
        description="Fresh initial states drawn per update; each episode that begins in it starts from a "
        "random one of them.",
    )
    unroll_length: int = Field(
        default=20, ge=1, le=10_000, description="Actions of each environment in an update."
    )
    num_minibatches: int = Field(
        default=8, ge=1, le=10_000, description="Equal parts of the environments, for a gradient step each."
    )
    num_updates_per_batch: int = Field(
        default=4, ge=1, le=1000, description="Passes over what an update has seen."
    )
    beta: float = Field(
        default=1.0,
        ge=0,
        le=1,
        description="The share of actions that are the expert's and not the student's, at the beginning.",
    )
    beta_steps: int | None = Field(
        default=None,
        ge=0,
        le=10**12,
        description="Environment steps over which beta falls to 0, in a line; null: half of num_timesteps.",
    )
    learning_rate: float = Field(default=3e-4, gt=0, le=1, description="Adam's learning rate.")
    max_grad_norm: float | None = Field(
        default=1.0, gt=0, le=1e6, description="Bound on the gradient's global norm; null: none."
    )
    normalize_observations: bool = Field(
        default=True, description="Normalise the student's observations to mean 0 and deviation 1."
    )
    normalize_observations_max_abs_value: float | None = Field(
        default=10.0,
        gt=0,
        le=1e6,
        description="Bound on normalised observations, in standard deviations: what hardly differs in the "
        "first update may be far from its mean in some state. null: no bound.",
    )
    num_evals: NumEvals = 10
    num_eval_envs: NumEvalEnvs = 16
    policy_hidden_layer_sizes: LayerSizes = [256, 256, 256]
    network: IntentionNetwork | None = Field(
        default=None,
        description="The student's network in place of a perceptron of policy_hidden_layer_sizes; null: that "
        "perceptron.",
    )
    activation: ppo.Activation = Field(default="swish", description="Activation function, by Brax's name.")
    policy_obs_key: ppo.ObservationName = Field(
        default=POLICY_GROUP,
        description="The student's observation, in an environment with several observations by name.",
    )

    @property
    def as_ppo(self) -> ppo.PPOSpec:
        """PPO's settings with the same policy and batches, and the smallest value function."""
        ours = self.model_dump(include={*_OF_THE_POLICY})
        return ppo.PPOSpec.model_validate(
            {
                **ours,
                "batch_size": max(1, self.num_envs // self.num_minibatches),
                "value_hidden_layer_sizes": [1],
                "value_obs_key": self.policy_obs_key,
            }
        )

    @property
    def network_shape(self) -> Mapping[str, Any] | None:
        """See `PPOSpec`."""
        return self.as_ppo.network_shape

    @property
    def encoder_places(self) -> list[list[int]] | None:
        """See `PPOSpec`."""
        return self.as_ppo.encoder_places

    @property
    def unread(self) -> Mapping[str, str]:
        return self.as_ppo.unread

    def of_environment(self, environment: EnvironmentInfo) -> Self:
        return self.model_copy(update={"network": self.as_ppo.of_environment(environment).network})

    @property
    def env_steps_per_update(self) -> int:
        """Environment steps that one update consumes."""
        return self.num_envs * self.unroll_length

    @property
    def num_updates(self) -> int:
        """Updates that reach the budget; the last may pass it."""
        return -(-self.num_timesteps // self.env_steps_per_update)

    @property
    def num_parallel_envs(self) -> int:
        return self.num_envs

    @property
    def budget(self) -> int:
        return self.num_timesteps

    def num_of_expert(self, clips: Sequence[str]) -> list[int]:
        """The number of the expert of each clip; [] for a task without clips, which has one expert.

        clips: the names of all clips of the job. Raises Rejected where a clip has no expert or several, where
        an expert has no clip, and where there are several experts and no clips.
        """
        if not clips:
            if len(self.experts) == 1:
                return []
            raise rejected(
                f"There are {len(self.experts)} experts, and only clips say which of several answers: give a "
                "task without `reference` exactly one.",
                "experts",
            )
        of_each = [expert.answers_for(clips) for expert in self.experts]
        numbers = [[number for number, names in enumerate(of_each) if clip in names] for clip in clips]
        for clip, found in zip(clips, numbers, strict=True):
            if len(found) != 1:
                jobs = " and ".join(self.experts[number].job for number in found)
                has = f"the experts of jobs {jobs}" if found else "no expert"
                detail = f"The clip {clip!r} has {has}: give it one, by `clips` of `experts`."
                raise rejected(detail, "experts")
        for number, expert in enumerate(self.experts):
            if [number] not in numbers:
                raise rejected(
                    f"The expert of job {expert.job} answers for none of this job's clips: "
                    f"{', '.join(clips[:20])}.",
                    f"experts/{number}/clips",
                )
        return [found[0] for found in numbers]


# PPO's names of the same settings.
_OF_THE_POLICY = (
    *("num_timesteps", "num_envs", "episode_length", "reset_pool_size", "unroll_length", "num_minibatches"),
    *("normalize_observations", "normalize_observations_max_abs_value", "policy_hidden_layer_sizes"),
    *("network", "activation", "policy_obs_key"),
)


def refusal(settings: DistillationSpec, environment: EnvironmentInfo, device: Device) -> Rejected | None:
    """Why these values do not go together, or not with this environment; None where they do."""
    if not settings.experts:
        return rejected("Distillation needs `experts`: name a job whose policy is learnt.", "experts")
    if settings.num_envs % settings.num_minibatches:
        return rejected(
            f"num_envs = {settings.num_envs} is not a multiple of num_minibatches = "
            f"{settings.num_minibatches}; a minibatch is an equal part of the environments.",
            "num_envs",
            "num_minibatches",
        )
    return ppo.refusal(settings.as_ppo, environment, device)


def least_memory(settings: DistillationSpec, environment: EnvironmentInfo, num_devices: int) -> MemoryNeed:
    """As PPO's. Left out: the experts, whose sizes only their files tell."""
    parts = ppo.least_memory(settings.as_ppo, environment, num_devices).parts
    ours = DistillationSpec.model_fields.keys() - {"num_minibatches"}  # It only divides.
    return MemoryNeed([replace(part, lower=tuple(n for n in part.lower if n in ours)) for part in parts])


def layers(settings: DistillationSpec, action_size: int) -> Mapping[str, int]:
    """The layers of the policy, with their sizes."""
    return ppo.layers(settings.as_ppo, action_size)
