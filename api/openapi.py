"""The OpenAPI document: FastAPI's own, with the schemas of jobs and of problems, and examples of sweeps."""

import json
from collections.abc import Iterator
from dataclasses import dataclass, fields
from functools import cache
from typing import Any, Literal, cast

from fastapi import FastAPI, Response
from fastapi.encoders import jsonable_encoder
from fastapi.openapi.utils import get_openapi
from pydantic import TypeAdapter

from api.problems import MEDIA_TYPE, ProblemView
from api.submissions import RESUMPTION
from core.accounts.principal import Role, TokenScope
from core.bounds import LARGEST_JOB_BYTES
from core.environments.info import Device
from core.jobs.job import ArtifactRole, JobPhase
from core.jobs.quotas import QuotaKind
from core.jobs.spec import JOB_SPEC, Priority
from core.jobs.status import JobStatus
from core.jobs.workers import WorkerState
from core.news.webhook import DeliveryStatus, WhichJobs
from core.physics.availability import EngineName
from core.reasons import Reason
from core.settings import ApiSettings
from core.start_up import give_back_memory
from core.sweeps.spec import SWEEP_SPEC
from core.sweeps.sweep import SweepStatus
from core.uploads.record import UploadStatus
from core.user_models.record import Description

_REF = "#/components/schemas/{model}"
# What `gaitway.schema` names without defining it. Those that are classes become components.
_VALUES: dict[str, Any] = {
    "ArtifactRole": ArtifactRole,
    "DeliveryStatus": DeliveryStatus,
    "Description": Description,
    "Device": Device,
    "EngineName": EngineName,
    "JobPhase": JobPhase,
    "JobStatus": JobStatus,
    "UploadStatus": UploadStatus,
    "PreviewStatus": Literal["ready", "drawing"],
    "Priority": Priority,
    "QuotaKind": QuotaKind,
    "Reason": Reason,
    "Role": Role,
    "SweepStatus": SweepStatus,
    "TokenScope": TokenScope,
    "WhichJobs": WhichJobs,
    "WorkerState": WorkerState,
}
_PROBLEM = {"content": {MEDIA_TYPE: {"schema": {"$ref": _REF.format(model="Problem")}}}}
EXAMPLES: dict[str, Any] = {
    "a grid": {
        "value": {
            "name": "learning rates",
            "job": {"kind": "train", "environment": "ant"},
            "method": "grid",
            "parameters": {
                "seed": [1, 2],
                "algorithm.learning_rate": {"low": 1e-4, "high": 1e-3, "log": True, "points": 3},
            },
        }
    },
    "Optuna's TPE, which ends what is not promising": {
        "value": {
            "job": {
                "kind": "train",
                "environment": "ant",
                "algorithm": {"kind": "ppo", "num_timesteps": 1_000_000},
                "video": None,
            },
            "method": "tpe",
            "parameters": {
                "algorithm.learning_rate": {"low": 1e-5, "high": 1e-2, "log": True},
                "algorithm.discounting": {"low": 0.9, "high": 0.999},
                "algorithm.unroll_length": {"low": 5, "high": 20, "step": 5},
            },
            "objective": {"metric": "eval/episode_reward", "direction": "maximize"},
            "budget": {"jobs": 20, "parallel": 2},
            "pruning": {"kind": "median", "startup_trials": 5},
        }
    },
    "population-based training": {
        "value": {
            "job": {
                "kind": "train",
                "environment": "ant",
                "algorithm": {"kind": "ppo", "num_timesteps": 20_000_000},
                "resources": {"accelerator": "gpu"},
                "video": None,
            },
            "method": "pbt",
            "parameters": {
                "algorithm.learning_rate": {"low": 1e-5, "high": 1e-2, "log": True},
                "algorithm.entropy_cost": {"low": 1e-4, "high": 1e-1, "log": True},
            },
            "population": {"size": 8, "generations": 5},
            "budget": {"parallel": 8},
        }
    },
}


