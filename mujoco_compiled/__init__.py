"""MuJoCo's physics as code made for one body, for thousands of environments under JAX.

    m = put_model(mujoco.MjModel.from_xml_path("body.xml"), nstep=5, derived=("xpos",))
    d = jax.vmap(lambda qpos: make_data(m).replace(qpos=qpos))(many_qpos)
    d = jax.jit(jax.vmap(step, in_axes=(None, 0)))(m, d)

The names below are all there is for users. What each needs, JAX or MuJoCo alone, is loaded when it is used.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mujoco_compiled.code.host_call import host_call
    from mujoco_compiled.code.kept_code import keep_code
    from mujoco_compiled.constraints.pairs import meshes_left_out, pairs_of_geoms
    from mujoco_compiled.coverage import Uncovered, left_out, uncovered, uncovered_own
    from mujoco_compiled.data import Data, forward, make_data, put_data, step
    from mujoco_compiled.fields import GEOMETRY, MODEL_FIELDS, model_field
    from mujoco_compiled.model import Model, put_model
    from mujoco_compiled.readings.derived import DERIVED_FIELDS
    from mujoco_compiled.readings.sensor_coverage import unread_sensors
    from mujoco_compiled.smooth.delays import ordered_history

_WHERE = {
    "code.host_call": ("host_call",),
    "code.kept_code": ("keep_code",),
    "constraints.pairs": ("meshes_left_out", "pairs_of_geoms"),
    "coverage": ("Uncovered", "left_out", "uncovered", "uncovered_own"),
    "data": ("Data", "forward", "make_data", "put_data", "step"),
    "fields": ("GEOMETRY", "MODEL_FIELDS", "model_field"),
    "model": ("Model", "put_model"),
    "readings.derived": ("DERIVED_FIELDS",),
    "readings.sensor_coverage": ("unread_sensors",),
    "smooth.delays": ("ordered_history",),
}
_MODULE_OF = {name: module for module, names in _WHERE.items() for name in names}
__all__ = [
    "DERIVED_FIELDS",
    "GEOMETRY",
    "MODEL_FIELDS",
    "Data",
    "Model",
    "Uncovered",
    "forward",
    "host_call",
    "keep_code",
    "left_out",
    "make_data",
    "meshes_left_out",
    "model_field",
    "ordered_history",
    "pairs_of_geoms",
    "put_data",
    "put_model",
    "step",
    "uncovered",
    "uncovered_own",
    "unread_sensors",
]


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULE_OF[name]}"), name)
