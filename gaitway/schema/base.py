"""The base of all documents, and the words whose values the service's own types define."""

from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, WithJsonSchema

FINAL_STATUSES = frozenset({"succeeded", "failed", "cancelled"})


def _as_written(schema: dict[str, Any]) -> None:
    """Describe a document as the service writes it: with every member, and no others."""
    schema["required"] = list(schema.get("properties", ()))
    schema.pop("additionalProperties", None)
    for member in schema.get("properties", {}).values():
        member.pop("default", None)


class View(BaseModel):
    """A document of the service, as a frozen value."""

    model_config = ConfigDict(
        frozen=True, extra="ignore", from_attributes=True, json_schema_extra=_as_written
    )


def _defined_as(name: str, kind: str = "string") -> WithJsonSchema:
    """`api.openapi` puts the service's type of this name there; a client takes other values, too."""
    return WithJsonSchema({"type": kind, "x-values": name})


ArtifactRole = Annotated[str, _defined_as("ArtifactRole")]
DeliveryStatus = Annotated[str, _defined_as("DeliveryStatus")]
Device = Annotated[str, _defined_as("Device")]
EngineName = Annotated[str, _defined_as("EngineName")]
JobPhase = Annotated[str, _defined_as("JobPhase")]
JobStatus = Annotated[str, _defined_as("JobStatus")]
ModelContents = Annotated[dict[str, Any], _defined_as("Description", "object")]
UploadStatus = Annotated[str, _defined_as("UploadStatus")]
PreviewStatus = Annotated[str, _defined_as("PreviewStatus")]
Priority = Annotated[str, _defined_as("Priority")]
QuotaKind = Annotated[str, _defined_as("QuotaKind")]
Reason = Annotated[str, _defined_as("Reason")]
Role = Annotated[str, _defined_as("Role")]
SweepStatus = Annotated[str, _defined_as("SweepStatus")]
TokenScope = Annotated[str, _defined_as("TokenScope")]
WhichJobs = Annotated[str, _defined_as("WhichJobs")]
WorkerState = Annotated[str, _defined_as("WorkerState")]
