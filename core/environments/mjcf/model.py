"""From a model's file to a specification whose parts have names."""

import tempfile
from collections import Counter
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import Any

import mujoco

from core.environments.mjcf.archive import examine
from core.environments.task_model import sentence
from core.environments.terms.describe import JOINT_TYPES
from core.errors import BadModel, JobFailed
from core.reasons import Reason

SLEEP_IS_OFF = (
    "It lets what rests sleep (`<flag sleep>`). Jobs switch that off: who sleeps is not part of an "
    "environment's state."
)
# A scene of more unnamed parts of a kind leaves the others without names.
_MOST_NAMED = 1000


@contextmanager
def read(file: Path) -> Generator[tuple[mujoco.MjSpec, str]]:
    """The specification in an uploaded file, and the document that it is from; inside the context,
    compilation finds its meshes.

    Raises JobFailed("bad_model"), with MuJoCo's own message, if MuJoCo cannot read it.
    """
    try:
        archive = examine(file.read_bytes())
    except BadModel as error:
        raise JobFailed(Reason.BAD_MODEL, error.detail) from None
    with tempfile.TemporaryDirectory(prefix=".model-", dir=file.parent) as folder:
        main = archive.unpack(Path(folder))
        try:
            spec = mujoco.MjSpec.from_file(str(main))
        except (ValueError, mujoco.FatalError) as error:
            raise JobFailed(Reason.BAD_MODEL, sentence(error, folder)) from None
        # Files may reserve gigabytes for contacts; -1 lets MuJoCo allocate what it needs.
        spec.nconmax = spec.njmax = -1
        if archive.is_urdf:
            _add_motors(spec)
        name_parts(spec)
        yield spec, archive.main


def is_to_sleep(spec: mujoco.MjSpec) -> bool:
    """Whether the model, before it is compiled, lets what rests sleep."""
    return bool(spec.option.enableflags & mujoco.mjtEnableBit.mjENBL_SLEEP)


def name_parts(spec: mujoco.MjSpec) -> None:
    """Name bodies, joints and geoms that have no name, so that terms and randomization can name them.

    Joints and geoms are called by their body: `trunk free`, `trunk geom`, `trunk geom 2`.
    """
    parts: list[tuple[Sequence[Any], Callable[[Any], str]]] = [
        (spec.bodies, lambda _: "body"),
        (spec.joints, lambda joint: f"{joint.parent.name} {JOINT_TYPES[joint.type]}"),
        (spec.geoms, lambda geom: f"{geom.parent.name} geom"),
    ]
    for found, called in parts:
        known, num_known = {part.name for part in found}, Counter[str]()
        for part in islice((part for part in found if not part.name), _MOST_NAMED):
            wanted = name = called(part)
            while name in known:
                num_known[wanted] += 1
                name = f"{wanted} {num_known[wanted] + 1}"
            part.name = name
            known.add(name)


def _add_motors(spec: mujoco.MjSpec) -> None:
    """Give each joint a motor: URDF has no actuators, but joints with a greatest effort."""
    for joint in spec.joints:
        if joint.actfrcrange[1] > 0:
            spec.add_actuator(
                name=joint.name,
                target=joint.name,
                trntype=mujoco.mjtTrn.mjTRN_JOINT,
                gear=[joint.actfrcrange[1], 0, 0, 0, 0, 0],
                ctrllimited=True,
                ctrlrange=[-1, 1],
            )
