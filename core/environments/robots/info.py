"""The catalog's rows of robots: tasks of terms, for bodies that come with a package."""

from pydantic import Field

from core.environments.info import EnvironmentInfo
from core.environments.mjcf.check import problems
from core.environments.mjcf.edit_options import HOME
from core.environments.robots.g1 import G1
from core.environments.robots.go1 import GO1
from core.environments.robots.robot import Robot
from core.environments.terms.actions import AnyAction, JointPositionAction
from core.environments.terms.commands import AnyCommand, GaitClock, VelocityCommand
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
from core.environments.terms.walking import OBSERVATION, walking_reward
from core.physics.availability import Rule

ROBOTS = {robot.name: robot for robot in (G1, GO1)}

_SIDEWAYS, _LEGS = ".*_(hip_yaw|hip_roll)_joint", ".*_(hip|knee|ankle)_.*"


_LIMITS = [JointLimits(weight=2.0, share=0.9)]


class JoystickOptions(TaskOptions):
    """A robot that walks by command."""

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


class G1Options(JoystickOptions):
    """Unitree's G1 that walks by command, on a floor."""

    reward: Rewards = Field(
        default=walking_reward(
            0.1,
            Posture(weight=0.15, weights={_SIDEWAYS: 0.5, _LEGS: 0.0, ".*": 1.0}),
            [ControlCost(weight=0.002)],
            _LIMITS,
        ),
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


class Go1Options(JoystickOptions):
    """Unitree's Go1 that walks by command, on a floor."""

    reward: Rewards = Field(
        default=walking_reward(0.08, Posture(weight=0.1), of_joints=_LIMITS),
        description="Terms to sum.",
    )
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


def robot_page(robot: Robot, options: type[TaskOptions], description: str) -> EnvironmentInfo:
    """The row of a robot. options: the class of its task."""
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
    )


INFOS = (
    robot_page(G1, G1Options, "Unitree's humanoid G1, which walks by velocity command."),
    robot_page(GO1, Go1Options, "Unitree's quadruped Go1, which walks by velocity command."),
)
