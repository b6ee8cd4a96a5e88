"""Motions whose outcome can be written down: in double precision by the program, and in machine code.

MuJoCo's Euler computes the velocity first: v' = v + h a, then x' = x + h v'. In single precision every number
is rounded at each of n substeps, so errors are n · u of its size at most, and mostly far less.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import cos, pi, sqrt

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from mujoco_compiled.program.interpret import interpret
from mujoco_compiled.program.program import Program
from mujoco_compiled.substep import SubstepState, control_step, read_model
from mujoco_compiled.tests.extra import extra
from mujoco_compiled.tests.states import THOROUGH
from mujoco_compiled.tests.test_machine_code import run

Array = NDArray[np.floating]
GRAVITY = 9.81
FLOOR = '<geom type="plane" size="5 5 1"/>'


@dataclass(frozen=True)
class Precision:
    """rounding: of a number of size 1. tolerance: of the solver."""

    compute: Callable[[Program, dict[str, list[Array]]], Mapping[str, Sequence[Array] | Array]]
    rounding: float
    tolerance: float


@pytest.fixture(
    params=[Precision(interpret, 2.0**-53, 1e-15), Precision(run, 2.0**-24, 1e-7)], ids=["double", "single"]
)
def precision(request: pytest.FixtureRequest) -> Precision:
    return request.param


def model_of(world: str, option: str = "", more: str = "") -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(
        f"<mujoco><option {option}/><worldbody>{world}</worldbody>{more}</mujoco>"
    )


def moved(
    precision: Precision, model: mujoco.MjModel, num_substeps: int, **given: Array
) -> tuple[Array, Array, Array]:
    """qpos, qvel and qacc after the substeps, [number, environments] as what is given.

    given: qpos, qvel and ctrl, where they are not those of the model at rest.
    """
    ours = read_model(model)
    solver = replace(ours.solver, **THOROUGH, tolerance=precision.tolerance)
    num_envs = next(iter(given.values())).shape[1]
    at_rest = {"qpos": model.qpos0, "qvel": np.zeros(model.nv), "ctrl": np.zeros(model.nu)}
    begun = {name: np.repeat(x[:, None], num_envs, axis=1) for name, x in at_rest.items() if x.size} | given
    program = Program()
    inputs = {name: list(program.inputs(name, len(values))) for name, values in begun.items()}
    state = SubstepState(inputs["qpos"], inputs["qvel"], [], [0.0] * model.nv)
    after = control_step(replace(ours, solver=solver), num_substeps, state, inputs.get("ctrl", []))
    for name in ("qpos", "qvel", "qacc"):
        program.output(name, getattr(after, name))
    found = precision.compute(program, {name: list(values) for name, values in begun.items()})
    qpos, qvel, qacc = (
        np.stack([np.broadcast_to(x, num_envs) for x in found[name]]) for name in ("qpos", "qvel", "qacc")
    )
    return qpos, qvel, qacc


def test_a_ball_falls_as_euler_s_sum_has_it(precision: Precision) -> None:
    h, n = 0.005, 100
    model = model_of('<body><freejoint/><geom size="0.1"/></body>', f'timestep="{h}"')
    begun = np.zeros((6, 3))
    begun[2] = 0.0, 3.0, -1.0
    qpos, qvel, _ = moved(precision, model, n, qvel=begun)
    # The speed after k substeps is v - g h k. Their sum, times h, is v t - g t (t + h) / 2.
    t = n * h
    size = n * precision.rounding * GRAVITY
    np.testing.assert_allclose(qvel[2], begun[2] - GRAVITY * t, rtol=0, atol=size)
    np.testing.assert_allclose(qpos[2], begun[2] * t - GRAVITY * t * (t + h) / 2.0, rtol=0, atol=size)


MASS, LENGTH, RADIUS = 2.0, 0.7, 0.1
# About the hinge, by Steiner; and the square of the speed of small swings.
INERTIA = MASS * (LENGTH**2 + 0.4 * RADIUS**2)
SWING = MASS * GRAVITY * LENGTH / INERTIA


def pendulum(timestep: float) -> mujoco.MjModel:
    ball = f'<geom size="{RADIUS}" mass="{MASS}" pos="0 0 {-LENGTH}"/>'
    return model_of(f'<body><joint axis="0 1 0"/>{ball}</body>', f'timestep="{timestep!r}"')


@pytest.mark.parametrize("amplitude", [0.1, 1.0, 2.5])
def test_a_pendulum_is_back_after_its_period(precision: Precision, amplitude: float) -> None:
    # T = 2 π / ω / agm(1, cos(amplitude / 2)), by Gauss.
    one, other = 1.0, cos(amplitude / 2.0)
    for _ in range(6):
        one, other = (one + other) / 2.0, sqrt(one * other)
    period, n = 2.0 * pi / sqrt(SWING) / one, 1000
    h = period / n
    qpos, qvel, qacc = moved(precision, pendulum(h), n, qpos=np.full((1, 1), amplitude))
    # The method shortens the period of small swings by (ω h)² / 24 of it, and that of large ones by less. The
    # position is half a substep ahead of the speed.
    late, rounded = 1.01 * period * SWING * h**2 / 24.0, n * precision.rounding
    assert abs(qvel[0, 0]) < abs(qacc[0, 0]) * late + sqrt(SWING) * rounded
    assert abs(qpos[0, 0] - amplitude) < h * abs(qvel[0, 0]) + rounded


def energy(qpos: Array, qvel: Array) -> Array:
    """In J, from the lowest place on."""
    return INERTIA * (0.5 * qvel**2 + SWING * (1.0 - np.cos(qpos)))


def test_a_pendulum_keeps_its_energy(precision: Precision) -> None:
    # Euler's method keeps E - h/2 · I ω² θ' sin θ but for (ω h)² of it: E swings with h, and does not drift.
    h, n, begun = 0.002, 1000, np.array([[0.5, 2.0, 3.0]])
    qpos, qvel, _ = moved(precision, pendulum(h), n, qpos=begun)
    swing = 0.5 * h * INERTIA * SWING * qvel * np.sin(qpos)
    at_most = SWING * h**2 + n * precision.rounding
    np.testing.assert_allclose(energy(qpos, qvel) - swing, energy(begun, 0.0 * begun), rtol=at_most)


def test_a_box_slides_with_the_friction_of_its_weight(precision: Precision) -> None:
    friction, h = 0.5, 0.005
    box = (
        f'<body pos="0 0 0.1"><freejoint/><geom type="box" size="0.2 0.2 0.1" friction="{friction}"/></body>'
    )
    model = model_of(FLOOR.replace("/>", ' priority="-1"/>') + box, f'timestep="{h}" cone="elliptic"')
    begun, n = np.zeros((6, 2)), 100
    begun[:2] = [5.0, 0.0], [0.0, 4.0]
    _, qvel, _ = moved(precision, model, n, qvel=begun)
    # Where all corners slide, friction is μ times their force N, which is not always the weight: the box
    # rocks on its soft contacts. But m v_z = ∫ N - m g t, so m (v - v_0) = -μ ∫ N = -μ m (v_z + g t).
    expected = begun[:2] - friction * (qvel[2] + GRAVITY * n * h) * np.sign(begun[:2])
    assert np.abs(qvel[:2]).max(axis=0).min() > 1.0
    np.testing.assert_allclose(qvel[:2], expected, rtol=0, atol=n * precision.rounding * GRAVITY)


@pytest.mark.parametrize("cone", ["elliptic", *extra("pyramidal")])
def test_a_box_at_rest_stays_where_its_contacts_carry_it(precision: Precision, cone: str) -> None:
    # Four corners push with d / (1 - d) · m · k d r each, k = 1 / (d τ)², and carry m g. A pyramid has four
    # edges, each of which is softer by 2 μ² (1 + μ²).
    d, time, friction, half, h = 0.9, 0.02, 0.5, 0.1, 0.005
    soft = f'friction="{friction}" solimp="{d} {d}" solref="{time} 1" priority="1"'
    box = f'<body><freejoint/><geom type="box" size="0.2 0.2 {half}" {soft}/></body>'
    model = model_of(FLOOR + box, f'timestep="{h}" cone="{cone}"')
    stiffer = 1.0 if cone == "elliptic" else 4.0 / (2.0 * friction**2 * (1.0 + friction**2))
    depth = GRAVITY * (1.0 - d) * time**2 / (4.0 * stiffer)
    begun = np.repeat(model.qpos0[:, None], 2, axis=1)
    begun[2] = half - depth, half
    qpos, qvel, qacc = moved(precision, model, 200, qpos=begun)
    rounded = 10.0 * precision.rounding * half
    np.testing.assert_allclose(qpos[2], half - depth, rtol=0, atol=rounded)
    np.testing.assert_allclose(
        qpos[[0, 1, 3, 4, 5, 6]], model.qpos0[[0, 1, 3, 4, 5, 6], None].repeat(2, 1), atol=rounded
    )
    np.testing.assert_allclose(qvel, 0.0, rtol=0, atol=rounded / h)
    # The contacts' force less the weight, in m/s²: as much as rounding changes the depth.
    np.testing.assert_allclose(qacc, 0.0, rtol=0, atol=GRAVITY * rounded / depth)


TREE = """
<body><freejoint/><geom type="box" size="0.1 0.2 0.15" contype="0"/>
  <body pos="0.3 0 0"><joint name="a" axis="1 2 0.3"/>
    <geom type="capsule" size="0.05" fromto="0 0 0 0.3 0.2 0.1" contype="0"/></body>
  <body pos="-0.2 0 0"><joint name="b" axis="1 2 -0.2"/>
    <geom type="capsule" size="0.05" fromto="0 0 0 -0.2 0.2 0.1" contype="0"/></body>
