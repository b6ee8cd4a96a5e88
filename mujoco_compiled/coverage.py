"""The parts of a model that the stages do not compute, found before any code is made."""

from collections.abc import Callable, Iterator, Sequence

import mujoco
import numpy as np

from mujoco_compiled.collisions.fields import MOST_CELLS, MOST_HEIGHTS, HeightField, read_field
from mujoco_compiled.collisions.own_boxes import fixed_boxes
from mujoco_compiled.collisions.prisms import ON_FIELDS
from mujoco_compiled.collisions.table import COLLIDERS
from mujoco_compiled.constraints.contact_room import MOST_SLOTS
from mujoco_compiled.constraints.pairs import Pair, meshes_left_out, read_pairs
from mujoco_compiled.constraints.solref import is_computable
from mujoco_compiled.fields import GEOMETRY, Fields
from mujoco_compiled.named import named, where, word
from mujoco_compiled.program.arithmetic import squared
from mujoco_compiled.readings.derived import DERIVED_FIELDS
from mujoco_compiled.readings.sensor_coverage import turn_several_axes, unread_sensors
from mujoco_compiled.smooth.routes import is_inside, sides

_DISABLE, _ENABLE = mujoco.mjtDisableBit, mujoco.mjtEnableBit
# Switches that the stages follow, and those that change nothing that they compute.
_FOLLOWED = (
    _DISABLE.mjDSBL_EULERDAMP
    | _DISABLE.mjDSBL_FILTERPARENT
    | _DISABLE.mjDSBL_CONSTRAINT
    | _DISABLE.mjDSBL_EQUALITY
    | _DISABLE.mjDSBL_LIMIT
    | _DISABLE.mjDSBL_CONTACT
    | _DISABLE.mjDSBL_SPRING
    | _DISABLE.mjDSBL_DAMPER
    | _DISABLE.mjDSBL_GRAVITY
    | _DISABLE.mjDSBL_CLAMPCTRL
    | _DISABLE.mjDSBL_WARMSTART
    | _DISABLE.mjDSBL_ACTUATION
)
_WITHOUT_EFFECT = (
    _DISABLE.mjDSBL_SENSOR
    | _DISABLE.mjDSBL_MIDPHASE
    | _DISABLE.mjDSBL_AUTORESET
    | _DISABLE.mjDSBL_NATIVECCD
    | _DISABLE.mjDSBL_ISLAND
    | _DISABLE.mjDSBL_MULTICCD
)
_ENABLED_WITHOUT_EFFECT = _ENABLE.mjENBL_ENERGY | _ENABLE.mjENBL_FWDINV

# By how much a contact may be stiffer than fits what it moves: rounding in single precision (6e-8) is 3e-4 of
# its force then. A hundred times more, and numbers become NaN.
_MOST_STIFFNESS = 5000.0


class Uncovered(NotImplementedError):
    """What the stages cannot compute, as a sentence."""


def uncovered(model: mujoco.MjModel, derived: Sequence[str] = (), nconmax: int | None = None) -> str | None:
    """The first reason why the stages cannot move the model, or compute these derived fields of it, such as
    "its geom 'rock' is a mesh"; None: they can. nconmax: see `put_model`."""
    reasons = (reason for check in _CHECKS for reason in check(model))
    return next(reasons, None) or _rest(model, nconmax) or uncovered_fields(model, derived)


def uncovered_fields(model: mujoco.MjModel, names: Sequence[str]) -> str | None:
    """The first reason why these derived fields cannot be computed for a model that the stages can move."""
    if unknown := sorted(set(names) - set(DERIVED_FIELDS)):
        return f"{unknown[0]} is not a derived field"
    return next((why for _, why in unread_sensors(model)), None) if "sensordata" in names else None


def left_out(model: mujoco.MjModel) -> Iterator[str]:
    """What the stages leave out of a model that they move, in sentences such as "its geoms 'thigh' and
    'trunk' pass through each other, as both are meshes"."""
    if model.opt.disableflags & (_DISABLE.mjDSBL_CONTACT | _DISABLE.mjDSBL_CONSTRAINT):
        return
    if pairs := meshes_left_out(model):
        one, other = (named(model, "geom", number) for number in pairs[0])
        more = f", and so do {len(pairs) - 1} more pairs" if len(pairs) > 1 else ""
        yield f"its geoms {one} and {other} pass through each other, as both are meshes{more}"


