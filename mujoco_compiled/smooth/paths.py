"""What forces act along: lengths that change with the state.

Source: MuJoCo's documentation, Computation, "Actuation model", "Transmission".
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass

from mujoco_compiled.program.arithmetic import Number, Vector, total

# By the address of a position or of a velocity.
Coefficients = dict[int, Number]


@dataclass(frozen=True)
class Stretch:
    """A length in m or rad, and how it changes with each degree of freedom: MuJoCo's `ten_length` and a row
    of `ten_J`."""

    length: Number
    moment: Coefficients

    def rate(self, qvel: Vector) -> Number:
        """The length's, in m/s or rad/s."""
        return weighted(self.moment, qvel)


# Along what a force acts, and how it changes with the rate.
Slope = tuple[Stretch, Number]


@dataclass(frozen=True)
class Linear:
    """A sum of positions, each times a coefficient.

    of_positions: by address in qpos; empty where there is no length. moment: the same by degree of freedom.
    """

    of_positions: Coefficients
    moment: Coefficients

    @property
    def dofs(self) -> Collection[int]:
        """The degrees of freedom that change the length."""
        return self.moment


@dataclass(frozen=True)
class OfTendon:
    """The length of a spatial tendon, times `gear`. dofs: see `Linear`."""

    tendon: int
    gear: Number
    dofs: tuple[int, ...]


Path = Linear | OfTendon


def stretch(path: Path, qpos: Vector, tendons: Sequence[Stretch]) -> Stretch:
    """The path's length in a state. qpos: [nq]. tendons: the stretches of the model's tendons."""
    if isinstance(path, Linear):
        return Stretch(weighted(path.of_positions, qpos), path.moment)
    of_tendon = tendons[path.tendon]
    moment = {dof: path.gear * coefficient for dof, coefficient in of_tendon.moment.items()}
    return Stretch(path.gear * of_tendon.length, moment)


def weighted(coefficients: Coefficients, values: Vector) -> Number:
    """The values at the coefficients' addresses, each times its coefficient: a length or its rate."""
    return total(coefficient * values[place] for place, coefficient in coefficients.items())
