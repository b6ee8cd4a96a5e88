"""What can be set about a central pattern generator."""

from math import ceil, pi
from typing import Literal, Self

from pydantic import Field, model_validator

from core.documents import Strict

# The largest step of an integrator, times the rate of what decays: beyond, errors grow.
_STABLE = {"euler": 2.0, "rk4": 2.785}
# An oscillator of a star is coupled to three others; by Gershgorin's circles no phase decays faster than
# twice what pulls at it.
_NEIGHBOURS = 3


class GaitOptions(Strict):
    """How the star rows where only the leading arm, or each arm's role, is chosen."""

    frequency_hz: float = Field(default=1.0, ge=0, le=10, description="Strokes per second.")
    sweep: float = Field(
        default=0.9, ge=0, le=1, description="A rower's amplitude in the plane, of its range."
    )
    stroke: float = Field(
        default=0.9, ge=0, le=1, description="A rower's amplitude out of the plane, of its range."
    )
    lift: float = Field(
        default=0.75, ge=-1, le=1, description="How far the leading arm is held up, of its range."
    )
    lag: float = Field(
        default=0.44, ge=0, le=0.5, description="How much of a period the stroke is behind the sweep."
    )


class CPGOptions(Strict):
    """Amplitude-controlled phase oscillators, two for each arm. Amplitudes and offsets are parts of what
    the actuators can do: 1 is the end of their range."""

    integrator: Literal["rk4", "euler"] = Field(default="rk4", description="Of order 4, or of order 1.")
    num_steps: int = Field(default=2, ge=1, le=100, description="Integration steps for each control step.")
    coupling_weight: float = Field(
        default=20.0,
        ge=0,
        le=1000,
        description="How strongly phases follow, per second and unit of amplitude.",
    )
    amplitude_gain: float = Field(
        default=20.0, gt=0, le=1000, description="Twice the rate at which amplitudes settle, 1/s."
    )
    offset_gain: float = Field(default=20.0, gt=0, le=1000, description="The same of offsets.")
    initial_phase_spread: float = Field(
        default=0.01, ge=0, le=pi, description="First phases are uniform in ± this, in rad."
    )
    max_frequency_hz: float = Field(
        default=2.0, gt=0, le=10, description="The action's 1; its -1 is standstill."
    )
    max_amplitude: float = Field(default=1.0, gt=0, le=1, description="The action's 1; its -1 is none.")
    max_offset: float = Field(default=1.0, gt=0, le=1, description="The action's 1; its -1 is minus this.")
    gait: GaitOptions = GaitOptions()

    @property
    def max_frequency(self) -> float:
        """rad/s."""
        return 2 * pi * self.max_frequency_hz

    def check_steps(self, dt: float) -> None:
        """Raises ValueError, with what to do, where integration steps of dt / num_steps seconds diverge."""
        phases = 2 * _NEIGHBOURS * self.coupling_weight * self.max_amplitude
        rate = max(self.amplitude_gain / 2, self.offset_gain / 2, phases)
        needed = ceil(dt * rate / _STABLE[self.integrator])
        if needed > self.num_steps:
            raise ValueError(
                f"the CPG changes as fast as {rate:g}/s, and {self.integrator} over a control step of {dt:g} "
                f"s would diverge: num_steps must be {needed} at least, or gains and coupling_weight smaller"
            )

    @model_validator(mode="after")
    def _reaches_its_gait(self) -> Self:
        gait = self.gait
        for name, value, bound in (
            ("frequency_hz", gait.frequency_hz, "max_frequency_hz"),
            ("sweep", gait.sweep, "max_amplitude"),
            ("stroke", gait.stroke, "max_amplitude"),
            ("lift", abs(gait.lift), "max_offset"),
        ):
            if value > getattr(self, bound):
                raise ValueError(
                    f"gait.{name} = {value:g} is more than {bound} = {getattr(self, bound):g}, "
                    "so that no action could ask for it"
                )
        return self