def uncovered_own(model: mujoco.MjModel, names: Sequence[str], derived: Sequence[str] = ()) -> str | None:
    """The first reason why environments cannot have these fields of the model for themselves, where these
    derived fields are read."""
    if moved := sorted(set(GEOMETRY).intersection(names)):
        for geom, side in sides(model):
            if is_inside(model, geom, side):
                return f"{moved[0]}: a tendon passes through its geom {named(model, 'geom', geom)}"
        if "geom_xpos" in derived:
            return f"{moved[0]}: geom_xpos is read, which has the geoms where the model has them"
        if "sensordata" in derived and (sensor := _reads_a_fixed_box(model)) is not None:
            return (
                f"{moved[0]}: its sensor {named(model, 'sensor', sensor)} reads a box where the model has it"
            )
    return next((reason for name in names for reason in _own(model, name)), None)


def _reads_a_fixed_box(model: mujoco.MjModel) -> int | None:
    """The first sensor that reads a box that never moves; its contacts, too, where it must tell it from other
    boxes."""
    geom, boxes = mujoco.mjtObj.mjOBJ_GEOM, fixed_boxes(model)
    reads = (model.sensor_objtype == geom) & np.isin(model.sensor_objid, boxes)
    reads |= (model.sensor_reftype == geom) & np.isin(model.sensor_refid, boxes)
    return next(iter(np.flatnonzero(reads).tolist()), None)


def _own(model: mujoco.MjModel, name: str) -> Iterator[str]:
    if name == "dof_frictionloss":
        rough = _uncomputable(model.dof_solimp)
        yield from (f"{name}: {reason}" for reason in where(model, "joint", rough, _CURVE, model.dof_jntid))
    if name in ("body_pos", "body_quat"):
        mocap = model.body_mocapid >= 0
        yield from (f"{name}: {reason}" for reason in where(model, "body", mocap, "is a mocap body"))
        yield from (f"{name}: {reason}" for reason in _touched_where_they_are(model))
    if name == "actuator_dynprm":
        exact = model.actuator_dyntype == mujoco.mjtDyn.mjDYN_FILTEREXACT
        yield from (f"{name}: {reason}" for reason in where(model, "actuator", exact, "is an exact filter"))
    affine = {
        "actuator_gainprm": model.actuator_gaintype == mujoco.mjtGain.mjGAIN_AFFINE,
        "actuator_biasprm": model.actuator_biastype == mujoco.mjtBias.mjBIAS_AFFINE,
    }
    if name in affine:
        turning = affine[name] & turn_several_axes(model)
        yield from (f"{name}: {reason}" for reason in where(model, "actuator", turning, "turns several axes"))


def _touched_where_they_are(model: mujoco.MjModel) -> Iterator[str]:
    """The first body, but the world, that never moves but can be touched: its place is a constant."""
    for pair in read_pairs(Fields(model)):
        for body in (int(body) for body in model.geom_bodyid[[pair.one, pair.other]]):
            if body and model.body_treeid[body] < 0:
                yield f"its body {named(model, 'body', body)} stands still and can be touched"


def _options(model: mujoco.MjModel) -> Iterator[str]:
    option = model.opt
    integrators = mujoco.mjtIntegrator
    if option.integrator not in (integrators.mjINT_EULER, integrators.mjINT_IMPLICITFAST):
        yield f"its integrator is {word(mujoco.mjtIntegrator(option.integrator).name)}"
    if option.solver == mujoco.mjtSolver.mjSOL_PGS:
        yield "its solver is PGS"
    if option.noslip_iterations:
        yield "it asks for the noslip solver"
    for bit in _DISABLE.__members__.values():
        if option.disableflags & bit & ~(_FOLLOWED | _WITHOUT_EFFECT):
            yield f"it disables a part of MuJoCo ({word(bit.name)})"
    for bit in _ENABLE.__members__.values():
        if option.enableflags & bit & ~_ENABLED_WITHOUT_EFFECT:
            yield f"it enables a part of MuJoCo ({word(bit.name)})"


