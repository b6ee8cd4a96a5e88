"""Random trees of bodies, as MJCF: what `coverage.uncovered` lets pass, and a little of what it refuses."""

from collections.abc import Mapping, Sequence
from typing import Any
from xml.etree import ElementTree

from hypothesis import strategies as st

MOST_BODIES = 6
# Which geoms touch: all of them the floor, and those that are round all others, which boxes do not.
_FLOOR, _ROUND, _BOX = ({"contype": a, "conaffinity": b} for a, b in ((1, 0), (2, 3), (0, 3)))
_SCALAR = ("hinge", "slide")
# Time constants and damping ratios, and a stiffness with a damping.
_SOLREFS = ("0.02 1", "0.01 0.7", "0.001 1", "-3000 -40")
# All of one power but one: between two powers there are others, of which many are refused.
_SOLIMPS = ("0.9 0.95 0.001 0.5 2", "0.8 0.9 0.01 0.3 2", "0.5 0.5 0 0.5 2")
_CURVES = (*_SOLIMPS, "0.9 0.99 0.05 0.6 3.5", "0.9 0.99 0.05 0.6 1")
_FLAGS = ("eulerdamp", "filterparent", "warmstart", "limit", "spring", "damper", "gravity", "clampctrl")

Attributes = Mapping[str, Any]


@st.composite
def models(draw: st.DrawFn) -> str:
    """An MJCF document."""
    root = ElementTree.Element("mujoco")
    _add(root, "compiler", {"autolimits": "true"})
    option = _add(root, "option", draw(_options()))
    for name in draw(st.lists(st.sampled_from(_FLAGS), max_size=1)):
        _add(option, "flag", {name: "disable"})
    world = _add(root, "worldbody", {})
    _add(world, "geom", {"type": "plane", "size": "5 5 1", **_FLOOR, **draw(_surfaces())})
    bodies, joints = [world], dict[str, str]()
    for number in range(draw(st.sampled_from([4, 1, 2, 3, 5, MOST_BODIES]))):
        parent = draw(st.sampled_from(bodies))
        is_root = parent is world
        body = _add(parent, "body", draw(_places(0.6 if is_root else 0.0)))
        bodies.append(body)
        kinds = draw(_kinds(is_root=is_root, is_first=number == 0))
        for place, kind in enumerate(kinds):
            joints[f"{kind} {number} {place}"] = kind
            _add(body, "joint", {"name": f"{kind} {number} {place}", "type": kind, **draw(_joints(kind))})
        for _ in range(draw(st.integers(1, 2))):
            _add(body, "geom", draw(_geoms()))
    _pull(draw, root, joints)
    return ElementTree.tostring(root, encoding="unicode")


def _pull(draw: st.DrawFn, root: ElementTree.Element, joints: Mapping[str, str]) -> None:
    """Fixed tendons and actuators."""
    scalar = [name for name, kind in joints.items() if kind in _SCALAR]
    tendons = list[str]()
    if scalar:
        section = _add(root, "tendon", {})
        for number in range(draw(st.integers(0, 2))):
            tendons.append(f"tendon {number}")
            tendon = _add(section, "fixed", {"name": tendons[-1], **draw(_tendons())})
            for joint in draw(st.lists(st.sampled_from(scalar), min_size=1, max_size=3, unique=True)):
                _add(tendon, "joint", {"joint": joint, "coef": draw(_numbers(0.3, 2.0, signed=True))})
    section = _add(root, "actuator", {})
    for _ in range(draw(st.integers(0, 4))):
        on_tendon = bool(tendons) and draw(st.booleans())
        target = draw(st.sampled_from(tendons if on_tendon else list(joints)))
        turns = not on_tendon and joints[target] not in _SCALAR
        kind, attributes = draw(_actuators(turns=turns))
        _add(section, kind, {"tendon" if on_tendon else "joint": target, **attributes})


def _add(parent: ElementTree.Element, tag: str, attributes: Attributes) -> ElementTree.Element:
    written = {name: _written(value) for name, value in attributes.items() if value is not None}
    return ElementTree.SubElement(parent, tag, written)


def _written(value: Any) -> str:
    return value if isinstance(value, str) else " ".join(f"{x:g}" for x in _sequence(value))


def _sequence(value: Any) -> Sequence[float]:
    return value if isinstance(value, Sequence) else [value]


@st.composite
def _numbers(draw: st.DrawFn, low: float, high: float, *, signed: bool = False) -> float:
    """Of four digits, which an example shows."""
    share = draw(st.integers(0, 1000)) / 1000.0
    return (low + share * (high - low)) * (draw(st.sampled_from([1.0, -1.0])) if signed else 1.0)


def _vectors(size: int, most: float) -> st.SearchStrategy[list[float]]:
    return st.lists(_numbers(0.0, most, signed=True), min_size=size, max_size=size)


