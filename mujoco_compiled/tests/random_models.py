"""Random trees of bodies, as MJCF: what `coverage.uncovered` lets pass, and a little of what it refuses.

They are drawn with `random.Random`, so a seed is the same model in every run. Hypothesis also draws constants
of the modules that are loaded, which differ from run to run.
"""

from collections.abc import Mapping, Sequence
from random import Random
from typing import Any
from xml.etree import ElementTree

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

Attributes = dict[str, Any]


def random_model(seed: int) -> str:
    """An MJCF document."""
    draw, root = Random(seed), ElementTree.Element("mujoco")
    _add(root, "compiler", {"autolimits": "true"})
    option = _add(root, "option", _options(draw))
    if _coin(draw):
        _add(option, "flag", {draw.choice(_FLAGS): "disable"})
    world = _add(root, "worldbody", {})
    _add(world, "geom", {"type": "plane", "size": "5 5 1", **_FLOOR, **_surface(draw)})
    joints = _add_bodies(draw, world)
    tendons = _add_tendons(draw, root, [name for name, kind in joints.items() if kind in _SCALAR])
    # What was added later draws for itself: so the models before stay what they were.
    tendons += _add_strings(Random(f"strings {seed}"), root)
    _add_actuators(draw, root, joints, tendons)
    _add_muscles(Random(f"muscles {seed}"), root, joints, tendons)
    _add_equalities(draw, root, [name for name, kind in joints.items() if kind in _SCALAR], tendons)
    return ElementTree.tostring(root, encoding="unicode")


def _add_bodies(draw: Random, world: ElementTree.Element) -> dict[str, str]:
    """The types of the bodies' joints by name."""
    bodies, joints = [world], dict[str, str]()
    for number in range(draw.choice([4, 1, 2, 3, 5, MOST_BODIES])):
        parent = draw.choice(bodies)
        is_root = parent is world
        body = _add(parent, "body", {"name": f"{number}"} | _place(draw, 0.6 if is_root else 0.0))
        bodies.append(body)
        for place, kind in enumerate(_kinds(draw, is_root=is_root, is_first=number == 0)):
            joints[f"{kind} {number} {place}"] = kind
            _add(body, "joint", {"name": f"{kind} {number} {place}", "type": kind, **_joint(draw, kind)})
        for _ in range(draw.randint(1, 2)):
            _add(body, "geom", _geom(draw))
    return joints


def _add_tendons(draw: Random, root: ElementTree.Element, joints: Sequence[str]) -> list[str]:
    """The names of the fixed tendons of these joints."""
    section, tendons = _add(root, "tendon", {}), list[str]()
    for number in range(draw.randint(0, 2) if joints else 0):
        tendons.append(f"tendon {number}")
        tendon = _add(section, "fixed", {"name": tendons[-1], **_tendon(draw)})
        for joint in draw.sample(joints, draw.randint(1, min(3, len(joints)))):
            _add(tendon, "joint", {"joint": joint, "coef": _number(draw, 0.3, 2.0, signed=True)})
    return tendons


def _add_strings(draw: Random, root: ElementTree.Element) -> list[str]:
    """The names of the spatial tendons through the bodies, of half of the models."""
    bodies, section = list(root.iter("body")), root.find("tendon")
    assert section is not None
    if _coin(draw) or len(bodies) < 2:
        return []
    for number, body in enumerate(bodies):
        _add(body, "site", {"name": f"site {number}", "pos": _vector(draw, 3, 0.3)})
        _add(body, "site", {"name": f"side {number}", "pos": [0.4, *_vector(draw, 2, 0.3)]})
        size = [_number(draw, 0.05, 0.2), 0.1]
        kind = draw.choice(["sphere", "cylinder"])
        untouchable = {"contype": 0, "conaffinity": 0, "mass": 0.1}
        _add(body, "geom", {"name": f"bend {number}", "type": kind, "size": size, **untouchable})
    names = [f"string {number}" for number in range(draw.randint(1, 2))]
    for name in names:
        tendon = _add(section, "spatial", {"name": name, **_tendon(draw), "armature": None})
        sites = draw.sample(range(len(bodies)), draw.randint(2, min(4, len(bodies))))
        for site, following in zip(sites, [*sites[1:], None], strict=True):
            _add(tendon, "site", {"site": f"site {site}"})
            if following is not None and _coin(draw):
                bend = draw.randrange(len(bodies))
                side = _maybe_one(draw, [f"side {bend}"])
                _add(tendon, "geom", {"geom": f"bend {bend}", "sidesite": side})
    return names


