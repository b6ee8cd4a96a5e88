"""Unitree's Go1, a quadruped with 12 joints; no numerical code.

Source: mjlab 1.6.0 (Apache-2.0) for the file (BSD-3-Clause, of Unitree) and for the motors' numbers, which it
has from Unitree's description of the robot: `asset_zoo/robots/unitree_go1/go1_constants.py`.
"""

from core.environments.mjcf.edit_options import ModelEdits, Pose
from core.environments.robots.motors import Motor, geared
from core.environments.robots.robot import Robot

_ROTOR, _GEAR = 1.11842e-4, 6.0
# A belt gears the knee down once more.
_KNEE_BELT = 1.5
_HIP = Motor(geared(_ROTOR, _GEAR), 23.7, 30.1)
_KNEE = Motor(geared(_ROTOR, _GEAR * _KNEE_BELT), 35.55, 20.06)

GO1 = Robot(
    name="go1",
    package="mjlab",
    file="asset_zoo/robots/unitree_go1/xmls/go1.xml",
    timestep=0.005,
    feet=("FR_calf", "FL_calf", "RR_calf", "RL_calf"),
    edits=ModelEdits(
        floor=True,
        feet=[".*_calf"],
        # A foot is a ball at the end of the calf, which has other geoms, too.
        collide=[".*_foot_collision"],
        friction=0.6,
        servos=[
            _HIP.servo([".*_hip_joint", ".*_thigh_joint"]),
            _KNEE.servo([".*_calf_joint"]),
        ],
        pose=Pose(
            joints={
                ".*R_hip_joint": 0.1,
                ".*L_hip_joint": -0.1,
                ".*_thigh_joint": 0.9,
                ".*_calf_joint": -1.8,
            }
        ),
    ),
)
