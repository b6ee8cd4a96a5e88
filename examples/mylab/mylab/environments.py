"""The terms and bodies of this lab. Gaitway imports this module wherever it runs."""

from typing import Literal

from gaitway.environments import Array, Body, CostTerm, ModelIndex, Step


class UnevenPower(CostTerm):
    """max |τ q̇| − mean |τ q̇|: how much more the busiest joint works than the average one, in W."""

    kind: Literal["mylab/uneven_power"] = "mylab/uneven_power"

    def measure(self, step: Step, model: ModelIndex) -> Array:
        joints = model.joint_velocities(None)
        power = abs(step.after.derived["qfrc_actuator"][joints] * step.after.qvel[joints])
        return step.xp.max(power) - step.xp.mean(power)


MONOPOD = Body(
    "monopod",
    file="monopod.xml",
    description="A leg on a rail that hops forward.",
    options={
        "edits": {"pose": {"joints": {"hip": 0.4, "knee": -0.8}}},
        "reward": [
            {"kind": "forward_velocity"},
            {"kind": "alive", "weight": 0.5},
            {"kind": "mylab/uneven_power", "weight": 0.001},
        ],
        "termination": [{"kind": "height_range", "range": [0.25, 2.0]}],
    },
)