def describe(app: FastAPI) -> dict[str, Any]:
    """The document, built at each call."""
    limits = _limits(app)
    document = get_openapi(
        title=app.title, version=app.version, description=app.description, routes=app.routes
    )
    schemas = document.setdefault("components", {}).setdefault("schemas", {})
    for name in ("HTTPValidationError", "ValidationError"):
        schemas.pop(name, None)
    for name, kind in (("JobSpec", JOB_SPEC), ("SweepSpec", SWEEP_SPEC), ("Resumption", RESUMPTION)):
        schema = kind.json_schema(ref_template=_REF)
        schemas.update({**schema.pop("$defs"), name: schema})
    for name, most in (("JobSpec", LARGEST_JOB_BYTES), ("SweepSpec", limits.max_body_bytes)):
        schemas[name]["x-maxBytes"] = most
    _define_values(schemas)
    schemas["Problem"] = ProblemView.model_json_schema(ref_template=_REF)
    schemas.update(schemas["Problem"].pop("$defs", {}))
    _require_tags(schemas)
    for path in document["paths"].values():
        for operation in path.values():
            _define_parts(operation, schemas)
            _bound_body(operation, limits)
            _answer_with_problems(operation["responses"])
    return document


def serve(app: FastAPI) -> None:
    """Answer `/openapi.json`: built in a thread, since it takes most of a second, and kept as bytes alone."""

    @cache
    def document() -> bytes:
        text = json.dumps(app.openapi(), ensure_ascii=False, separators=(",", ":")).encode()
        give_back_memory()  # The document's parts took 6 MiB.
        return text

    @app.get("/openapi.json", include_in_schema=False)
    def openapi() -> Response:
        return Response(document(), media_type="application/json")


@dataclass(frozen=True)
class _Limits:
    """Bytes of a body. The operator may have set others than the defaults."""

    max_body_bytes: int
    max_model_bytes: int
    max_clips_bytes: int
    max_import_bytes: int


def _limits(app: FastAPI) -> _Limits:
    service = getattr(app.state, "service", None)
    if service is not None:
        return _Limits(*(getattr(service.settings, one.name) for one in fields(_Limits)))
    return _Limits(*(ApiSettings.model_fields[one.name].default for one in fields(_Limits)))


def _define_parts(operation: dict[str, Any], schemas: dict[str, Any]) -> None:
    """Make components of the documents that a body is made of."""
    for said in operation.get("requestBody", {}).get("content", {}).values():
        for name, schema in said["schema"].pop("$defs", {}).items():
            schemas.setdefault(name, schema)


def _bound_body(operation: dict[str, Any], limits: _Limits) -> None:
    """Say how long the body may be: `maxLength` of bytes that are sent as they are, else `x-maxBytes`."""
    content: dict[str, Any] = operation.get("requestBody", {}).get("content", {})
    tags = operation.get("tags", ())
    most = limits.max_import_bytes if "sharing" in tags else limits.max_model_bytes
    if "clips" in tags:
        most = limits.max_clips_bytes
    for media_type, said in content.items():
        if media_type.endswith("json"):
            operation["requestBody"]["x-maxBytes"] = limits.max_body_bytes
        else:
            said["schema"]["maxLength"] = most


def _answer_with_problems(responses: dict[str, Any]) -> None:
    if "application/json" in responses.get("422", {}).get("content", {}):
        responses["422"] = {"description": "A parameter is not valid", **_PROBLEM}
    responses["default"] = {"description": "Any other refusal", **_PROBLEM}


def _define_values(schemas: dict[str, Any]) -> None:
    """Replace each `x-values` by the service's type of that name."""
    for node in list(_nodes(schemas)):
        if (name := node.pop("x-values", None)) is None:
            continue
        schema = TypeAdapter(_VALUES[name]).json_schema(ref_template=_REF, mode="serialization")
        schema = jsonable_encoder(schema, exclude_none=True)  # as FastAPI writes its own
        schemas.update(schema.pop("$defs", {}))
        if isinstance(_VALUES[name], type):
            schemas[name] = schema
            node.pop("type", None)
            node.pop("title", None)
            node["$ref"] = _REF.format(model=name)
        else:
            node.update(schema)


def _require_tags(schemas: dict[str, Any]) -> None:
    """Make the discriminator of each union required, although each member has a default for it.

    Only PPO's stays optional: an algorithm without `kind` is PPO.
    """
    for node in _nodes(schemas):
        union = node.get("discriminator", {})
        for reference in union.get("mapping", {}).values():
            member = schemas[reference.rpartition("/")[2]]
            if member is not schemas["PPOSpec"]:
                member["required"] = sorted({*member.get("required", ()), union["propertyName"]})


def _nodes(schemas: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """All objects in these schemas."""
    waiting: list[Any] = list(schemas.values())
    while waiting:
        node = waiting.pop()
        if isinstance(node, dict):
            found = cast("dict[str, Any]", node)
            yield found
            waiting += found.values()
        elif isinstance(node, list):
            waiting += cast("list[Any]", node)