def _add_muscles(
    draw: Random, root: ElementTree.Element, joints: Mapping[str, str], tendons: Sequence[str]
) -> None:
    """To half of the models."""
    section = root.find("actuator")
    assert section is not None
    targets = [*(("tendon", name) for name in tendons)]
    targets += [("joint", name) for name, kind in joints.items() if kind in _SCALAR]
    for _ in range(draw.randint(1, 2) if targets and _coin(draw) else 0):
        on, target = draw.choice(targets)
        muscle = {
            "lengthrange": _range(draw, 0.8),
            "force": _number(draw, 1.0, 20.0),
            "timeconst": [_number(draw, 0.01, 0.05), _number(draw, 0.02, 0.1)],
            "tausmooth": _maybe_number(draw, 0.0, 0.5),
            "lmin": _maybe_number(draw, 0.2, 0.7),
            "vmax": _maybe_number(draw, 1.0, 8.0),
            "fvmax": _maybe_number(draw, 1.0, 1.6),
            "gear": _maybe_number(draw, -2.0, 2.0),
        }
        _add(section, "muscle", {on: target, **muscle})


def random_strings(draw: Random) -> str:
    """An MJCF document: strings round one sphere or cylinder, on either side of it and through it."""
    names, kind = ("still", "own", "far"), draw.choice(["sphere", "cylinder"])
    place = {name: {"name": name, "pos": _vector(draw, 3, 0.5)} for name in names}
    root = ElementTree.Element("mujoco")
    world, section = _add(root, "worldbody", {}), _add(root, "tendon", {})
    body = _add(world, "body", {})
    _add(body, "freejoint", {})
    size = [_number(draw, 0.03, 0.3), 0.2]
    at = {"pos": _vector(draw, 3, 0.1), "euler": _vector(draw, 3, 90.0)}
    _add(body, "geom", {"name": "bend", "type": kind, "size": size, **at})
    _add(body, "site", {"name": "side", "pos": _vector(draw, 3, draw.choice([0.1, 0.6]))})
    other = _add(body, "body", {})
    _add(other, "joint", {"type": "ball"})
    _add(other, "geom", {"size": 0.1})
    for parent, name in zip((world, body, other), names, strict=True):
        _add(parent, "site", place[name])
    for start, side in (("still", None), ("own", None), ("still", "side"), ("own", "side")):
        tendon = _add(section, "spatial", {})
        _add(tendon, "site", {"site": start})
        _add(tendon, "geom", {"geom": "bend", "sidesite": side})
        _add(tendon, "site", {"site": "far"})
    return ElementTree.tostring(root, encoding="unicode")


def _add_actuators(
    draw: Random, root: ElementTree.Element, joints: Mapping[str, str], tendons: Sequence[str]
) -> None:
    section = _add(root, "actuator", {})
    for _ in range(draw.randint(0, 4)):
        on_tendon = bool(tendons) and _coin(draw)
        target = draw.choice(tendons if on_tendon else list(joints))
        turns = not on_tendon and joints[target] not in _SCALAR
        kind, attributes = _actuator(draw, turns=turns)
        _add(section, kind, {"tendon" if on_tendon else "joint": target, **attributes})


def _add_equalities(
    draw: Random, root: ElementTree.Element, joints: Sequence[str], tendons: Sequence[str]
) -> None:
    """On half of the models. joints: those with one axis."""
    bodies, section = list(root.iter("body")), _add(root, "equality", {})
    for number in range(draw.choice([0, 0, 1, 2])):
        kind = draw.choice(
            ["connect", "weld", *(["joint"] if joints else []), *(["tendon"] if tendons else [])]
        )
        if kind in ("joint", "tendon"):
            several = joints if kind == "joint" else tendons
            names = draw.sample(several, draw.randint(1, min(2, len(several))))
            ends: Attributes = {f"{kind}{k + 1}": name for k, name in enumerate(names)}
            ends["polycoef"] = [
                _number(draw, -0.1, 0.1),
                _number(draw, 0.5, 2.0, signed=True),
                *_vector(draw, 3, 0.2),
            ]
        else:
            ends = _tied(draw, kind, bodies, number)
        _add(
            section, kind, ends | {"solref": _maybe_one(draw, _SOLREFS), "solimp": _maybe_one(draw, _CURVES)}
        )


