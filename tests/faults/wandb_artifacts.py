"""The artifacts of the Weights & Biases server of the smallest size."""

import json
from dataclasses import dataclass, field
from typing import Any


@dataclass
class WandbArtifacts:
    """created: what each artifact was said to be, by its number; whole: the numbers of the complete ones.

    Their files are uploaded as `artifacts/<number>/<name>`.
    """

    url: str
    created: list[dict[str, Any]] = field(default_factory=list[dict[str, Any]])
    whole: set[int] = field(default_factory=set[int])

    def answer(self, operation: str, variables: dict[str, Any]) -> dict[str, Any] | None:
        """The data that answers a GraphQL operation of this name; None if it is about something else."""
        match operation:
            case "CreateArtifact":
                return {"createArtifact": {"artifact": self._create(variables)}}
            case "CreateArtifactManifest":
                manifest = {"id": "m", "file": self._file(variables["artifactID"], variables["name"])}
                return {"createArtifactManifest": {"artifactManifest": manifest}}
            case "CreateArtifactFiles":
                edges = [self._edge(wanted) for wanted in variables["input"]["artifactFiles"]]
                return {"createArtifactFiles": {"files": {"edges": edges}}}
            case "CommitArtifact":
                self.whole.add(int(variables["artifactID"]))
                return {"commitArtifact": {"artifact": {"id": variables["artifactID"], "digest": "d"}}}
            case "ArtifactByID":
                return {"artifact": self._described(int(variables["id"]))}
            case _:
                return None

    def _create(self, variables: dict[str, Any]) -> dict[str, Any]:
        self.created.append(variables["input"])
        number = str(len(self.created) - 1)
        return {"id": number, "state": "PENDING", "artifactSequence": {"latestArtifact": None}}

    def _file(self, number: str, name: str) -> dict[str, Any]:
        url = f"{self.url}/upload/artifacts/{number}/{name}"
        return {"id": name, "uploadUrl": url, "uploadHeaders": []}

    def _edge(self, wanted: dict[str, Any]) -> dict[str, Any]:
        number = wanted["artifactID"]
        node = self._file(number, wanted["name"])
        return {
            "node": {**node, "storagePath": None, "uploadMultipartUrls": None, "artifact": {"id": number}}
        }

    def _described(self, number: int) -> dict[str, Any]:
        said = self.created[number]
        project = {"id": "p", "internalId": "p", "name": said["projectName"], "entity": {"name": "me"}}
        collection = {"__typename": "ArtifactSequence", "name": said["artifactCollectionName"]}
        absent = ("description", "historyStep", "digestAlgorithm", "commitHash", "updatedAt")
        return {
            **dict.fromkeys(absent),
            "__typename": "Artifact",
            "id": str(number),
            "artifactSequence": {**collection, "project": project},
            "versionIndex": number,
            "artifactType": {"name": said["artifactTypeName"]},
            "metadata": json.dumps({}),
            "ttlDurationSeconds": -2,
            "ttlIsInherited": True,
            "tags": [],
            "aliases": [],
            "state": "COMMITTED" if number in self.whole else "PENDING",
            "size": 1,
            "digest": said["digest"],
            "fileCount": 1,
            "createdAt": "2026-11-21T12:00:00Z",
        }
