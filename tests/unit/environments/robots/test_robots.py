"""The catalog's robots: their numbers by hand, and that their servos hold them."""

import math
import tomllib
from importlib.machinery import ModuleSpec
from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from pydantic import ValidationError

from core import installation
from core.algorithms.spec import BaseSpec
from core.environments import catalog, optional_packages
from core.environments.mjcf.edit_options import HOME
from core.environments.robots import model as models
from core.environments.robots.g1 import G1
from core.environments.robots.go1 import GO1
from core.environments.robots.info import G1Options, Go1Options
from core.environments.robots.robot import Robot
from core.environments.terms.actions import JointPositionAction
from core.environments.terms.actuation import actuation
from core.environments.terms.feet import feet_of
from core.environments.terms.terrain import Terrain
from core.errors import JobFailed
from core.jobs.resolved import resolve_job
from core.jobs.spec import TrainSpec
from core.jobs.workers import how_to_install
from core.physics.choose import engine_builder
from core.physics.engine import SolverSettings
from mujoco_compiled import uncovered
from tests.extra import extra

ROOT = Path(__file__).parents[4]


@pytest.fixture(scope="module")
def g1() -> mujoco.MjModel:
    return models.spec(G1).compile()


@pytest.fixture(scope="module")
def go1() -> mujoco.MjModel:
    return models.spec(GO1).compile()


def armature(model: mujoco.MjModel, joint: str) -> float:
    return float(model.dof_armature[model.joint(joint).dofadr[0]])


def test_the_g1_has_its_motors(g1: mujoco.MjModel) -> None:
    assert (g1.nv, g1.nu, g1.opt.timestep) == (35, 29, 0.005)
    # Unitree's data sheet says "about 35 kg" with a battery that this model has not.
    assert g1.body_mass.sum() == pytest.approx(33.34, abs=0.01)
    # The rotor's 0.489e-4 behind 4.5 · 5 = 22.5, then 0.109e-4 behind 5, then 0.738e-4:
    # 0.024755625 + 0.0002725 + 0.0000738 kg m².
    assert armature(g1, "left_knee_joint") == pytest.approx(0.025101925)
    # At 10 Hz: kp = 0.025101925 · (20 π)², and kd = 2 · 2 · 0.025101925 · 20 π.
    knee = g1.actuator("left_knee_joint")
    assert knee.gainprm[0] == pytest.approx(99.0984, abs=1e-3)
    assert -knee.biasprm[1] == knee.gainprm[0]
    assert -knee.biasprm[2] == pytest.approx(4 * 0.025101925 * 20 * math.pi)
    # Two motors of 25 N m move an ankle.
    for joint in ("left_ankle_pitch_joint", "right_ankle_roll_joint", "waist_roll_joint"):
        assert g1.actuator(joint).forcerange.tolist() == [-50, 50]
        assert armature(g1, joint) == pytest.approx(2 * 0.0036097, abs=1e-6)


def test_the_go1_has_its_motors(go1: mujoco.MjModel) -> None:
    assert (go1.nv, go1.nu, go1.opt.timestep) == (18, 12, 0.005)
    # 1.11842e-4 kg m² behind 6, and at the knee behind 6 · 1.5 = 9.
    assert armature(go1, "FL_hip_joint") == pytest.approx(36 * 1.11842e-4)
    assert armature(go1, "FL_calf_joint") == pytest.approx(81 * 1.11842e-4)
    assert go1.actuator("RR_calf_joint").forcerange.tolist() == [-35.55, 35.55]
    # Half of the effort against the spring: 0.5 · 35.55 / (81 · 1.11842e-4 · (20 π)²).
    scale = actuation(JointPositionAction(), go1, go1.qpos0).gain
    assert scale[go1.actuator("FL_calf_joint").id] == pytest.approx(0.4970, abs=1e-4)


