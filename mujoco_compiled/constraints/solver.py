"""The acceleration that minimises Gauss' principle with soft constraints, by Newton's method.

Source: MuJoCo's documentation, Computation, "Solvers"; Todorov (2014).
"""

from dataclasses import dataclass, fields, replace

from mujoco_compiled.constraints.rows import (
    ConstraintRows,
    cost,
    cost_decrease,
    curvature,
    forces,
    pulled_back,
    residual,
    slope,
    times,
)
from mujoco_compiled.program.arithmetic import (
    Number,
    Vector,
    absolute,
    add,
    dot,
    maximum,
    select,
    sqrt,
    total,
)
from mujoco_compiled.program.flow import repeat
from mujoco_compiled.smooth.inertia import Inertia


@dataclass(frozen=True)
class Settings:
    """MuJoCo's iterations, ls_iterations, tolerance and ls_tolerance. mean_inertia: the model's, in kg m²."""

    iterations: int
    line_search_iterations: int
    tolerance: float
    line_search_tolerance: float
    mean_inertia: float


@dataclass(frozen=True)
class SolverProblem:
    """force: all but the constraints', [nv]; free: the acceleration under it, M⁻¹ force."""

    inertia: Inertia
    force: Vector
    free: Vector
    rows: ConstraintRows


@dataclass(frozen=True)
class _Guess:
    """acceleration: [nv]; inertial: M times it; residual: along the rows' directions."""

    acceleration: Vector
    inertial: Vector
    residual: Vector


def acceleration(problem: SolverProblem, warm: Vector, settings: Settings) -> Vector:
    """[nv]: MuJoCo's `qacc`. It begins at `warm` [nv] or at the free acceleration, whichever costs less."""
    begun, free = _guess(problem, warm), _guess(problem, problem.free)
    is_better = _cost(problem, free) < _cost(problem, begun)
    start = _Guess(
        *(
            [
                select(is_better, x, y)
                for x, y in zip(getattr(free, one.name), getattr(begun, one.name), strict=True)
            ]
            for one in fields(_Guess)
        )
    )
    if problem.rows.slots:
        problem.rows.slots.begin(start.acceleration)
    scale = 1.0 / (settings.mean_inertia * max(1, len(problem.force)))

    def iterate(carried: list[Number]) -> tuple[list[Number], Number]:
        guess, improves = _unpacked(carried[1:], start), carried[0]
        direction, gradient = _newton_direction(problem, guess)
        moved, gain = _line_search(problem, guess, direction, settings, scale, improves)
        steepness = sqrt(dot(gradient, gradient))
        goes_on = (gain * scale > settings.tolerance) & (steepness * scale > settings.tolerance)
        return [select(goes_on, 1.0, 0.0), *_packed(moved)], goes_on

    return _unpacked(repeat(settings.iterations, iterate, [1.0, *_packed(start)])[1:], start).acceleration


def _newton_direction(problem: SolverProblem, guess: _Guess) -> tuple[Vector, Vector]:
    """-H⁻¹ g, and the gradient g: [nv] each."""
    pull = pulled_back(problem.rows, forces(problem.rows, guess.residual), len(problem.force))
    problem.inertia.begin()
    if problem.rows.slots:
        pull = add(pull, problem.rows.slots.newton())
    gradient = [x - y - z for x, y, z in zip(guess.inertial, problem.force, pull, strict=True)]
    step = problem.inertia.solve(curvature(problem.rows, guess.residual), gradient)
    return [-x for x in step], gradient