def _combinations(model: mujoco.MjModel) -> Iterator[str]:
    """Options that do not go together with what the model has."""
    option = model.opt
    is_implicit = option.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    if option.density or option.viscosity:
        if is_implicit:
            yield "it moves in a fluid, and its integrator is implicitfast"
        if model.geom_fluid[:, 0].any():
            yield "its geoms move in the fluid as ellipsoids (`fluidshape`)"
    if option.disableactuator:
        yield "it disables groups of actuators"


def _parts(model: mujoco.MjModel) -> Iterator[str]:
    """Kinds of parts of which the stages know none."""
    if model.nflex:
        yield f"it has a flexible body, {named(model, 'flex', 0)}"
    if model.nplugin:
        yield "it uses a plugin"


def _equalities(model: mujoco.MjModel) -> Iterator[str]:
    kinds = mujoco.mjtEq
    known = (kinds.mjEQ_CONNECT, kinds.mjEQ_WELD, kinds.mjEQ_JOINT, kinds.mjEQ_TENDON)
    yield from where(model, "equality", ~np.isin(model.eq_type, known), "ties flexible bodies")
    disabled = model.opt.disableflags & (_DISABLE.mjDSBL_EQUALITY | _DISABLE.mjDSBL_CONSTRAINT)
    if disabled or not model.eq_active0.any():
        return
    yield from where(model, "equality", model.eq_active0 & _uncomputable(model.eq_solimp), _CURVE)
    for number in _rigid_equalities(model)[:1]:
        what = f"its equality {named(model, 'equality', number)}"
        yield f"{what} ties bodies that turn about their centres: such ties are rigid in MuJoCo"


def _rigid_equalities(model: mujoco.MjModel) -> list[int]:
    """Those with a row that MuJoCo takes to be harder to move than it is, as in `_is_rigid`."""
    data = mujoco.MjData(model)
    for stage in (mujoco.mj_fwdKinematics, mujoco.mj_makeM, mujoco.mj_factorM, mujoco.mj_makeConstraint):
        stage(model, data)
    rows = np.flatnonzero(data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY)
    jacobian, solved = np.zeros((data.nefc, model.nv)), np.zeros((data.nefc, model.nv))
    if mujoco.mj_isSparse(model):
        structure = (data.efc_J_rownnz, data.efc_J_rowadr, data.efc_J_colind)
        mujoco.mju_sparse2dense(jacobian, data.efc_J, *structure)
    elif data.nefc:
        jacobian[:] = data.efc_J[: jacobian.size].reshape(jacobian.shape)
    mujoco.mj_solveM(model, data, solved, jacobian)
    weights = (jacobian * solved).sum(axis=1)
    return [int(data.efc_id[row]) for row in rows if _MOST_STIFFNESS * data.efc_diagA[row] < weights[row]]


def _joints(model: mujoco.MjModel) -> Iterator[str]:
    rotates = np.isin(model.jnt_type, (mujoco.mjtJoint.mjJNT_FREE, mujoco.mjtJoint.mjJNT_BALL))
    ranged = rotates & (model.jnt_actfrclimited != 0)
    yield from where(model, "joint", ranged, "has several axes and limits its actuators' forces")
    joint_of = model.dof_jntid
    rough = (model.dof_frictionloss != 0) & _uncomputable(model.dof_solimp)
    yield from where(model, "joint", rough, _CURVE, joint_of)
    limited = (model.jnt_limited != 0) & _keeps_limits(model)
    yield from where(model, "joint", limited & _uncomputable(model.jnt_solimp), _CURVE)


def _tendons(model: mujoco.MjModel) -> Iterator[str]:
    is_fixed = model.wrap_type[model.tendon_adr] == mujoco.mjtWrap.mjWRAP_JOINT
    for geom, side in sides(model):
        if model.geom_bodyid[geom] != model.site_bodyid[side]:
            yield f"its site {named(model, 'site', side)} is not on the body of the geom that it is a side of"
    rough = (model.tendon_frictionloss != 0) & _uncomputable(model.tendon_solimp_fri)
    yield from where(model, "tendon", rough, _CURVE)
    limited = (model.tendon_limited != 0) & _keeps_limits(model)
    # In another pose it may move something, by a row of MuJoCo's that is rigid.
    idle = ~is_fixed & (model.tendon_invweight0 < mujoco.mjMINVAL)
    idle &= limited | (model.tendon_frictionloss != 0)
    moves_nothing = "moves nothing in the model's own pose, and has a limit or friction"
    yield from where(model, "tendon", idle, moves_nothing)
    yield from where(model, "tendon", limited & _uncomputable(model.tendon_solimp_lim), _CURVE)