</body>
"""


def test_a_free_tree_keeps_its_momentum_under_its_own_motors(precision: Precision) -> None:
    motors = '<actuator><motor joint="a"/><motor joint="b"/></actuator>'
    apart = list[Array]()
    for h, n in ((0.002, 100), (0.001, 200)):
        model = model_of(TREE, f'timestep="{h}" gravity="0 0 0"', motors)
        qpos, qvel, _ = moved(precision, model, n, ctrl=np.array([[2.0, -1.0], [1.0, 3.0]]))
        apart.append(np.stack([momentum(model, *each) for each in zip(qpos.T, qvel.T, strict=True)]))
    # It begins at rest, so both momenta are 0, but for the method's error, which is c h + O(h²): twice that
    # of half the timestep, less that of the whole one, leaves O(h²).
    largest = np.abs(apart[0]).max()
    assert largest < 0.1
    np.testing.assert_allclose(2.0 * apart[1] - apart[0], 0.0, rtol=0, atol=0.01 * largest)


def momentum(model: mujoco.MjModel, qpos: Array, qvel: Array) -> Array:
    """Linear, and angular about the centre of mass, [6]."""
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = qpos, qvel
    mujoco.mj_forward(model, data)
    mujoco.mj_subtreeVel(model, data)
    return np.concatenate([model.body_subtreemass[1] * data.subtree_linvel[1], data.subtree_angmom[1]])


def test_a_box_turns_about_its_principal_axes_for_ever(precision: Precision) -> None:
    h, n, speed = 0.002, 500, 3.0
    model = model_of(
        '<body><freejoint/><geom type="box" size="0.1 0.2 0.3"/></body>', f'timestep="{h}" gravity="0 0 0"'
    )
    begun = np.concatenate([np.zeros((3, 3)), speed * np.eye(3)])
    qpos, qvel, _ = moved(precision, model, n, qvel=begun)
    half = 0.5 * speed * n * h
    turned = np.concatenate([np.full((1, 3), np.cos(half)), np.sin(half) * np.eye(3)])
    np.testing.assert_array_equal(qvel, begun)
    np.testing.assert_allclose(qpos[3:], turned, rtol=0, atol=n * precision.rounding)
