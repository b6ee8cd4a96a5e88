"""dm_control's rat on a floor. Source: Merel et al., "Deep neuroethology of a virtual rodent", 2020."""

from pathlib import Path

import mujoco

from core.environments import optional_packages
from core.environments.dm_control.rodent.info import RodentOptions
from core.installation import to_install
from core.physics.engine import SolverSettings

_SETTLING_S = 2.0
# The extent that a picture shows: the body, not the floor.
_EXTENT_M = 1.0
# A group that is not drawn: the skin shows the body, and its geoms would stick out of it.
_HIDDEN = 3


def rodent(_: str, options: RodentOptions) -> tuple[mujoco.MjSpec, SolverSettings]:
    """The rat under these options, and the settings of its solver."""
    # The tail's joints have next to no inertia: without implicit damping they fly apart at once.
    solver = SolverSettings.of_job(
        options.iterations, options.ls_iterations, implicit_damping=True, solver=options.solver
    )
    return rodent_spec(options.timestep), solver


def rodent_model(timestep: float) -> mujoco.MjModel:
    """`rodent_spec` as a model."""
    return rodent_spec(timestep).compile()


def rodent_spec(timestep: float) -> mujoco.MjSpec:
    """The rat with a free joint, above an endless floor; its `init_qpos` is how it stands at rest.

    Every part touches only the floor, which alone carries a running rat: MJX has no contacts between
    ellipsoids and boxes. Sensors are left out, because nothing reads them.
    Raises JobFailed("bad_model") where dm_control, which brings the body, is not installed.
    """
    spec = mujoco.MjSpec.from_file(str(_xml()))
    spec.option.timestep = timestep
    # The file reserves 3.4 GB for the contacts of each environment.
    spec.nconmax = spec.njmax = -1
    spec.stat.extent = _EXTENT_M
    for geom in spec.geoms:
        geom.contype, geom.conaffinity = 0, 1
        geom.group = _HIDDEN
    for sensor in list(spec.sensors):
        spec.delete(sensor)
    _add_floor(spec)
    spec.body("torso").add_freejoint(name="root")
    spec.add_numeric(name="init_qpos", data=_at_rest(spec.compile()), size=0)
    return spec


def _add_floor(spec: mujoco.MjSpec) -> None:
    """Add a plane of 0.1 m squares; friction and stiffness are those that the file gives the body."""
    spec.add_texture(
        name="floor",
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
        rgb1=[0.2, 0.2, 0.2],
        rgb2=[0.8, 0.8, 0.8],
        width=100,
        height=100,
    )
    material = spec.add_material(name="floor", texrepeat=[5, 5], texuniform=True)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "floor"
    spec.worldbody.add_geom(
        name="floor",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[50, 50, 1],
        contype=1,
        conaffinity=0,
        material="floor",
        rgba=[1, 1, 1, 1],
    )


def _at_rest(model: mujoco.MjModel) -> list[float]:
    """Positions [nq] above the origin after the body has settled from the file's initial position."""
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, round(_SETTLING_S / model.opt.timestep))
    data.qpos[:2] = 0
    return data.qpos.tolist()


def _xml() -> Path:
    brings, install = "The rodent's body comes with dm_control", to_install("dm-control")
    path = "locomotion/walkers/assets/rodent.xml"
    return optional_packages.file("dm_control", path, brings=brings, install=install)
