"""PPO's hyperparameters, by Brax's names and under Brax's constraints (brax.training.agents.ppo.train).

Also which of them go together, and the least memory of a run.
"""

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import Field

from core.algorithms.layers import intention, plain
from core.algorithms.memory import FLOAT_BYTES, MemoryNeed, MemoryPart, perceptron
from core.algorithms.ppo.network_spec import IntentionNetwork, LayerSizes
from core.algorithms.spec import (
    BaseSpec,
    EpisodeLength,
    NormalizeObservations,
    NormalizeObservationsMaxAbsValue,
    NumEnvs,
    NumEvalEnvs,
    NumEvals,
    NumTimesteps,
    ResetPoolSize,
    check_curriculum,
)
from core.environments.info import CRITIC_GROUP, POLICY_GROUP, Device, EnvironmentInfo
from core.errors import Problem, Rejected

Activation = Literal["swish", "relu", "tanh", "elu", "gelu", "leaky_relu", "selu", "sigmoid", "softplus"]
ObservationName = Annotated[str, Field(min_length=1, max_length=64)]


class PPOSpec(BaseSpec):
    """Proximal policy optimisation (Schulman et al., 2017).

    A field that is not given takes the value tuned for the environment and the device, if there is
    one, and otherwise the default shown here; `GET /environments/{id}` shows the result.
    """

    fixed_by_checkpoint: ClassVar[tuple[str, ...]] = (
        "num_envs",
        "env_steps_per_update",
        "action_repeat",
        "policy_hidden_layer_sizes",
        "value_hidden_layer_sizes",
        "network_shape",
        "encoder_places",
        "activation",
        "policy_obs_key",
        "value_obs_key",
        "normalize_observations",
        "normalize_observations_max_abs_value",
        "returns_to_first_state",
    )
    checkpoint_holds_envs: ClassVar[bool] = True
    arguments: ClassVar[tuple[str, ...]] = (
        "learning_rate",
        "entropy_cost",
        "desired_kl",
        "learning_rate_schedule_min_lr",
        "learning_rate_schedule_max_lr",
        "discounting",
        "gae_lambda",
        "reward_scaling",
        "clipping_epsilon",
        "clipping_epsilon_value",
        "vf_loss_coefficient",
        "max_grad_norm",
    )
    why_no_seeds: ClassVar[str | None] = None
    reads_critic: ClassVar[bool] = True
    trains_in_parts: ClassVar[bool] = True

    kind: Literal["ppo"] = "ppo"
    num_timesteps: NumTimesteps = 3_000_000
    num_envs: NumEnvs = 256
    episode_length: EpisodeLength = 1000
    action_repeat: int = Field(
        default=1,
        ge=1,
        le=1000,
        description="Environment steps per action; their rewards are summed. All step counts are in "
        "environment steps, except unroll_length.",
    )
    random_initial_episode_length: bool = Field(
        default=False,
        description="Start each environment's first episode with a random step count, so that episodes are "
        "not all cut off at the same step, then or later (RSL-RL's init_at_random_ep_len).",
    )
    reset_pool_size: ResetPoolSize = 128
    unroll_length: int = Field(
        default=10,
        ge=1,
        le=10_000,
        description="Actions per unroll; the value function bootstraps at its end.",
    )
    batch_size: int = Field(default=256, ge=1, le=2**20, description="Unrolls per minibatch.")
    num_minibatches: int = Field(default=8, ge=1, le=10_000)
    num_updates_per_batch: int = Field(default=4, ge=1, le=1000, description="Passes over each batch.")
    learning_rate: float = Field(
        default=3e-4, gt=0, le=1, description="Adam's learning rate; with a schedule, the initial one."
    )
    learning_rate_schedule: Literal["NONE", "LINEAR", "ADAPTIVE_KL"] = Field(
        default="NONE",
        description="LINEAR: lower the learning rate from update to update, to 0 at the budget's end. "
        "ADAPTIVE_KL: after each minibatch, lower it if the KL divergence exceeds twice desired_kl, and "
        "raise it if it is below half of desired_kl.",
    )
    desired_kl: float = Field(
        default=0.01,
        gt=0,
        le=100,
        description="ADAPTIVE_KL: target KL divergence of the policy from the one that acted.",
    )
    learning_rate_schedule_min_lr: float = Field(
        default=1e-5, gt=0, le=1, description="LINEAR, ADAPTIVE_KL: lower bound of the learning rate."
    )
    learning_rate_schedule_max_lr: float = Field(
        default=1e-2, gt=0, le=1, description="ADAPTIVE_KL: upper bound of the learning rate."
    )
    entropy_cost: float = Field(default=1e-3, ge=0, le=10)
    discounting: float = Field(default=0.97, gt=0, le=1)
    gae_lambda: float = Field(default=0.95, ge=0, le=1)
    reward_scaling: float = Field(default=1.0, gt=0, le=1e6)
    clipping_epsilon: float = Field(default=0.3, gt=0, lt=1)
    clipping_epsilon_value: float | None = Field(
        default=None,
        gt=0,
        le=1e6,
        description="Bound on how far the loss lets a value estimate move in an update, in units of scaled "
        "reward. null: no bound.",
    )
    vf_loss_coefficient: float = Field(default=0.5, ge=0, le=100)
    max_grad_norm: float | None = Field(
        default=None, gt=0, le=1e6, description="Bound on the gradient's global norm."
    )
    bootstrap_on_timeout: bool = Field(
        default=False,
        description="Learn from the step that cuts an episode off, with its observation's value in place of "
        "what would have followed. false: leave that step out.",
    )
    normalize_observations: NormalizeObservations = True
    normalize_observations_max_abs_value: NormalizeObservationsMaxAbsValue = None
    normalize_advantage: bool = True
    num_evals: NumEvals = 10
    num_eval_envs: NumEvalEnvs = 16
    deterministic_eval: bool = True
    policy_hidden_layer_sizes: LayerSizes = [32, 32, 32, 32]
    network: IntentionNetwork | None = Field(
        default=None,
        description="The policy's network in place of a perceptron of policy_hidden_layer_sizes; null: that "
        "perceptron.",
    )
    value_hidden_layer_sizes: LayerSizes = [256, 256, 256, 256, 256]
    activation: Activation = Field(
        default="swish", description="Activation function of both networks, by Brax's name."
    )
    policy_obs_key: ObservationName = Field(
        default="state",
        description="The policy's observation, in an environment with several observations by name.",
    )
    value_obs_key: ObservationName = Field(
        default="state",
        description="The value function's observation, in an environment with several by name; where there "
        "is a `critic`, by default that (`privileged_state`).",
    )

    @property
    def network_shape(self) -> Mapping[str, Any] | None:
        """The sizes of the policy's network, where that is no perceptron."""
        network = self.network
        return (
            None if network is None else network.model_dump(include={"kind", "latent", "encoder", "decoder"})
        )

    @property
    def encoder_places(self) -> list[list[int]] | None:
        """`network.places`, as a checkpoint's header has them."""
        places = None if self.network is None else self.network.places
        return None if places is None else [list(place) for place in places]

    @property
    def unread(self) -> Mapping[str, str]:
        if self.network is None:
            return {}
        detail = (
            "policy_hidden_layer_sizes are of a perceptron, and `network` takes its place: leave them out."
        )
        return {"policy_hidden_layer_sizes": detail}

    def of_environment(self, environment: EnvironmentInfo) -> Self:
        if self.network is None:
            return self
        return self.model_copy(update={"network": self.network.placed(environment, self.policy_obs_key)})

    @property
    def env_steps_per_update(self) -> int:
        """Environment steps that one update consumes."""
        return self.batch_size * self.num_minibatches * self.unroll_length * self.action_repeat

    @property
    def actions_per_update(self) -> int:
        """Actions of each environment in one update."""
        return self.env_steps_per_update // (self.num_envs * self.action_repeat)

    @property
    def actions_per_episode(self) -> int:
        """Actions after which an episode is cut off."""
        return -(-self.episode_length // self.action_repeat)

    @property
    def returns_to_first_state(self) -> bool:
        """Whether every environment goes back to its own first state, which its checkpoints then hold."""
        return self.reset_pool_size == 0

    @property
    def num_updates(self) -> int:
        """Updates that reach the budget; the last may pass it, as in Brax."""
        return -(-self.num_timesteps // self.env_steps_per_update)

    @property
    def num_parallel_envs(self) -> int:
        return self.num_envs

    @property
    def budget(self) -> int:
        return self.num_timesteps

    @property
    def read_at_start(self) -> tuple[str, ...]:
        # An adaptive learning rate continues from the last one.
        adapts = self.learning_rate_schedule == "ADAPTIVE_KL"
        return ("random_initial_episode_length", *(("learning_rate",) if adapts else ()))

    def check_sharing(self, num_devices: int, num_hosts: int = 1) -> None:
        """Devices share environments and minibatches in equal parts, whatever hosts they belong to."""
        problems = [
            Problem(
                f"/algorithm/{name}",
                f"{name} = {number} is not a multiple of the {num_devices} devices that share the run.",
            )
            for name in ("num_envs", "batch_size")
            if (number := getattr(self, name)) % num_devices
        ]
        if problems:
            raise Rejected(" ".join(problem.detail for problem in problems), problems)


def refusal(settings: PPOSpec, environment: EnvironmentInfo, device: Device) -> Rejected | None:
    """Why these values do not go together, or not with this environment; None where they do."""
    return (
        _uneven_batch(settings, device)
        or _crossed_learning_rates(settings)
        or _lone_actions(settings)
        or _unknown_observation(settings, environment)
        or check_curriculum(settings.reset_pool_size, environment)
    )


def _uneven_batch(settings: PPOSpec, device: Device) -> Rejected | None:
    unrolls = settings.batch_size * settings.num_minibatches
    if unrolls % settings.num_envs == 0:
        return None
    return Rejected(
        f"On a {device.upper()}, batch_size × num_minibatches = {settings.batch_size} × "
        f"{settings.num_minibatches} = {unrolls} is not a multiple of num_envs = {settings.num_envs}; "
        f"every environment must contribute the same number of unrolls to a batch.",
        [
            Problem(f"/algorithm/{name}", f"{getattr(settings, name)} does not go together with the others.")
            for name in ("batch_size", "num_minibatches", "num_envs")
        ],
    )


def _crossed_learning_rates(settings: PPOSpec) -> Rejected | None:
    lowest, highest = settings.learning_rate_schedule_min_lr, settings.learning_rate_schedule_max_lr
    if lowest <= highest:
        return None
    detail = (
        f"learning_rate_schedule_min_lr = {lowest:g} is above learning_rate_schedule_max_lr = {highest:g}."
    )
    names = ("learning_rate_schedule_min_lr", "learning_rate_schedule_max_lr")
    return Rejected(detail, [Problem(f"/algorithm/{name}", detail) for name in names])


def _lone_actions(settings: PPOSpec) -> Rejected | None:
    network = settings.network
    if network is None or network.smoothness_weight == 0 or settings.unroll_length > 1:
        return None
    detail = (
        "smoothness_weight is that of how far an intention moves from one action of an unroll to the next, "
        "and with unroll_length = 1 there is no next one: take a longer unroll, or leave it out."
    )
    places = ("network/smoothness_weight", "unroll_length")
    return Rejected(detail, [Problem(f"/algorithm/{place}", detail) for place in places])


def _unknown_observation(settings: PPOSpec, environment: EnvironmentInfo) -> Rejected | None:
    known = environment.observations
    has = "one observation" if len(known) == 1 else "the observations"
    problems = [
        Problem(
            f"/algorithm/{name}",
            f"{environment.id} has {has}, {' and '.join(map(repr, known))}, and none called {key!r}.",
        )
        for name in ("policy_obs_key", "value_obs_key")
        if (key := getattr(settings, name)) not in known
    ]
    return Rejected(problems[0].detail, problems) if problems else None


# Reward, discount, truncation, and the log-probability of the action.
_SCALARS = 4
# The parameters, their gradient, and Adam's two moments.
_COPIES = 4


def least_memory(settings: PPOSpec, environment: EnvironmentInfo, num_devices: int) -> MemoryNeed:
    """Bytes on each device, all in float32.

    Left out, because they cannot be bounded from below without loading the environment: the engine's own
    arrays, activations, the next observations and the copies that XLA makes while it shuffles. Unknown
    sizes count as 0.
    """
    sizes = {POLICY_GROUP: environment.observation_size or 0}
    if CRITIC_GROUP in environment.observations:
        sizes[CRITIC_GROUP] = sum(part.size for part in environment.spaces.critic)
    observation, action = sum(sizes.values()), environment.action_size or 0
    transitions = settings.batch_size * settings.num_minibatches * settings.unroll_length // num_devices
    numbers = observation + action + _SCALARS
    parameters = _policy_parameters(settings, sizes[settings.policy_obs_key], action)
    if settings.network is not None:
        numbers += settings.network.latent  # The noise of z.
    parameters += perceptron([sizes[settings.value_obs_key], *settings.value_hidden_layer_sizes, 1])
    num_envs = settings.num_envs // num_devices
    return MemoryNeed(
        (
            MemoryPart(
                f"the {transitions:,} transitions of one update",
                FLOAT_BYTES * transitions * numbers,
                ("batch_size", "num_minibatches", "unroll_length"),
            ),
            MemoryPart(
                f"networks of {parameters:,} parameters with their gradient and Adam's moments",
                FLOAT_BYTES * _COPIES * parameters,
                (
                    "policy_hidden_layer_sizes" if settings.network is None else "network",
                    "value_hidden_layer_sizes",
                ),
            ),
            # Their observations; the rest of their state depends on the model.
            MemoryPart(
                f"{num_envs:,} environments", FLOAT_BYTES * num_envs * (observation + 1), ("num_envs",)
            ),
        )
    )


def layers(settings: PPOSpec, action_size: int) -> Mapping[str, int]:
    """The layers of the policy, with their sizes."""
    network = settings.network
    if network is None:
        return plain(settings.policy_hidden_layer_sizes, action_size)
    return intention(network.encoder, network.latent, network.decoder, action_size)


def _policy_parameters(settings: PPOSpec, observation: int, action: int) -> int:
    """How many the policy has. It puts out a mean and a deviation for each component."""
    network = settings.network
    if network is None:
        return perceptron([observation, *settings.policy_hidden_layer_sizes, 2 * action])
    seen = sum(size for _, size in network.places or ())
    encoder = perceptron([seen, *network.encoder, 2 * network.latent])
    decoder = perceptron([network.latent + observation - seen, *network.decoder, 2 * action])
    return encoder + decoder
