"""Bodies that several tests take: those of the wheel `brax`, and small files."""

from importlib.util import find_spec
from pathlib import Path

import mujoco

# Models that have one feature each, as files of real robots have it.
FEATURES = Path(__file__).parent / "features"


def brax_model(name: str) -> mujoco.MjModel:
    """The model `<name>.xml`, with the masses of its geoms; bodies without joints are fused, as Brax does."""
    brax = find_spec("brax")  # Importing it would load all of its environments.
    assert brax is not None
    assert brax.origin is not None
    spec = mujoco.MjSpec.from_file(str(Path(brax.origin).parent / "envs" / "assets" / f"{name}.xml"))
    spec.compiler.fusestatic = True
    spec.compiler.settotalmass = -1  # It is deprecated.
    return spec.compile()