def _actuators(model: mujoco.MjModel) -> Iterator[str]:
    if not model.nactuator:
        return
    kinds, targets = mujoco.mjtTrn, model.actuator_trntype
    gain, bias, dynamics = mujoco.mjtGain, mujoco.mjtBias, mujoco.mjtDyn
    gains, biases = (
        (gain.mjGAIN_FIXED, gain.mjGAIN_AFFINE, gain.mjGAIN_MUSCLE),
        (bias.mjBIAS_NONE, bias.mjBIAS_AFFINE, bias.mjBIAS_MUSCLE),
    )
    simple = np.isin(model.actuator_gaintype, gains) & np.isin(model.actuator_biastype, biases)
    yield from where(model, "actuator", ~simple, "is a motor with dynamics or a user's own kind")
    filters = (
        dynamics.mjDYN_INTEGRATOR, dynamics.mjDYN_FILTER, dynamics.mjDYN_FILTEREXACT, dynamics.mjDYN_MUSCLE
    )  # fmt: skip
    known = np.isin(model.actuator_dyntype, (dynamics.mjDYN_NONE, *filters))
    several = (model.actuator_actnum > 1) | (model.actuator_ctrlnum != 1) | (model.actuator_outnum != 1)
    yield from where(model, "actuator", ~known | several, "has dynamics, inputs or outputs of its own kind")
    turns = turn_several_axes(model)
    in_parent = turns & (targets == kinds.mjTRN_JOINTINPARENT)
    yield from where(model, "actuator", in_parent, "acts on a joint with several axes, in its parent's frame")
    by_length = (model.actuator_gainprm[:, 1] != 0) | (model.actuator_biasprm[:, 1] != 0)
    yield from where(model, "actuator", turns & by_length, "holds a joint with several axes in a position")
    for field in ("armature", "damping", "dampingpoly"):
        values = np.reshape(getattr(model, f"actuator_{field}"), (model.nactuator, -1))
        yield from where(model, "actuator", values.any(axis=1), f"has `{field}` of its own")


def _keeps_limits(model: mujoco.MjModel) -> bool:
    """Whether the ranges of joints and tendons are kept."""
    return not (model.opt.disableflags & (_DISABLE.mjDSBL_LIMIT | _DISABLE.mjDSBL_CONSTRAINT))


def _contacts(model: mujoco.MjModel) -> Iterator[str]:
    if model.opt.disableflags & (_DISABLE.mjDSBL_CONTACT | _DISABLE.mjDSBL_CONSTRAINT):
        return
    of_ends = _inverse_weights(model)
    found = {geom: read_field(model, geom) for geom in range(model.ngeom)}
    height_fields = {geom: field for geom, field in found.items() if field is not None}
    for pair in read_pairs(Fields(model)):
        both = [pair.one, pair.other]
        one, other = (named(model, "geom", number) for number in both)
        names = f"its geoms {one} and {other} can touch"
        kinds = [int(kind) for kind in model.geom_type[both]]
        field = height_fields.get(pair.one) if kinds[1] in ON_FIELDS else None
        if field is None and (kinds[0], kinds[1]) not in COLLIDERS:
            first, second = (word(mujoco.mjtGeom(kind).name) for kind in kinds)
            yield f"{names}: {_with_article(first)} and {_with_article(second)}"
        elif field is not None and (reason := _of_field(model, field, pair)):
            yield f"{names}: {reason}"
        elif not is_computable(pair.parameters.spring.impedance.power):
            yield f"{names}: its contact {_CURVE}"
        elif _is_thin_pyramid(model, pair):
            yield f"{names} with hardly any friction in a pyramidal cone: single precision cannot compute it"
        elif _is_rigid(model, pair, of_ends):
            yield f"{names}, but turn about the centres of their bodies: such contacts are rigid in MuJoCo"
        elif model.geom_adhesion[both].any() or model.geom_surfacevel[both].any():
            yield f"{names} with adhesion or a moving surface"
    for place in np.flatnonzero(model.pair_adhesion)[:1]:
        yield f"its pair {named(model, 'pair', int(place))} has adhesion"


