"""The options of a central pattern generator."""

from math import ceil, pi
from typing import Literal, Self

from pydantic import Field, model_validator

from core.documents import Strict

# The largest stable step of an integrator times the decay rate: beyond it, errors grow.
_STABLE = {"euler": 2.0, "rk4": 2.785}
# An oscillator of a star is coupled to three others; by Gershgorin's circles no phase decays faster than
# twice the sum of its couplings.
_NEIGHBOURS = 3


class GaitOptions(Strict):
    """How the star rows when an action chooses only the leading arm, or each arm's role."""

    frequency_hz: float = Field(default=1.0, ge=0, le=10, description="Strokes per second.")
    sweep: float = Field(
        default=0.9, ge=0, le=1, description="A rowing arm's in-plane amplitude, as a part of its range."
    )
    stroke: float = Field(
        default=0.9, ge=0, le=1, description="A rowing arm's out-of-plane amplitude, as a part of its range."
    )
    lift: float = Field(
        default=0.75, ge=-1, le=1, description="How far the leading arm is held up, as a part of its range."
    )
    lag: float = Field(
        default=0.44, ge=0, le=0.5, description="Lag of the stroke behind the sweep, as a part of a period."
    )


class CPGOptions(Strict):
    """Amplitude-controlled phase oscillators, two per arm. Amplitudes and offsets are in units of the
    actuators' range: 1 is its end."""

    integrator: Literal["rk4", "euler"] = Field(
        default="rk4", description="Runge-Kutta of order 4, or Euler of order 1."
    )
    num_steps: int = Field(default=2, ge=1, le=100, description="Integration steps per control step.")
    coupling_weight: float = Field(
        default=20.0,
        ge=0,
        le=1000,
        description="How strongly phases follow, per second and unit of amplitude.",
    )
    amplitude_gain: float = Field(
        default=20.0, gt=0, le=1000, description="Twice the rate at which amplitudes settle, in 1/s."
    )
    offset_gain: float = Field(
        default=20.0, gt=0, le=1000, description="Twice the rate at which offsets settle, in 1/s."
    )
    initial_phase_spread: float = Field(
        default=0.01, ge=0, le=pi, description="Initial phases are uniform in ± this, in rad."
    )
    max_frequency_hz: float = Field(
        default=2.0, gt=0, le=10, description="Frequency at action 1; action -1 is standstill."
    )
    max_amplitude: float = Field(
        default=1.0, gt=0, le=1, description="Amplitude at action 1; action -1 is 0."
    )
    max_offset: float = Field(
        default=1.0, gt=0, le=1, description="Offset at action 1; action -1 is its negative."
    )
    gait: GaitOptions = GaitOptions()

    @property
    def max_frequency(self) -> float:
        """rad/s."""
        return 2 * pi * self.max_frequency_hz

    def check_steps(self, dt: float) -> None:
        """Raises ValueError, with a remedy, if integration steps of dt / num_steps seconds diverge."""
        phases = 2 * _NEIGHBOURS * self.coupling_weight * self.max_amplitude
        rate = max(self.amplitude_gain / 2, self.offset_gain / 2, phases)
        needed = ceil(dt * rate / _STABLE[self.integrator])
        if needed > self.num_steps:
            raise ValueError(
                f"the CPG changes as fast as {rate:g}/s, and {self.integrator} over a control step of {dt:g} "
                f"s would diverge: raise num_steps to at least {needed}, or lower gains or coupling_weight"
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
                    f"gait.{name} = {value:g} is above {bound} = {getattr(self, bound):g}, so no action can "
                    "reach it"
                )
        return self
