"""Muscles: how hard they pull by their length and its rate, and how they follow their controls.

Source: MuJoCo's documentation, Modeling, "Muscle actuators"; Millard et al. (2013) for the dynamics.
"""

from dataclasses import dataclass

import mujoco

from mujoco_compiled.fields import Fields
from mujoco_compiled.program.arithmetic import Number, clip, maximum, select

_SMALLEST = float(mujoco.mjMINVAL)


@dataclass(frozen=True)
class Muscle:
    """Lengths are in units of that at which it pulls hardest: shift + factor · the path's length.

    peak: the most that it pulls at a rate of 0, in N or N m. least, most: lengths between which its control
    makes it pull. speed: times a rate of the path, in units of the fastest shortening. passive, eccentric: in
    units of the peak, how much it pulls uncontrolled when as long as `most`, and while it is lengthened.
    """

    shift: Number
    factor: Number
    peak: Number
    least: Number
    most: Number
    speed: Number
    passive: Number
    eccentric: Number


@dataclass(frozen=True)
class MuscleDynamics:
    """rise, decay: time constants in s. width: of the controls between which one goes over into the other."""

    rise: Number
    decay: Number
    width: Number


def read_muscle(fields: Fields, number: int, parameters: str) -> Muscle:
    """An actuator's. parameters: `actuator_gainprm` or `actuator_biasprm`."""
    low, high, force, scale, least, most, fastest, passive, eccentric = fields.row(parameters, number)[:9]
    shortest, longest = (float(x) for x in fields.model.actuator_lengthrange[number])
    optimal = (longest - shortest) / maximum(high - low, _SMALLEST)
    of_weight = scale / maximum(fields.number("actuator_acc0", number), _SMALLEST)
    factor = 1.0 / maximum(optimal, _SMALLEST)
    return Muscle(
        shift=low - factor * shortest,
        factor=factor,
        peak=select(force < 0.0, of_weight, force),
        least=least,
        most=most,
        speed=1.0 / maximum(optimal * fastest, _SMALLEST),
        passive=passive,
        eccentric=eccentric,
    )


def active_force(muscle: Muscle, length: Number, rate: Number) -> tuple[Number, Number]:
    """The force at full activation, below 0 as it pulls, and how it changes with the rate."""
    at = muscle.shift + muscle.factor * length
    velocity = muscle.speed * rate
    # How far inside of the lengths at which it pulls: 2 at the optimal one.
    ahead = (at - muscle.least) * (2.0 / maximum(1.0 - muscle.least, _SMALLEST))
    left = (muscle.most - at) * (2.0 / maximum(muscle.most - 1.0, _SMALLEST))
    inside = clip(select(at < 1.0, ahead, left), 0.0, 2.0)
    beyond = 2.0 - inside
    by_length = select(inside < 1.0, 0.5 * (inside * inside), 1.0 - 0.5 * (beyond * beyond))
    # Shortening costs force, and lengthening adds some, up to a bound.
    span = muscle.eccentric - 1.0
    bend = 1.0 / maximum(span, _SMALLEST)
    slower, lengthened = maximum(velocity + 1.0, 0.0), maximum(span - velocity, 0.0)
    is_lengthened = velocity > 0.0
    by_rate = select(is_lengthened, muscle.eccentric - bend * (lengthened * lengthened), slower * slower)
    slope = select(is_lengthened, (2.0 * bend) * lengthened, 2.0 * slower)
    full = -(muscle.peak * by_length)
    return full * by_rate, (full * muscle.speed) * slope


def passive_force(muscle: Muscle, length: Number) -> Number:
    """Of the stretched muscle alone: a parabola from the optimal length on, and then a straight line."""
    at = muscle.shift + muscle.factor * length
    stretched = maximum((at - 1.0) * (2.0 / maximum(muscle.most - 1.0, _SMALLEST)), 0.0)
    curve = select(stretched < 1.0, 0.5 * (stretched * stretched), stretched - 0.5)
    return -(muscle.peak * muscle.passive) * curve


def activation_rate(dynamics: MuscleDynamics, activation: Number, control: Number) -> Number:
    """Of the activation, per second."""
    missing = clip(control, 0.0, 1.0) - activation
    easing = 0.5 + 1.5 * clip(activation, 0.0, 1.0)
    rise, decay = dynamics.rise * easing, dynamics.decay / easing
    share = clip(missing / maximum(dynamics.width, _SMALLEST) + 0.5, 0.0, 1.0)
    smooth = ((6.0 * share - 15.0) * share + 10.0) * share * share * share
    smooth = select(dynamics.width < _SMALLEST, select(missing > 0.0, 1.0, 0.0), smooth)
    return missing / maximum(decay + (rise - decay) * smooth, _SMALLEST)
