"""Unitree's G1, a humanoid with 29 joints; no numerical code.

Source: mjlab 1.6.0 (Apache-2.0) for the file (BSD-3-Clause, of Unitree) and for the motors' numbers, which it
has from Unitree: `asset_zoo/robots/unitree_g1/g1_constants.py`. The servos' frequency and damping ratio, and
the scale of actions, are those of Liao et al., BeyondMimic (2025).
"""

from core.environments.mjcf.edit_options import ModelEdits, Pose
from core.environments.robots.motors import Motor, planetary
from core.environments.robots.robot import Robot

_5020 = Motor(planetary((0.139e-4, 0.017e-4, 0.169e-4), (1 + 46 / 18, 1 + 56 / 16)), 25.0, 37.0)
_7520_14 = Motor(planetary((0.489e-4, 0.098e-4, 0.533e-4), (4.5, 1 + 48 / 22)), 88.0, 32.0)
_7520_22 = Motor(planetary((0.489e-4, 0.109e-4, 0.738e-4), (4.5, 5.0)), 139.0, 20.0)
_4010 = Motor(planetary((0.068e-4, 0.0, 0.0), (5.0, 5.0)), 5.0, 22.0)

G1 = Robot(
    name="g1",
    package="mjlab",
    file="asset_zoo/robots/unitree_g1/xmls/g1.xml",
    timestep=0.005,
    feet=("left_ankle_roll_link", "right_ankle_roll_link"),
    edits=ModelEdits(
        floor=True,
        feet=[".*_ankle_roll_link"],
        # Of a foot's seven capsules the two that are long and lie outside. The others reach 10 mm beyond them
        # at most, and cost 41 % of the rate on a CPU: 49,000 steps/s with all, 84,000 with two.
        collide=[".*_foot[26]_collision"],
        friction=0.6,
        servos=[
            _5020.servo([".*_elbow_joint", ".*_shoulder_.*_joint", ".*_wrist_roll_joint"]),
            _7520_14.servo([".*_hip_pitch_joint", ".*_hip_yaw_joint", "waist_yaw_joint"]),
            _7520_22.servo([".*_hip_roll_joint", ".*_knee_joint"]),
            _4010.servo([".*_wrist_pitch_joint", ".*_wrist_yaw_joint"]),
            # Two motors and their rods move both axes of an ankle, and of the waist.
            _5020.servo(["waist_pitch_joint", "waist_roll_joint", ".*_ankle_.*_joint"], number=2),
        ],
        pose=Pose(
            joints={
                ".*_hip_pitch_joint": -0.312,
                ".*_knee_joint": 0.669,
                ".*_ankle_pitch_joint": -0.363,
                ".*_elbow_joint": 0.6,
                ".*_shoulder_pitch_joint": 0.2,
                "left_shoulder_roll_joint": 0.2,
                "right_shoulder_roll_joint": -0.2,
            }
        ),
    ),
)