def _maybe(strategy: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
    return st.none() | strategy


def _attributes(**kinds: st.SearchStrategy[Any]) -> st.SearchStrategy[dict[str, Any]]:
    return st.fixed_dictionaries(kinds)


def _options() -> st.SearchStrategy[dict[str, Any]]:
    # A fluid and a free body without joints are covered with Euler alone, so it is more frequent.
    return _attributes(
        timestep=st.sampled_from([0.002, 0.005]),
        integrator=st.sampled_from(["Euler", "Euler", "implicitfast"]),
        cone=st.sampled_from(["pyramidal", "elliptic"]),
        impratio=st.sampled_from([1.0, 3.0]),
        gravity=st.sampled_from(["0 0 -9.81", "1 -2 -5"]),
        density=st.sampled_from([None] * 5 + [100.0]),
    )


def _places(height: float) -> st.SearchStrategy[dict[str, Any]]:
    return _attributes(
        pos=_vectors(3, 0.3).map(lambda at: [at[0], at[1], at[2] + height]), euler=_vectors(3, 90.0)
    )


def _kinds(*, is_root: bool, is_first: bool) -> st.SearchStrategy[list[str]]:
    """Of a body's joints; the first body has one at least."""
    scalar = st.lists(st.sampled_from(["hinge", "slide"]), min_size=int(is_first), max_size=2)
    inner = scalar | st.sampled_from([["ball"], ["slide", "ball"]])
    return inner | st.just(["free"]) if is_root else inner


@st.composite
def _joints(draw: st.DrawFn, kind: str) -> dict[str, Any]:
    common = _attributes(damping=_maybe(_numbers(0.0, 1.0)), armature=_maybe(_numbers(0.0, 0.1)))
    found = draw(common) | draw(_attributes(stiffness=_maybe(_numbers(0.0, 20.0))))
    if kind == "free":
        return found
    found |= draw(_attributes(frictionloss=_maybe(_numbers(0.0, 1.0)), pos=_maybe(_vectors(3, 0.1))))
    found |= draw(_attributes(solreflimit=_solrefs(), solimplimit=_solimps(), solimpfriction=_solimps()))
    if kind == "ball":
        return found | draw(_attributes(range=_maybe(_numbers(10.0, 90.0).map(lambda most: [0.0, most]))))
    unit = 60.0 if kind == "hinge" else 0.3
    axis = _vectors(3, 1.0).map(lambda axis: [axis[0], axis[1], axis[2] + 1.5])
    return found | draw(
        _attributes(
            axis=axis,
            range=_maybe(_ranges(unit)),
            springref=_maybe(_numbers(0.0, unit)),
            margin=st.sampled_from([None, None, None, 0.01]),
        )
    )


def _geoms() -> st.SearchStrategy[dict[str, Any]]:
    return st.sampled_from(["sphere", "capsule", "box"]).flatmap(
        lambda kind: st.builds(
            lambda *several: {"type": kind} | {name: x for one in several for name, x in one.items()},
            st.just(_BOX if kind == "box" else _ROUND),
            _attributes(size=st.lists(_numbers(0.04, 0.2), min_size=3, max_size=3)),
            _attributes(pos=_vectors(3, 0.1), euler=_vectors(3, 90.0)),
            _surfaces(),
        )
    )


def _surfaces() -> st.SearchStrategy[dict[str, Any]]:
    """How a geom touches."""
    return _attributes(
        condim=st.sampled_from([1, 3, 3, 4, 6]),
        friction=st.sampled_from(["1 0.005 0.0001", "0.5 0.1 0.05", "0.1 0 0"]),
        solref=_solrefs(),
        solimp=_maybe(st.sampled_from(_SOLIMPS)),
        margin=st.sampled_from([None, None, 0.02]),
        gap=st.sampled_from([None, None, 0.01]),
        priority=st.sampled_from([0, 0, 1]),
        solmix=st.sampled_from([None, 0.0, 3.0]),
    )


def _tendons() -> st.SearchStrategy[dict[str, Any]]:
    return _attributes(
        stiffness=_maybe(_numbers(0.0, 20.0)),
        damping=_maybe(_numbers(0.0, 1.0)),
        armature=_maybe(_numbers(0.0, 0.1)),
        frictionloss=_maybe(_numbers(0.0, 1.0)),
        range=_maybe(_ranges(0.5)),
        springlength=_maybe(_ranges(0.2)),
        solreflimit=_solrefs(),
        solimplimit=_solimps(),
    )


@st.composite
def _actuators(draw: st.DrawFn, *, turns: bool) -> tuple[str, dict[str, Any]]:
    """turns: on a joint with several axes, which has no position."""
    by_position = [] if turns else ["position", "intvelocity"]
    kind = draw(st.sampled_from(["motor", "velocity", "filter", *by_position]))
    gear = draw(_vectors(3, 2.0)) if turns else draw(_numbers(0.3, 2.0, signed=True))
    bounds = {"gear": gear, "ctrlrange": draw(_maybe(_ranges(0.5))), "forcerange": draw(_maybe(_ranges(1.0)))}
    own = {
        "motor": _attributes(),
        "velocity": _attributes(kv=_numbers(0.1, 1.0)),
        "filter": _attributes(
            dyntype=st.sampled_from(["filter", "filterexact", "integrator"]),
            dynprm=_numbers(0.01, 0.1),
            gainprm=_numbers(0.5, 2.0),
            actearly=_maybe(st.just("true")),
        ),
        "position": _attributes(
            kp=_numbers(1.0, 20.0), kv=_maybe(_numbers(0.0, 1.0)), timeconst=_maybe(_numbers(0.01, 0.1))
        ),
        "intvelocity": _attributes(kp=_numbers(1.0, 20.0), actrange=_ranges(1.0)),
    }[kind]
    return "general" if kind == "filter" else kind, bounds | draw(own)


@st.composite
def _ranges(draw: st.DrawFn, most: float) -> list[float]:
    return [-draw(_numbers(0.2 * most, most)), draw(_numbers(0.2 * most, most))]


def _solrefs() -> st.SearchStrategy[str | None]:
    return _maybe(st.sampled_from(_SOLREFS))


def _solimps() -> st.SearchStrategy[str | None]:
    return _maybe(st.sampled_from(_CURVES))
