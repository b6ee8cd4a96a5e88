"""The catalog's rows of robots: tasks of terms, for bodies that come with a package."""

from collections.abc import Mapping
from typing import Any, ClassVar, Literal, Self

from pydantic import Field, model_validator

from core.environments.info import EnvironmentInfo
from core.environments.mjcf.check import problems
from core.environments.mjcf.edit_options import HOME
from core.environments.robots.g1 import G1
from core.environments.robots.go1 import GO1
from core.environments.robots.robot import Robot
from core.environments.robots.tasks import get_up, imitate, rough
from core.environments.terms.actions import AnyAction, JointPositionAction
from core.environments.terms.commands import AnyCommand, GaitClock, VelocityCommand
from core.environments.terms.imitating import IMITATE, NEEDS_CLIPS
from core.environments.terms.inventory import inventory_of
from core.environments.terms.locomotion import Posture
from core.environments.terms.page import page
from core.environments.terms.rewards import ControlCost, JointLimits
from core.environments.terms.task import (
    Events,
    Feet,
    Observations,
    Reset,
    Rewards,
    TaskOptions,
    Terminations,
    varied,
)
from core.environments.terms.terminations import NotUpright, OutsideHeightRange
from core.environments.terms.vocabulary import AnyReward
from core.environments.terms.walking import OBSERVATION, ON_THE_FLAT, TorsoTerms, walking_reward
from core.physics.availability import Rule

ROBOTS = {robot.name: robot for robot in (G1, GO1)}

_SIDEWAYS, _LEGS = ".*_(hip_yaw|hip_roll)_joint", ".*_(hip|knee|ankle)_.*"
_LIMITS = [JointLimits(weight=2.0, share=0.9)]
_TASK = (
    "What the robot is to do, and so what the options are that a job leaves out. walk: by command, on the "
    "flat. rough: the same over terrain, pushed, with noise and delays."
)


class JoystickOptions(TaskOptions):
    """A robot that walks by command. of_task: the options that a task changes, by its name."""

    of_task: ClassVar[Mapping[str, Mapping[str, Any]]] = {}

    observation: Observations = Field(default=OBSERVATION, description="Terms to concatenate, in this order.")
    action: AnyAction = Field(default=JointPositionAction(), description="How an action becomes controls.")
    command: AnyCommand | None = Field(
        default=VelocityCommand(), description="What the policy is told to do."
    )
    events: Events = Field(default=[], description="What happens to the body within an episode.")
    reset: Reset = Reset(keyframe=HOME, position_noise=0.02, velocity_noise=0.2)
    iterations: int = Field(
        default=3, ge=1, le=100, description="Solver iterations on mjx, warp and compiled."
    )
    ls_iterations: int = Field(
        default=5, ge=1, le=100, description="Line-search iterations on mjx, warp and compiled."
    )

    @model_validator(mode="before")
    @classmethod
    def _fill_in(cls, given: Any) -> Any:
        task = given.get("task") if isinstance(given, Mapping) else None
        return {**cls.of_task[task], **given} if isinstance(task, str) and task in cls.of_task else given

    @model_validator(mode="after")
    def _has_clips(self) -> Self:
        if getattr(self, "task", None) == IMITATE and self.reference is None:
            raise ValueError(NEEDS_CLIPS)
        return self


def _reward_of_g1(swing: float, sideways: float, torso: TorsoTerms) -> list[AnyReward]:
    posture = Posture(weight=0.15, weights={_SIDEWAYS: sideways, _LEGS: 0.0, ".*": 1.0})
    return walking_reward(swing, posture, [ControlCost(weight=0.002)], _LIMITS, torso)


class G1Options(JoystickOptions):
    """Unitree's G1 that walks by command, on a floor."""

    of_task: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "rough": rough(_reward_of_g1(0.18, 0.1, TorsoTerms(tilt=0.4, climbing=0.1, turning=3.0)), lowest=0.3),
        IMITATE: imitate(1.0),
    }

    task: Literal["walk", "rough", "imitate"] = Field(
        default="walk", description=f"{_TASK} imitate: follows the clips of `reference`."
    )
    reward: Rewards = Field(
        default=_reward_of_g1(0.1, 0.5, ON_THE_FLAT),
        description="Terms to sum.",
    )
    termination: Terminations = Field(
        default=[NotUpright(least=0.5), OutsideHeightRange(range=(0.4, 2.0))],
        description="Terms, any of which ends the episode.",
    )
    feet: Feet = Field(
        default=list(G1.feet), description="The bodies that are feet, in the order of the gait."
    )
    gait: GaitClock | None = Field(
        default=GaitClock(), description="The clock of `gait_phase` and `swing_height`."
    )


def _reward_of_go1(swing: float, torso: TorsoTerms) -> list[AnyReward]:
    return walking_reward(swing, Posture(weight=0.1), of_joints=_LIMITS, torso=torso)


class Go1Options(JoystickOptions):
    """Unitree's Go1 that walks by command, on a floor."""

    of_task: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "rough": rough(_reward_of_go1(0.14, TorsoTerms(tilt=0.5, climbing=0.1)), lowest=0.03),
        "get_up": get_up(0.22, {".*_hip_joint": 0.9, ".*_thigh_joint": 2.0, ".*_calf_joint": 0.9}),
    }

    task: Literal["walk", "rough", "get_up"] = Field(
        default="walk", description=f"{_TASK} get_up: from any fall, and stand."
    )
    reward: Rewards = Field(default=_reward_of_go1(0.08, ON_THE_FLAT), description="Terms to sum.")
    termination: Terminations = Field(
        default=[NotUpright(least=0.5), OutsideHeightRange(range=(0.12, 1.0))],
        description="Terms, any of which ends the episode.",
    )
    feet: Feet = Field(
        default=list(GO1.feet), description="The bodies that are feet, in the order of the gait."
    )
    gait: GaitClock | None = Field(
        default=GaitClock(frequency=2.0, offsets=[0.0, 0.5, 0.5, 0.0]),
        description="The clock of `gait_phase` and `swing_height`.",
    )


def robot_page(robot: Robot, options: type[TaskOptions], description: str, **facts: Any) -> EnvironmentInfo:
    """The row of a robot. options: the class of its task. facts: further fields of the row."""
    return page(
        robot.name,
        "core.environments.robots.model:robot",
        lambda task: task,
        options,
        unit_of_action=None,
        description=description,
        check=lambda task: problems(task, inventory_of(robot.name)),
        package=robot.package,
        free_in_rollouts=("terrain",),
        curriculum_option="terrain/curriculum",
        vary=varied,
        on_a_cpu=(Rule("compiled", 1, "The robot's code is compiled for it alone."),),
        on_a_gpu=(
            Rule("compiled", 1, "The robot's code is compiled for it alone."),
            Rule("warp", 1, "Of the engines that tell what the terms read, it is the one for GPUs."),
        ),
        **facts,
    )


INFOS = (
    robot_page(G1, G1Options, "Unitree's humanoid G1, which walks by velocity command."),
    robot_page(GO1, Go1Options, "Unitree's quadruped Go1, which walks by velocity command."),
)
