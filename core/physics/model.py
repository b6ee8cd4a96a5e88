"""Loading models, changing them before they are stepped, and keeping their numbers in full precision."""

import copy
from collections.abc import Collection
from importlib.util import find_spec
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from core.errors import JobFailed
from core.physics.engine import SolverSettings
from core.reasons import Reason
from mujoco_compiled import GEOMETRY

_LEAST_ITERATIONS = 2
_SOLVERS = {"newton": mujoco.mjtSolver.mjSOL_NEWTON, "cg": mujoco.mjtSolver.mjSOL_CG}


def brax_model(name: str) -> mujoco.MjModel:
    """The model `<name>.xml` of the brax wheel; bodies without joints are fused as Brax does."""
    return brax_spec(name).compile()


def brax_spec(name: str) -> mujoco.MjSpec:
    """The source of `brax_model`. `settotalmass` is deprecated, so the geoms are scaled instead."""
    spec = mujoco.MjSpec.from_file(str(_brax_assets() / f"{name}.xml"))
    spec.compiler.fusestatic = True
    total_mass = spec.compiler.settotalmass
    if total_mass <= 0:
        return spec
    spec.compiler.settotalmass = -1
    factor = total_mass / np.sum(spec.compile().body_mass)
    for geom in spec.geoms:
        geom.mass *= factor  # NaN, and stays NaN, where the mass follows from the density
        geom.density *= factor
    return spec


def _brax_assets() -> Path:
    # `import brax` would load all of Brax's environments, which takes seconds.
    brax = find_spec("brax")
    if brax is None or brax.origin is None:
        raise ModuleNotFoundError("The brax package is not installed; it brings the models.")
    return Path(brax.origin).parent / "envs" / "assets"


def initial_qpos(model: mujoco.MjModel) -> NDArray[np.float64]:
    """Where an episode begins, [nq]: the model's custom numeric `init_qpos`, or `qpos0` if it has none.

    Raises JobFailed("bad_model") for one of another length.
    """
    for index in range(model.nnumeric):
        numeric = model.numeric(index)
        if numeric.name == "init_qpos":
            if numeric.data.size != model.nq:
                raise JobFailed(
                    Reason.BAD_MODEL,
                    f"The model's custom numeric init_qpos has length {numeric.data.size}, but the model has "
                    f"{model.nq} positions (nq).",
                )
            return np.array(numeric.data)
    return model.qpos0.copy()


def with_solver(model: mujoco.MjModel, settings: SolverSettings | None) -> mujoco.MjModel:
    """A copy of the model with these solver settings; if None, an unchanged copy."""
    changed = copy.copy(model)
    if settings is None:
        return changed
    changed.opt.solver = _SOLVERS[settings.solver]
    changed.opt.iterations = settings.iterations
    changed.opt.ls_iterations = settings.ls_iterations
    flag = int(mujoco.mjtDisableBit.mjDSBL_EULERDAMP)
    flags = changed.opt.disableflags & ~flag
    changed.opt.disableflags = flags if settings.implicit_damping else flags | flag
    return changed


def with_asked_solver(model: mujoco.MjModel, settings: SolverSettings | None) -> mujoco.MjModel:
    """A copy of the model with those of these solver settings that the job itself gives; for `native`."""
    changed = copy.copy(model)
    for name in settings.asked if settings is not None else ():
        value = getattr(settings, name)
        setattr(changed.opt, name, _SOLVERS[value] if name == "solver" else value)
    return changed


def with_enough_iterations(model: mujoco.MjModel, settings: SolverSettings | None) -> mujoco.MjModel:
    """A copy of the model with these solver settings, for `warp` and `compiled`: they make two iterations at
    least, unless the job itself gives a number.

    Measured with the ant on `warp`, 30 M steps on an H200: a return of 3,086 ± 222 (3 seeds) with one
    iteration and 3,950 (1 seed) with two; MJX-JAX reaches 3,619 ± 114 with one. The second costs 10 % of the
    training rate. `compiled` has not been measured with one.
    """
    changed = with_solver(model, settings)
    if settings is None or "iterations" not in settings.asked:
        changed.opt.iterations = max(_LEAST_ITERATIONS, changed.opt.iterations)
    return changed


def with_solver_of_compiled(model: mujoco.MjModel, settings: SolverSettings | None) -> mujoco.MjModel:
    """A copy of the model as `compiled` steps it."""
    own = settings.compiled if settings is not None else None
    return with_enough_iterations(model, own or settings)


def with_loose_frames(model: mujoco.MjModel, own: Collection[str]) -> mujoco.MjModel:
    """A copy of the model that has nothing which was computed from places that environments have for
    themselves; the model itself if they have none. own: the names of their fields."""
    has_centres = "body_ipos" in own
    if not has_centres and not set(GEOMETRY).intersection(own):
        return model
    loose, apart = copy.copy(model), mujoco.mjtSameFrame.mjSAMEFRAME_NONE
    # It looks at each body's tree of boxes, which is about the centre of mass.
    loose.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_MIDPHASE)
    loose.geom_sameframe[:] = apart
    if has_centres:
        loose.body_sameframe[:] = loose.site_sameframe[:] = apart
    return loose


Floats = NDArray[np.float32]


def in_parts(values: NDArray[np.float64] | float) -> Floats:
    """Numbers [...] as sums of three float32, [..., 3], which hold all of their bits."""
    rest, parts = np.asarray(values, np.float64), list[Floats]()
    for _ in range(3):
        parts.append(rest.astype(np.float32))
        rest = rest - parts[-1]
    return np.stack(parts, axis=-1)


def of_parts(parts: Floats) -> NDArray[np.float64]:
    """The numbers of `in_parts`."""
    return parts.astype(np.float64).sum(axis=-1)


# Brax's settings for MJX, where each iteration is dear. `compiled` goes nearly as far as MuJoCo: a humanoid
# that learned with two iterations fell in MuJoCo itself.
BRAX_SOLVER = SolverSettings(
    iterations=1,
    ls_iterations=4,
    implicit_damping=False,
    compiled=SolverSettings(iterations=4, ls_iterations=8, implicit_damping=True),
)
