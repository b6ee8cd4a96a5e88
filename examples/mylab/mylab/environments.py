"""The terms and bodies of this lab. Gaitway imports this module wherever it runs."""

from typing import Literal

from pydantic import Field

from gaitway.environments import PATTERNS, Array, Body, CostTerm, EventTerm, ModelIndex, Patterns, Step


class UnevenPower(CostTerm):
    """max |τ q̇| − mean |τ q̇|: how much more the busiest joint works than the average one, in W."""

    kind: Literal["mylab/uneven_power"] = "mylab/uneven_power"

    def measure(self, step: Step, model: ModelIndex) -> Array:
        joints = model.joint_velocities(None)
        power = abs(step.after.derived["qfrc_actuator"][joints] * step.after.qvel[joints])
        return step.xp.max(power) - step.xp.mean(power)


class Kick(EventTerm):
    """The velocities of some joints change at once, all alike."""

    num_random = 1

    kind: Literal["mylab/kick"] = "mylab/kick"
    joints: Patterns = Field(description=f"Those that are kicked. {PATTERNS}")
    speed: float = Field(default=1.0, ge=0, le=20, description="Uniform in ± this, in rad/s.")

    def drawn(self, uniform: Array, step: Step, model: ModelIndex) -> Array:
        hit = model.joint_velocities(self.joints)
        is_hit = [float(place in hit) for place in range(model.model.nv)]
        return self.speed * (2.0 * uniform[0] - 1.0) * step.array(is_hit)


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
        "events": [{"kind": "mylab/kick", "joints": ["hip", "knee"], "every_s": 2.0}],
        "termination": [{"kind": "height_range", "range": [0.25, 2.0]}],
    },
    tuned={"ppo": {"cpu": {"num_timesteps": 1_000_000}}},
)
