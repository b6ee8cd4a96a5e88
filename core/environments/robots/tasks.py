"""The catalog's robots' tasks besides walking on the flat: what a job's other options then are.

The noise and the delays are about as large as those of mjlab's, Isaac Lab's and Playground's quadrupeds. What
the weights reach is in docs/environments/robots.md, and what others did not in docs/what_did_not_help.md.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from core.environments.mjcf.edit_options import HOME
from core.environments.terms.actions import JointPositionAction
from core.environments.terms.commands import Push, VelocityCommand
from core.environments.terms.imitating import OBSERVATION as OF_A_REFERENCE
from core.environments.terms.imitating import imitating_reward
from core.environments.terms.locomotion import (
    BaseAngularVelocity,
    BaseHeight,
    BaseLinearVelocity,
    GaitPhase,
    JointPositions,
    JointVelocities,
    JointVelocityCost,
    Posture,
    ProjectedGravity,
)
from core.environments.terms.observations import PreviousAction
from core.environments.terms.rewards import ActionRate, Healthy, JointLimits, Upright
from core.environments.terms.starts import Fallen
from core.environments.terms.task import Reset
from core.environments.terms.terminations import (
    AnyTermination,
    FarFromReference,
    NotUpright,
    OutsideHeightRange,
)
from core.environments.terms.terrain import HeightScan, Terrain
from core.environments.terms.tracking import Command
from core.environments.terms.vocabulary import AnyReward
from core.environments.terms.walking import OBSERVATION

# s: a sensor's reading, and an action, are late by as much.
_LATE = (0.0, 0.02)


def rough(reward: Sequence[AnyReward], lowest: float) -> Mapping[str, Any]:
    """Walks by command over terrain, pushed, through noise and delays; it sees the ground about it.

    lowest: below this height of the root above the ground an episode ends, in m. On stairs the ground rises
    by a step while the root is above its edge.
    """
    return {
        "terrain": Terrain(),
        "observation": [
            BaseLinearVelocity(noise=0.1),
            BaseAngularVelocity(scale=0.25, noise=0.2),
            ProjectedGravity(noise=0.05),
            Command(),
            JointPositions(noise=0.03, delay=_LATE),
            JointVelocities(scale=0.05, noise=1.0, delay=_LATE),
            PreviousAction(),
            GaitPhase(),
            HeightScan(noise=0.02),
        ],
        "critic": [*OBSERVATION, HeightScan()],
        "action": JointPositionAction(delay=_LATE),
        # Long enough to leave the terrain on one command, which takes an environment up a level.
        "command": VelocityCommand(every_s=10.0),
        "events": [Push(every_s=6.0, speed=0.5, turn=0.3)],
        "termination": [NotUpright(least=0.2), OutsideHeightRange(range=(lowest, 2.0))],
        "reward": list(reward),
    }


def get_up(standing: float, scale: Mapping[str, float]) -> Mapping[str, Any]:
    """Gets up from any fall, and stands. standing: from this height of the root on it does, in m.

    scale: of an action, by joint, in rad. Legs have to reach around the trunk: under the scale of walking,
    62 % of the starts ended on their feet.
    """
    stands: list[AnyTermination] = [NotUpright(least=0.8), OutsideHeightRange(range=(standing, None))]
    return {
        "command": None,
        "gait": None,
        "action": JointPositionAction(scale=dict(scale)),
        "reset": Reset(keyframe=HOME, position_noise=0.01, velocity_noise=0.01, fallen=Fallen()),
        "termination": [],
        "observation": [
            BaseAngularVelocity(scale=0.25),
            ProjectedGravity(),
            JointPositions(),
            JointVelocities(scale=0.05),
            PreviousAction(),
        ],
        "reward": [
            Upright(),
            Healthy(weight=2.0, unless=stands),
            BaseHeight(weight=5.0),
            Posture(weight=0.03),
            JointVelocityCost(weight=0.0002),
            ActionRate(weight=0.01),
            JointLimits(weight=1.0, share=0.95),
        ],
    }


def imitate(scale: float) -> Mapping[str, Any]:
    """Follows a reference. scale: of an action, in rad about the reference's joints.

    Servos give way under load, so targets have to lie well beside the pose: of a G1 that carries its arms
    before it, 14 % of the starts came to the clip's end under a scale of 0.3, 92 % under 0.5, all under 1.
    """
    return {
        "command": None,
        "gait": None,
        "action": JointPositionAction(about="reference", scale=scale),
        "reset": Reset(keyframe=HOME, position_noise=0.02, velocity_noise=0.2),
        "termination": [FarFromReference()],
        "observation": OF_A_REFERENCE,
        "reward": [*imitating_reward(), JointLimits(weight=2.0, share=0.95)],
    }