def _tied(draw: Random, kind: str, bodies: Sequence[ElementTree.Element], number: int) -> Attributes:
    """Two sites, or two bodies, or one body and the world."""
    chosen = draw.sample(bodies, draw.randint(1, min(2, len(bodies))))
    scale = {"torquescale": _number(draw, 0.1, 2.0)} if kind == "weld" else {}
    if len(chosen) == 2 and _coin(draw):
        for place, body in enumerate(chosen):
            _add(body, "site", {"name": f"{number} {place}", **_place(draw, 0.0)})
        return scale | {f"site{k + 1}": f"{number} {k}" for k in range(2)}
    anchor = {"anchor": _vector(draw, 3, 0.2)} if kind == "connect" or _coin(draw) else {}
    return scale | anchor | {f"body{k + 1}": body.attrib["name"] for k, body in enumerate(chosen)}


def _add(parent: ElementTree.Element, tag: str, attributes: Attributes) -> ElementTree.Element:
    written = {name: _written(value) for name, value in attributes.items() if value is not None}
    return ElementTree.SubElement(parent, tag, written)


def _written(value: Any) -> str:
    return value if isinstance(value, str) else " ".join(f"{x:g}" for x in _sequence(value))


def _sequence(value: Any) -> Sequence[float]:
    return value if isinstance(value, Sequence) else [value]


def _coin(draw: Random) -> bool:
    return draw.random() < 0.5


def _number(draw: Random, low: float, high: float, *, signed: bool = False) -> float:
    """Of four digits, and now and then an end of its range, where laws can change."""
    share = draw.choice([0.0, 1.0]) if draw.random() < 0.05 else draw.randint(0, 1000) / 1000.0
    return (low + share * (high - low)) * (draw.choice([1.0, -1.0]) if signed else 1.0)


def _maybe_number(draw: Random, low: float, high: float) -> float | None:
    return _number(draw, low, high) if _coin(draw) else None


def _vector(draw: Random, size: int, most: float) -> list[float]:
    return [_number(draw, 0.0, most, signed=True) for _ in range(size)]


def _range(draw: Random, most: float) -> list[float]:
    return [-_number(draw, 0.2 * most, most), _number(draw, 0.2 * most, most)]


def _maybe_range(draw: Random, most: float) -> list[float] | None:
    return _range(draw, most) if _coin(draw) else None


def _maybe_one(draw: Random, several: Sequence[str]) -> str | None:
    return draw.choice(several) if _coin(draw) else None


def _options(draw: Random) -> Attributes:
    # A fluid is covered with Euler alone, so it is more frequent.
    return {
        "timestep": draw.choice([0.002, 0.005]),
        "integrator": draw.choice(["Euler", "Euler", "implicitfast"]),
        "cone": draw.choice(["pyramidal", "elliptic"]),
        "impratio": draw.choice([1.0, 3.0]),
        "gravity": draw.choice(["0 0 -9.81", "1 -2 -5"]),
        "density": draw.choice([None] * 5 + [100.0]),
    }


def _place(draw: Random, height: float) -> Attributes:
    at = _vector(draw, 3, 0.3)
    return {"pos": [at[0], at[1], at[2] + height], "euler": _vector(draw, 3, 90.0)}


def _kinds(draw: Random, *, is_root: bool, is_first: bool) -> list[str]:
    """Of a body's joints; the first body has one at least."""
    scalar = [draw.choice(_SCALAR) for _ in range(draw.randint(int(is_first), 2))]
    with_ball = draw.choice([["ball"], ["slide", "ball"]])
    return draw.choice([scalar, with_ball, ["free"]] if is_root else [scalar, with_ball])


