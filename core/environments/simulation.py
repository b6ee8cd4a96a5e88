"""The data with which a program steps an environment's body by MuJoCo alone, as the page does (docs/push.md).

It is a model, and data: which of MuJoCo's numbers are observed, how an action becomes a control, how an
episode begins and ends. An environment states them; tests show that they give its own observation.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Any
from xml.etree import ElementTree

import mujoco

from core.environments.numbers import Ends, Noise, NotSimulated, Numbers

FORMAT, VERSION = "gaitway-simulation", 1
# The options of a model that an engine may change.
_SOLVER = ("solver", "iterations", "ls_iterations", "disableflags")
# The page's MuJoCo, the newest that npm has. It does not know these attributes of this process's MuJoCo.
PAGE_VERSION = "3.14"
_NEWER = {
    ("body", "fuse"),
    ("elasticity", "section"),
    ("elasticity", "sectionsize"),
    ("insidesite", "enclosed"),
}
# In 3.14 only these take inputs of several kinds; what `input` says of other actuators moves nothing.
_INPUT_GAINS = {
    int(kind)
    for kind in (mujoco.mjtGain.mjGAIN_PID, mujoco.mjtGain.mjGAIN_DCMOTOR, mujoco.mjtGain.mjGAIN_SO3)
}
_INPUTS = {1: "pos", 2: "vel", 4: "ff", 8: "voltage"}


@dataclass(frozen=True)
class Simulation:
    """A body, ready to be stepped.

    model: XML, with the solver settings of the engine that trained. control_offset, control_gain [nu]: a
    control is offset + gain · action, for num_substeps of the time step. qpos [nq]: where episodes begin;
    qvel [nv], act [na]: how, where they do not begin at rest.
    obstacles: where each begins and ends in x and the y of the way past it, by their ends. sight: what is
    farther ahead is said to be that far, and straight on. Both in m.
    """

    model: str
    num_substeps: int
    tracked_body: int
    control_offset: Sequence[float]
    control_gain: Sequence[float]
    observation: Sequence[Numbers]
    qpos: Sequence[float]
    noise: Noise
    ends: Sequence[Ends] = field(default_factory=tuple)
    qvel: Sequence[float] = field(default_factory=tuple)
    act: Sequence[float] = field(default_factory=tuple)
    obstacles: Sequence[Sequence[float]] = field(default_factory=tuple)
    sight: float | None = None

    def document(self) -> dict[str, Any]:
        """As JSON, with numbers that are plain Python's."""
        about = {"format": FORMAT, "version": VERSION, "mujoco": mujoco.mj_versionString()}
        return {**about, **asdict(self)}


def as_xml(spec: mujoco.MjSpec, stepped: mujoco.MjModel) -> str:
    """The spec as XML that the page's MuJoCo reads, under the solver settings of `stepped` and without skins
    and textures, which move nothing. Raises NotSimulated if it needs files, or what the page lacks."""
    _strip_looks(spec)
    if files := [one.file for one in (*spec.meshes, *spec.hfields) if one.file]:
        raise NotSimulated(
            f"its model is more than one file (it has {files[0]}), and the page reads only one"
        )
    model = spec.compile()
    before = {name: getattr(spec.option, name) for name in _SOLVER}
    try:
        for name in _SOLVER:
            setattr(spec.option, name, getattr(stepped.opt, name))
        return _as_the_page_reads_it(spec.to_xml(), model)
    finally:
        for name, value in before.items():
            setattr(spec.option, name, value)


def _as_the_page_reads_it(text: str, model: mujoco.MjModel) -> str:
    """The XML without what is new since the page's MuJoCo, where that changes nothing."""
    root = ElementTree.fromstring(text)  # noqa: S314 MuJoCo wrote it
    for element in root.iter():
        if new := sorted(name for tag, name in _NEWER if tag == element.tag and name in element.attrib):
            raise NotSimulated(
                f"its model has the attribute {new[0]} of {element.tag}, which is newer than MuJoCo "
                f"{PAGE_VERSION}, which the page has"
            )
        if element.tag == "plugin" and "plugin" in element.attrib:
            raise NotSimulated(f"its model uses the plugin {element.get('plugin')}, which the page lacks")
        if element.tag == "general":
            element.attrib.pop("input", None)
    for number, element in enumerate(root.findall("actuator/*")):
        if int(model.actuator_gaintype[number]) in _INPUT_GAINS:
            taken = [word for bit, word in _INPUTS.items() if model.actuator_ctrlspec[number] & bit]
            element.set("input", " ".join(taken) or "none")
    return ElementTree.tostring(root, encoding="unicode")


def _strip_looks(spec: mujoco.MjSpec) -> None:
    """Remove skins and textures, which may be files."""
    for material in spec.materials:
        for role in range(len(material.textures)):
            material.textures[role] = ""
    for one in [*spec.skins, *spec.textures]:
        spec.delete(one)
