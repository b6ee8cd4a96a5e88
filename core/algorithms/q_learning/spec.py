"""Tabular Q-learning's hyperparameters."""

from typing import ClassVar, Literal

from pydantic import Field

from core.algorithms.epsilon import EpsilonSchedule, Share
from core.algorithms.q_learning.options import MAX_ENVS, ActionSetOptions, StateDiscretizerOptions
from core.algorithms.spec import BaseSpec
from core.documents import Strict


class EpisodicEpsilonSchedule(EpsilonSchedule):
    """The share of choices that are made at random: from `start` to `end`, and then it stays."""

    decay_episodes: int | None = Field(
        default=None,
        ge=1,
        le=10**9,
        description="Episodes until `end`, in place of `decay_decisions`; constant within an episode.",
    )


class ReplaySpec(Strict):
    """Past transitions, to learn from again."""

    buffer_size: int = Field(default=10_000, ge=1, le=10**7, description="The newest so many are kept.")
    batch_size: int = Field(default=64, ge=1, le=10**6, description="Drawn after each decision.")


class AgentSpec(Strict):
    """One of several learners with a table of its own; what it leaves out is what the algorithm says."""

    seed: int | None = Field(
        default=None, ge=0, le=2**31 - 1, description="By default the job's, plus the agent's number."
    )
    learning_rate: Share | None = None
    discounting: Share | None = None
    epsilon_start: Share | None = None
    epsilon_end: Share | None = None


class QLearningSpec(BaseSpec):
    """Tabular Q-learning (Watkins & Dayan, 1992).

    A field that is not given takes the value tuned for the environment and the device, if there is one,
    and otherwise the default shown here; `GET /environments/{id}` shows the result.
    """

    why_no_seeds: ClassVar[str | None] = (
        "its `agents` learn side by side already, and each may have a `seed` of its own"
    )
    fixed_by_checkpoint: ClassVar[tuple[str, ...]] = (
        "num_agents",
        "env_steps_per_update",
        "decision_steps",
        "state_discretizer",
        "action_set",
        "replay_buffer_size",
    )

    kind: Literal["q_learning"] = "q_learning"
    state_discretizer: StateDiscretizerOptions | None = Field(
        default=None, description="How an observation becomes a row of the table."
    )
    action_set: ActionSetOptions | None = Field(
        default=None, description="How a column of the table becomes an action."
    )
    num_episodes: int = Field(
        default=100,
        ge=1,
        le=10**9,
        description="Episodes of each agent, rounded up to whole rounds: one in each of its environments.",
    )
    num_envs: int = Field(
        default=10, ge=1, le=MAX_ENVS, description="Environments of each agent, side by side."
    )
    decisions_per_episode: int = Field(
        default=50, ge=1, le=10**6, description="Decisions after which an episode is cut off."
    )
    decision_steps: int = Field(
        default=10,
        ge=1,
        le=10**4,
        description="Environment steps for which a choice is held; their rewards add up.",
    )
    learning_rate: float = Field(default=0.1, ge=0, le=1, description="0: nothing is learnt.")
    discounting: float = Field(default=0.99, ge=0, le=1, description="For each decision.")
    epsilon: EpisodicEpsilonSchedule = EpisodicEpsilonSchedule()
    world_updates: Literal["mean", "compound"] = Field(
        default="mean",
        description="How environments that visit the same cell at once change it. mean: one step towards the "
        "mean of their targets. compound: as far as one step of each, after another, would go: 1 - (1 - "
        "learning_rate)^n of the way.",
    )
    initial_table: Literal["constant", "random", "identity"] = Field(
        default="random",
        description="identity: 1 where row and column agree. With arms towards the target and leading arms "
        "that steers without any learning, which checks all the rest.",
    )
    initial_value: float = Field(
        default=0.0,
        ge=-1e6,
        le=1e6,
        description="Of every cell (constant), or of their middle (random); above what can be earned, the "
        "table is optimistic, and what is unknown is tried.",
    )
    initial_scale: float = Field(
        default=1e-3, gt=0, le=1e6, description="random: uniform up to so far from the middle."
    )
    replay: ReplaySpec | None = None
    agents: list[AgentSpec] = Field(
        default=[AgentSpec()], min_length=1, max_length=1024, description="Side by side in one program."
    )
    policy_agent: Literal["best", "first"] = Field(
        default="best", description="Whose table is the policy: best in the last evaluation, or the first's."
    )
    num_evals: int = Field(
        default=5, ge=0, le=10_000, description="Evaluations, spread evenly; the last is at the end."
    )
    num_eval_envs: int = Field(
        default=16, ge=1, le=2**16, description="Episodes of each agent in an evaluation, the same for all."
    )

    @property
    def num_agents(self) -> int:
        return len(self.agents)

    @property
    def replay_buffer_size(self) -> int:
        """0 where nothing is replayed."""
        return self.replay.buffer_size if self.replay else 0

    @property
    def num_parallel_envs(self) -> int:
        return self.num_agents * self.num_envs

    @property
    def num_updates(self) -> int:
        """Rounds: one episode in each environment."""
        return -(-self.num_episodes // self.num_envs)

    @property
    def env_steps_per_update(self) -> int:
        """Environment steps of one round, of all agents."""
        return self.num_parallel_envs * self.decisions_per_episode * self.decision_steps

    @property
    def budget(self) -> int:
        return self.num_updates * self.env_steps_per_update

    @property
    def num_decisions(self) -> int:
        """Decisions of one agent in the whole run."""
        return self.num_updates * self.num_envs * self.decisions_per_episode