def _of_field(model: mujoco.MjModel, field: HeightField, pair: Pair) -> str | None:
    """Why a geom cannot be on a height field."""
    if min(field.num_rows, field.num_columns) < 2:
        return "the height field has no cells"
    if len(field.heights) > MOST_HEIGHTS:
        return f"the height field has {len(field.heights):,} heights, more than {MOST_HEIGHTS:,}"
    reach = max(0.0, pair.parameters.reach)
    along, across = field.window(float(model.geom_rbound[pair.other]) + reach)
    if along * across > MOST_CELLS:
        return f"the geom can be over {along * across:,} cells of the height field, more than {MOST_CELLS}"
    return None


def _is_thin_pyramid(model: mujoco.MjModel, pair: Pair) -> bool:
    """Whether a pyramid's edges, stiffer than the contact by 1 / (2 · friction²), are too stiff."""
    friction = pair.parameters.friction
    is_pyramid = bool(friction) and model.opt.cone == mujoco.mjtCone.mjCONE_PYRAMIDAL
    return is_pyramid and bool(2.0 * _MOST_STIFFNESS * squared(friction[0]) < 1.0)


def _is_rigid(model: mujoco.MjModel, pair: Pair, of_ends: np.ndarray) -> bool:
    """Whether the geoms move by turning alone. MuJoCo makes contacts as stiff as the centres of mass are hard
    to move: those of bodies that turn about their centres are rigid. of_ends: see `_inverse_weights`."""
    both = [pair.one, pair.other]
    of_centres = model.body_invweight0[model.geom_bodyid[both], 0]
    return bool(_MOST_STIFFNESS * of_centres.sum() < of_ends[both].max())


def _inverse_weights(model: mujoco.MjModel) -> np.ndarray:
    """How easily each geom moves where it ends, [ngeom] in 1/kg: the mean of the three directions, as in
    MuJoCo's `body_invweight0`. 0: it never moves."""
    found, data = np.zeros(model.ngeom), mujoco.MjData(model)
    # Not `mj_forward`: the world of a user's model may have thousands of geoms, which touch each other.
    for stage in (mujoco.mj_fwdKinematics, mujoco.mj_makeM, mujoco.mj_factorM):
        stage(model, data)
    for geom in np.flatnonzero(model.body_treeid[model.geom_bodyid] >= 0):
        axes = data.geom_xmat[geom].reshape(3, 3)
        middle, half = model.geom_aabb[geom].reshape(2, 3)
        for end in [*np.diag(half), *np.diag(-half)]:
            rows = np.zeros((2, 3, model.nv))
            point = data.geom_xpos[geom] + axes @ (middle + end)
            mujoco.mj_jac(model, data, rows[0], None, point, int(model.geom_bodyid[geom]))
            mujoco.mj_solveM(model, data, rows[1], rows[0])
            found[geom] = max(found[geom], np.vdot(*rows) / 3.0)
    return found


def _with_article(word: str) -> str:
    return f"an {word}" if word[0] in "aeiou" else f"a {word}"


def _rest(model: mujoco.MjModel, nconmax: int | None) -> str | None:
    if model.opt.disableflags & (_DISABLE.mjDSBL_CONTACT | _DISABLE.mjDSBL_CONSTRAINT):
        return None
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_collision(model, data)
    if data.ncon <= (nconmax or MOST_SLOTS):
        return None
    most = f"{MOST_SLOTS}" if nconmax is None else f"its `nconmax` of {nconmax}"
    return f"its geoms touch at {data.ncon:,} points where it begins, more than {most}"


_CHECKS: Sequence[Callable[[mujoco.MjModel], Iterator[str]]] = (
    _options, _combinations, _parts, _equalities, _joints, _tendons, _actuators, _contacts,
)  # fmt: skip
_CURVE = "has a `solimp` whose power is not a multiple of a half"


def _uncomputable(solimp: np.ndarray) -> np.ndarray:
    """[n]: where the stages have no operation for the curve of a `solimp` [n, 5]."""
    return np.array([not is_computable(power) for power in solimp[:, 4]], bool)
