"""HDF5 of dm_control's motion capture (`dm_control.locomotion.mocap`): a group a clip."""

from collections.abc import Mapping
from typing import Any

from core.clips.formats import hdf5
from core.clips.formats.recording import Recording, number, numbers
from core.errors import BadClips

NAME = "dm_control"
# The joints of dm_control's humanoid of the CMU data in the file's order; the file has no names.
_CMU = """
    lfemurrz lfemurry lfemurrx ltibiarx lfootrz lfootrx ltoesrx rfemurrz rfemurry rfemurrx rtibiarx
    rfootrz rfootrx rtoesrx lowerbackrz lowerbackry lowerbackrx upperbackrz upperbackry upperbackrx
    thoraxrz thoraxry thoraxrx lowerneckrz lowerneckry lowerneckrx upperneckrz upperneckry
    upperneckrx headrz headry headrx lclaviclerz lclaviclery lhumerusrz lhumerusry lhumerusrx
    lradiusrx lwristry lhandrz lhandrx lfingersrx lthumbrz lthumbrx rclaviclerz rclaviclery
    rhumerusrz rhumerusry rhumerusrx rradiusrx rwristry rhandrz rhandrx rfingersrx rthumbrz rthumbrx
"""


def is_one(file: Mapping[str, Any]) -> bool:
    return any(not hdf5.is_array(member) and "walkers" in member for member in file.values())


def recordings(file: Mapping[str, Any]) -> list[Recording]:
    """A clip a group, of its first walker; arrays have a column a frame. Raises BadClips."""
    groups = {name: group for name, group in file.items() if not hdf5.is_array(group) and "walkers" in group}
    return [_recording(name, group) for name, group in sorted(groups.items())]


def _recording(name: str, group: Any) -> Recording:
    walkers = hdf5.members(hdf5.members(group).get("walkers", {}))
    if "walker_0" not in walkers:
        raise BadClips(f"The clip {name!r} has no `walkers/walker_0`.")
    walker = hdf5.members(walkers["walker_0"])
    columns = {part: _columns(walker, part, name) for part in ("position", "quaternion", "joints")}
    joints, names = columns["joints"], tuple(_CMU.split())
    dt = number(group.attrs["dt"], "dt") if "dt" in group.attrs else 0.0
    return Recording(
        name=name,
        joint_positions=joints,
        root_position=columns["position"],
        root_orientation=columns["quaternion"],
        joints=names if joints.shape[1] == len(names) else None,
        rate=1 / dt if dt > 0 else None,
    )


def _columns(walker: Mapping[str, Any], part: str, clip: str) -> Any:
    if part not in walker:
        raise BadClips(f"The clip {clip!r} has no `walkers/walker_0/{part}`.")
    return numbers(hdf5.read(walker[part], part), part).T