def _joint(draw: Random, kind: str) -> Attributes:
    common = {
        "damping": _maybe_number(draw, 0.0, 1.0),
        "armature": _maybe_number(draw, 0.0, 0.1),
        "stiffness": _maybe_number(draw, 0.0, 20.0),
    }
    if kind == "free":
        return common
    inner = common | {
        "frictionloss": _maybe_number(draw, 0.0, 1.0),
        "pos": _vector(draw, 3, 0.1) if _coin(draw) else None,
        "solreflimit": _maybe_one(draw, _SOLREFS),
        "solimplimit": _maybe_one(draw, _CURVES),
        "solimpfriction": _maybe_one(draw, _CURVES),
    }
    if kind == "ball":
        return inner | {"range": [0.0, _number(draw, 10.0, 90.0)] if _coin(draw) else None}
    unit, axis = 60.0 if kind == "hinge" else 0.3, _vector(draw, 3, 1.0)
    return inner | {
        "axis": [axis[0], axis[1], axis[2] + 1.5],
        "range": _maybe_range(draw, unit),
        "springref": _maybe_number(draw, 0.0, unit),
        "margin": draw.choice([None, None, None, 0.01]),
    }


def _geom(draw: Random) -> Attributes:
    kind = draw.choice(["sphere", "capsule", "box"])
    return {
        "type": kind,
        **(_BOX if kind == "box" else _ROUND),
        "size": [_number(draw, 0.04, 0.2) for _ in range(3)],
        "pos": _vector(draw, 3, 0.1),
        "euler": _vector(draw, 3, 90.0),
        **_surface(draw),
    }


def _surface(draw: Random) -> Attributes:
    """How a geom touches."""
    return {
        "condim": draw.choice([1, 3, 3, 4, 6]),
        "friction": draw.choice(["1 0.005 0.0001", "0.5 0.1 0.05", "0.1 0 0"]),
        "solref": _maybe_one(draw, _SOLREFS),
        "solimp": _maybe_one(draw, _SOLIMPS),
        "margin": draw.choice([None, None, 0.02]),
        "gap": draw.choice([None, None, 0.01]),
        "priority": draw.choice([0, 0, 1]),
        "solmix": draw.choice([None, 0.0, 3.0]),
    }


def _tendon(draw: Random) -> Attributes:
    return {
        "stiffness": _maybe_number(draw, 0.0, 20.0),
        "damping": _maybe_number(draw, 0.0, 1.0),
        "armature": _maybe_number(draw, 0.0, 0.1),
        "frictionloss": _maybe_number(draw, 0.0, 1.0),
        "range": _maybe_range(draw, 0.5),
        "springlength": _maybe_range(draw, 0.2),
        "solreflimit": _maybe_one(draw, _SOLREFS),
        "solimplimit": _maybe_one(draw, _CURVES),
    }


def _actuator(draw: Random, *, turns: bool) -> tuple[str, Attributes]:
    """turns: on a joint with several axes, which has no position."""
    by_position = [] if turns else ["position", "intvelocity"]
    kind = draw.choice(["motor", "velocity", "filter", *by_position])
    gear = _vector(draw, 3, 2.0) if turns else _number(draw, 0.3, 2.0, signed=True)
    bounds = {"gear": gear, "ctrlrange": _maybe_range(draw, 0.5), "forcerange": _maybe_range(draw, 1.0)}
    return "general" if kind == "filter" else kind, bounds | _own_attributes(draw, kind)


def _own_attributes(draw: Random, kind: str) -> Attributes:
    """The attributes that an actuator of this kind alone has."""
    match kind:
        case "velocity":
            return {"kv": _number(draw, 0.1, 1.0)}
        case "filter":
            return {
                "dyntype": draw.choice(["filter", "filterexact", "integrator"]),
                "dynprm": _number(draw, 0.01, 0.1),
                "gainprm": _number(draw, 0.5, 2.0),
                "actearly": _maybe_one(draw, ["true"]),
            }
        case "position":
            return {
                "kp": _number(draw, 1.0, 20.0),
                "kv": _maybe_number(draw, 0.0, 1.0),
                "timeconst": _maybe_number(draw, 0.01, 0.1),
            }
        case "intvelocity":
            return {"kp": _number(draw, 1.0, 20.0), "actrange": _range(draw, 1.0)}
        case _:
            return {}
