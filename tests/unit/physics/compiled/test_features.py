"""Features as files of real robots have them: each moves as in C MuJoCo.

Each file of the folder has one feature in use. Machine code in single precision is set down
in 50 of C MuJoCo's states, half of them after a fall, under random controls, and compared after 0.04 s
(`core.physics.trial`). Measured: half of the tries differ by 3e-6 of the motion at most, nine of ten by 8e-6.
"""

import mujoco
import pytest

from core.physics.compiled import CompiledEngine
from core.physics.trial import compare, record
from mujoco_compiled.coverage import uncovered
from mujoco_compiled.tests.bodies import FEATURES
from tests.extra import extra

DEFAULT = ("closed_leg", "condim_6", "imu", "servos")
NAMES = sorted(file.stem for file in FEATURES.iterdir())


@pytest.mark.parametrize("name", [*DEFAULT, *extra(*(name for name in NAMES if name not in DEFAULT))])
def test_a_feature_moves_as_in_mujoco(name: str) -> None:
    model = mujoco.MjModel.from_xml_path(str(FEATURES / f"{name}.xml"))
    derived = ("sensordata",) if model.nsensor else ()
    assert uncovered(model, derived) is None
    reference = record(model)
    assert reference is not None
    found = compare(CompiledEngine(model, reference.num_substeps, derived), reference)
    assert (found.broken, found.half < 1e-5, found.most < 1e-4) == (0, True, True), found