def test_a_robot_begins_on_its_feet(g1: mujoco.MjModel, go1: mujoco.MjModel) -> None:
    for model, pose in (
        (g1, {"left_hip_pitch_joint": -0.312, "right_knee_joint": 0.669, "left_hip_yaw_joint": 0.0}),
        (go1, {"FR_hip_joint": 0.1, "RL_hip_joint": -0.1, "FL_calf_joint": -1.8}),
    ):
        data = mujoco.MjData(model)
        mujoco.mj_resetDataKeyframe(model, data, model.key(HOME).id)
        for joint, angle in pose.items():
            assert float(data.joint(joint).qpos[0]) == angle == float(data.actuator(joint).ctrl[0])
        data.qpos[2] -= 1e-4
        mujoco.mj_forward(model, data)
        assert data.ncon > 1
        assert min(contact.dist for contact in data.contact) == pytest.approx(-1e-4, abs=1e-6)
    # mjlab drops its Go1 from 0.278 m, which is for a sagging pose: the thighs hold less than they should.
    assert go1.key(HOME).qpos[2] == pytest.approx(0.294, abs=1e-3)


def test_their_feet_are_soles_on_the_floor(g1: mujoco.MjModel, go1: mujoco.MjModel) -> None:
    for robot, model in ((G1, g1), (GO1, go1)):
        feet = feet_of(model, robot.feet, model.key(HOME).qpos)
        assert [model.body(foot.body).name for foot in feet] == list(robot.feet)
        assert [foot.ground for foot in feet] == pytest.approx([0.0] * len(feet), abs=1e-3)
        for foot in feet:
            # A ball of 23 mm at the end of a calf; the bottom of an ankle.
            assert foot.radius == (0.023 if robot is GO1 else 0.0)
            assert foot.point.tolist() == pytest.approx(
                [0, 0, -0.213] if robot is GO1 else [0, 0, 0], abs=0.1
            )


def test_only_feet_touch_only_the_floor(g1: mujoco.MjModel, go1: mujoco.MjModel) -> None:
    for robot, model, number in ((G1, g1, 2), (GO1, go1, 1)):
        touching = np.flatnonzero(model.geom_conaffinity)
        bodies = [model.body(body).name for body in model.geom_bodyid[touching]]
        assert bodies == [foot for foot in robot.feet for _ in range(number)]
        assert not model.geom_contype[touching].any()
        assert (model.geom_friction[touching, 0] == 0.6).all()
        assert (model.geom_priority[touching] == 1).all()


def held(model: mujoco.MjModel, seconds: float, *, hangs: bool) -> mujoco.MjData:
    """From its pose, its servos at it. hangs: its root is held in the air."""
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key(HOME).id)
    data.qpos[2] += 0.5 * hangs
    root = data.qpos[:7].copy()
    for _ in range(round(seconds / model.opt.timestep)):
        mujoco.mj_step(model, data)
        if hangs:
            data.qpos[:7], data.qvel[:6] = root, 0.0
    assert np.isfinite(data.qpos).all()
    return data


def test_the_go1_stands_under_its_servos(go1: mujoco.MjModel) -> None:
    data = held(go1, 2.0, hangs=False)
    assert data.qpos[2] > 0.2
    assert np.abs(data.qvel).max() < 0.5
    assert data.xmat[go1.body("trunk").id][8] > 0.97


def test_the_servos_of_the_g1_hold_its_limbs(g1: mujoco.MjModel) -> None:
    # It cannot stand so: two ankles hold 57 N m/rad, and 33 kg whose centre is 0.7 m up tip with 229 N m/rad.
    data = held(g1, 2.0, hangs=True)
    assert np.abs(data.qpos[7:] - data.ctrl).max() < 0.2
    assert np.abs(data.qvel).max() < 0.05


@pytest.mark.parametrize("robot", [G1, GO1], ids=lambda robot: robot.name)
def test_it_has_nothing_that_compiled_lacks(robot: Robot, request: pytest.FixtureRequest) -> None:
    assert uncovered(request.getfixturevalue(robot.name)) is None