def _line_search(
    problem: SolverProblem,
    guess: _Guess,
    direction: Vector,
    settings: Settings,
    scale: float,
    improves: Number,
) -> tuple[_Guess, Number]:
    """The best guess along the direction, and by how much its cost is less.

    improves: 1, or 0 where an environment has its acceleration and only stays while others run.

    The cost along a line is convex, and quadratic between the points where a row begins or ends to push. So
    Newton's method finds where the slope is 0, kept between places where the cost falls and where it rises.
    """
    inertial = problem.inertia.multiply(direction)
    rates = times(problem.rows, direction)
    linear = total(x * (y - z) for x, y, z in zip(direction, guess.inertial, problem.force, strict=True))
    quadratic = 0.5 * dot(direction, inertial)
    bend, slots = slope(problem.rows, guess.residual, rates), problem.rows.slots
    if slots:
        slots.set_rates(direction)

    def at(step: Number) -> tuple[Number, Number]:
        """The cost's first and second derivative."""
        first, second = bend(step)
        if slots:
            first, second = add([first, second], [*slots.slope(step)])
        return linear + 2.0 * quadratic * step + first, 2.0 * quadratic + second

    accuracy = settings.tolerance * settings.line_search_tolerance * sqrt(dot(direction, direction)) / scale
    at_start, curvature_there = at(0.0)

    def narrow(carried: list[Number]) -> tuple[list[Number], Number]:
        step, low, high = carried
        first, second = at(step)
        low, high = select(first < 0.0, step, low), select(first < 0.0, high, step)
        guessed = step - first / maximum(second, _TINY)
        # Not at an end: between rows that begin and end to push, guesses can go from one end to the other.
        inside = (low < guessed) & (guessed < high)
        bounded = select(high < _FAR, 0.5 * (low + high), 2.0 * step)
        # Rounding moves a guess at the end: one that moves by a smaller part than this is as good as it gets.
        moves = settings.tolerance * step < absolute(guessed - step)
        goes_on = moves & (accuracy < improves * absolute(first))
        return [select(goes_on, select(inside, guessed, bounded), step), low, high], goes_on

    step = repeat(
        settings.line_search_iterations, narrow, [-at_start / maximum(curvature_there, _TINY), 0.0, _FAR]
    )[0]
    moved = _Guess(
        [x + step * y for x, y in zip(guess.acceleration, direction, strict=True)],
        [x + step * y for x, y in zip(guess.inertial, inertial, strict=True)],
        [x + step * y for x, y in zip(guess.residual, rates, strict=True)],
    )
    fallen = cost_decrease(problem.rows, guess.residual, moved.residual)
    if slots:
        fallen = fallen + slots.advance(step)
    gain = fallen - step * (linear + step * quadratic)
    # A search that is cut off may end where the cost is higher: then the old guess is the best and the last.
    is_worse = gain < -_ROUNDING * absolute(fallen)
    pairs = zip(guess.acceleration, moved.acceleration, strict=True)
    return replace(moved, acceleration=[select(is_worse, x, y) for x, y in pairs]), gain


# Farther than any step: an end of a line that is not known yet. Below any curvature: for no direction.
_FAR, _TINY = 1e30, 1e-30
# A cost that rises by a smaller part of the rows' share may rise by rounding alone.
_ROUNDING = 1e-4


def _guess(problem: SolverProblem, acceleration: Vector) -> _Guess:
    inertial = problem.inertia.multiply(acceleration)
    return _Guess(acceleration, inertial, residual(problem.rows, acceleration))


def _cost(problem: SolverProblem, guess: _Guess) -> Number:
    apart = total(
        (x - y) * (a - b)
        for x, y, a, b in zip(guess.inertial, problem.force, guess.acceleration, problem.free, strict=True)
    )
    of_contacts = problem.rows.slots.cost(guess.acceleration) if problem.rows.slots else 0.0
    return 0.5 * apart + cost(problem.rows, guess.residual) + of_contacts


def _packed(guess: _Guess) -> list[Number]:
    return [*guess.acceleration, *guess.inertial, *guess.residual]


def _unpacked(values: list[Number], like: _Guess) -> _Guess:
    size = len(like.acceleration)
    return replace(
        like, acceleration=values[:size], inertial=values[size : 2 * size], residual=values[2 * size :]
    )
