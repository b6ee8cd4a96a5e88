"""A model as XML that the page's MuJoCo reads: without looks and files, and without what is newer than it."""

from xml.etree import ElementTree

import mujoco

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


class NotSimulated(Exception):
    """The body cannot be stepped by its data alone. The sentence says why."""


def as_xml(spec: mujoco.MjSpec, stepped: mujoco.MjModel) -> str:
    """The spec as XML that the page's MuJoCo reads, under the solver settings of `stepped` and without skins,
    textures and meshes that touch nothing. Raises NotSimulated if it needs files, or what the page lacks.
    """
    spec = spec.copy()
    _strip_looks(spec)
    _strip_meshes(spec, stepped)
    if files := [one.file for one in (*spec.meshes, *spec.hfields) if one.file]:
        raise NotSimulated(
            f"its model is more than one file (a geom that touches others is the mesh {files[0]}), and the "
            "page reads only one"
        )
    model = spec.compile()
    for name in _SOLVER:
        setattr(spec.option, name, getattr(stepped.opt, name))
    return _as_the_page_reads_it(spec.to_xml(), model)


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


def _strip_meshes(spec: mujoco.MjSpec, model: mujoco.MjModel) -> None:
    """Remove meshes that touch nothing; the bodies keep their masses, and fitted geoms their sizes.

    model: what was compiled of the spec. Nothing is compiled here: a user's files may be gone.
    """
    # A number changes as soon as another part is deleted.
    shaped = [(geom, geom.id, geom.parent, geom.parent.id) for geom in spec.geoms if geom.meshname]
    for _, _, body, number in shaped:
        if not body.explicitinertial:
            body.mass, body.ipos = model.body_mass[number], model.body_ipos[number]
            body.iquat, body.inertia = model.body_iquat[number], model.body_inertia[number]
            body.explicitinertial = True
    kept: set[str] = set()
    for geom, number, _, _ in shaped:
        if geom.type != mujoco.mjtGeom.mjGEOM_MESH:
            geom.pos, geom.quat = model.geom_pos[number], model.geom_quat[number]
            geom.size, geom.meshname = model.geom_size[number], ""
        elif geom.contype or geom.conaffinity:
            kept.add(geom.meshname)
        else:
            spec.delete(geom)
    for mesh in [one for one in spec.meshes if one.name not in kept]:
        spec.delete(mesh)