@pytest.mark.timeout(300)
@pytest.mark.parametrize("robot", extra(G1, GO1), ids=lambda robot: robot.name)
def test_compiled_moves_it_as_mujoco_does(robot: Robot, request: pytest.FixtureRequest) -> None:
    model = request.getfixturevalue(robot.name)
    settings = SolverSettings(20, 20, implicit_damping=True)
    native, compiled = (
        engine_builder(name)(model, 4, ("xpos",), accelerated=settings) for name in ("native", "compiled")
    )
    step = jax.jit(native.step)
    start = model.key(HOME).qpos.astype(np.float32)
    start[2] -= 1e-3  # Feet at a distance of 0 touch in double precision, and perhaps not in single.
    states = [native.reset(jnp.asarray(start), jnp.zeros(model.nv))]
    targets = model.key(HOME).ctrl + np.random.default_rng(0).uniform(-0.2, 0.2, (25, model.nu))
    for target in targets:
        states.append(step(states[-1], jnp.asarray(target, jnp.float32)))
    before = jax.tree.map(lambda *leaves: jnp.stack(leaves), *states[:-1])
    ours = jax.jit(jax.vmap(compiled.step))(before, jnp.asarray(targets, jnp.float32))
    theirs = np.stack([np.asarray(state.qpos) for state in states[1:]])
    np.testing.assert_allclose(np.asarray(ours.qpos), theirs, atol=2e-3)


def test_a_worker_without_the_files_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    def nothing(_: str) -> ModuleSpec | None:
        return None

    monkeypatch.setattr(optional_packages, "find_spec", nothing)
    with pytest.raises(JobFailed, match="this worker does not have") as failed:
        models.spec(G1)
    assert "uv sync --inexact --group robots" in failed.value.detail
    assert how_to_install("mjlab") == "uv sync --inexact --group robots"


def test_pip_is_told_the_version_that_is_locked(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(installation, "IS_WHEEL", True)
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    (robots,) = project["dependency-groups"]["robots"]
    assert installation.to_install_robots() == f"pip install --no-deps {robots}"
    bare = {each["name"]: each for each in project["tool"]["uv"]["dependency-metadata"]}["mjlab"]
    assert (f"mjlab=={bare['version']}", bare["requires-dist"]) == (robots, [])


def test_a_task_says_what_a_job_leaves_out() -> None:
    walks, climbs = Go1Options(), Go1Options.model_validate({"task": "rough"})
    assert walks.terrain is None
    assert walks.critic is None
    assert climbs.terrain == Terrain()
    assert [term.kind for term in climbs.critic or []][-1] == "height_scan"
    of_job = Go1Options.model_validate({"task": "rough", "terrain": {"kinds": ["blocks"]}, "events": []})
    assert of_job.terrain == Terrain(kinds=["blocks"])
    assert of_job.events == []
    assert of_job.observation == climbs.observation
    # What is written down whole, as in a checkpoint, is read as it is.
    assert Go1Options.model_validate(climbs.model_dump(mode="json")) == climbs


def test_the_steps_of_a_training_follow_from_its_task() -> None:
    def settings(task: str) -> BaseSpec:
        job = {"environment": {"id": "go1", "options": {"task": task}}, "algorithm": {"kind": "ppo"}}
        return resolve_job(TrainSpec.model_validate(job)).settings_on("gpu")

    walk, rough, up = (settings(task).model_dump() for task in ("walk", "rough", "get_up"))
    assert walk["num_timesteps"] < up["num_timesteps"] < rough["num_timesteps"]
    assert (walk["value_obs_key"], rough["value_obs_key"]) == ("state", "privileged_state")
    assert (walk["episode_length"], up["episode_length"]) == (1000, 250)


def test_a_robot_that_gets_up_lies_on_its_trunk() -> None:
    info, options = catalog.resolve("go1", {"task": "get_up"})
    environment = catalog.make(info, options, engine_builder("native"))
    starts = jax.jit(jax.vmap(environment.reset))(jax.random.split(jax.random.PRNGKey(0), 64))
    lies, _ = jax.lax.scan(
        lambda state, _: (jax.vmap(environment.step)(state, jnp.zeros((64, 12))), None), starts, length=100
    )
    # Of 64 that were turned at random many lie on their backs or sides; the trunk is 11 cm thick.
    heights = np.asarray(lies.metrics["height"])
    upright = np.asarray(lies.metrics["reward_upright"])
    assert (upright < 0.5).sum() > 20
    assert heights.min() > 0.04
    assert not np.asarray(lies.done).any()


def test_the_g1_is_refused_what_it_does_not_learn() -> None:
    with pytest.raises(ValidationError, match="'walk', 'rough' or 'imitate'"):
        G1Options.model_validate({"task": "get_up"})
