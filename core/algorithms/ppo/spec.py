"""PPO's hyperparameters, by Brax's names and under Brax's constraints (brax.training.agents.ppo.train)."""

from typing import Annotated, Literal

from pydantic import Field

from core.environments.info import Device, EnvironmentInfo
from core.errors import Problem, Rejected
from core.model import Strict

# What a run that resumes must have in common with its checkpoint; everything else may change.
FIXED_BY_CHECKPOINT = (
    "num_envs",
    "env_steps_per_update",
    "policy_hidden_layer_sizes",
    "value_hidden_layer_sizes",
    "normalize_observations",
)

LayerSizes = Annotated[list[Annotated[int, Field(ge=1, le=8192)]], Field(min_length=1, max_length=16)]


class PPOSpec(Strict):
    """Proximal policy optimisation (Schulman et al., 2017).

    A field that is not given takes the value tuned for the environment and the device, if there is
    one, and otherwise the default shown here; `GET /environments/{id}` lists the tuned values.
    """

    kind: Literal["ppo"] = "ppo"
    num_timesteps: int = Field(
        default=3_000_000, ge=1, le=10**12, description="Environment steps to train for."
    )
    num_envs: int = Field(default=256, ge=1, le=2**20, description="Environments that run side by side.")
    episode_length: int = Field(
        default=1000, ge=1, le=10**6, description="Actions after which an episode is cut off."
    )
    unroll_length: int = Field(
        default=10, ge=1, le=10_000, description="Actions between two looks at the value function."
    )
    batch_size: int = Field(default=256, ge=1, le=2**20, description="Unrolls in a minibatch.")
    num_minibatches: int = Field(default=8, ge=1, le=10_000)
    num_updates_per_batch: int = Field(default=4, ge=1, le=1000, description="Passes over each batch.")
    learning_rate: float = Field(default=3e-4, gt=0, le=1)
    entropy_cost: float = Field(default=1e-3, ge=0, le=10)
    discounting: float = Field(default=0.97, gt=0, le=1)
    gae_lambda: float = Field(default=0.95, ge=0, le=1)
    reward_scaling: float = Field(default=1.0, gt=0, le=1e6)
    clipping_epsilon: float = Field(default=0.3, gt=0, lt=1)
    vf_loss_coefficient: float = Field(default=0.5, ge=0, le=100)
    max_grad_norm: float | None = Field(
        default=None, gt=0, le=1e6, description="Bound on the gradient's global norm."
    )
    normalize_observations: bool = True
    normalize_advantage: bool = True
    num_evals: int = Field(
        default=10, ge=0, le=10_000, description="Evaluations, spread evenly; the last is at the end."
    )
    num_eval_envs: int = Field(default=16, ge=1, le=2**16, description="Episodes in an evaluation.")
    deterministic_eval: bool = True
    policy_hidden_layer_sizes: LayerSizes = [32, 32, 32, 32]
    value_hidden_layer_sizes: LayerSizes = [256, 256, 256, 256, 256]

    @property
    def env_steps_per_update(self) -> int:
        """Environment steps that one update consumes."""
        return self.batch_size * self.num_minibatches * self.unroll_length

    @property
    def num_updates(self) -> int:
        """Updates that reach the budget; the last may pass it, as in Brax."""
        return -(-self.num_timesteps // self.env_steps_per_update)


def resolve(spec: PPOSpec, environment: EnvironmentInfo, device: Device) -> PPOSpec:
    """Every hyperparameter of a run on this device: the job's word, else the tuned one, else the default.

    Raises Rejected where the values do not go together (Brax asserts the same).
    """
    tuned = environment.tuned.get("ppo", {}).get(device, {})
    settings = PPOSpec.model_validate({**tuned, **spec.model_dump(exclude_unset=True)})
    unrolls = settings.batch_size * settings.num_minibatches
    if unrolls % settings.num_envs:
        raise Rejected(
            f"On a {device.upper()}, batch_size × num_minibatches = {settings.batch_size} × "
            f"{settings.num_minibatches} = {unrolls} is not a multiple of num_envs = {settings.num_envs}; "
            f"every environment must contribute the same number of unrolls to a batch.",
            [
                Problem(
                    f"/algorithm/{name}", f"{getattr(settings, name)} does not go together with the others."
                )
                for name in ("batch_size", "num_minibatches", "num_envs")
            ],
        )
    return settings


def check_resumption(wanted: PPOSpec, made_with: PPOSpec) -> None:
    """Raises Rejected where a run under `wanted` cannot go on from a checkpoint of one under `made_with`."""
    problems = [
        Problem(f"/algorithm/{name}", f"The checkpoint was made with {name} = {had}; this job has {has}.")
        for name in FIXED_BY_CHECKPOINT
        if (had := getattr(made_with, name)) != (has := getattr(wanted, name))
    ]
    if problems:
        raise Rejected(
            "The job cannot go on from that checkpoint. " + " ".join(problem.detail for problem in problems),
            problems,
        )
