"""The base of environments that wrap another one."""

from dataclasses import dataclass

import mujoco

from core.environments.discretization import Discretization
from core.environments.environment import Environment, ObservationSize


@dataclass(frozen=True)
class Wrapped:
    """Model, times, sizes and finite views are those of the environment inside."""

    environment: Environment

    @property
    def model(self) -> mujoco.MjModel:
        return self.environment.model

    @property
    def dt(self) -> float:
        return self.environment.dt

    @property
    def episode_length(self) -> int:
        return self.environment.episode_length

    @property
    def observation_size(self) -> ObservationSize:
        return self.environment.observation_size

    @property
    def action_size(self) -> int:
        return self.environment.action_size

    @property
    def tracked_body(self) -> int:
        return self.environment.tracked_body

    @property
    def discretization(self) -> Discretization:
        return self.environment.discretization
