"""The largest imports that the service accepts, one for each of their bounds."""

import hashlib
import json
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zipfile import ZIP_DEFLATED, ZIP_STORED, ZipFile, ZipInfo

from api.sharing.archive import LONGEST_DOCUMENT
from core.bounds import LARGEST_FACTS_BYTES, LONGEST_MESSAGE, LONGEST_NAME

_TIME = "2026-11-20T12:00:00Z"
_PIECE = 2**20
# Role and media type of the files that routes of their own serve.
_LARGE = (
    ("video", "video/mp4"),
    ("poster", "image/png"),
    ("policy", "application/octet-stream"),
    ("checkpoint", "application/octet-stream"),
    ("replay", "application/octet-stream"),
    ("scene", "model/gltf-binary"),
    ("simulation", "application/json"),
)


@dataclass(frozen=True)
class Import:
    """Numbers of what the export holds.

    is_long: the attempts tell as much as the record may hold. file_bytes: of the files of `_LARGE`, one of
    each role.
    """

    files: int = 1
    attempts: int = 1
    is_long: bool = False
    rows: int = 1
    names: int = 1
    lines: int = 1
    line_bytes: int = 20
    file_bytes: int = 0

    def write(self, path: Path, spec: dict[str, Any]) -> Path:
        """Write the export to this path; returns it. spec: of its job."""
        with ZipFile(path, "w", ZIP_DEFLATED, compresslevel=1) as archive:
            files = [self._file(archive, f"{number}.bin", 1) for number in range(self.files)]
            files += [
                {
                    **self._file(archive, name, self.file_bytes // len(_LARGE)),
                    "role": name,
                    "media_type": kind,
                }
                for name, kind in _LARGE
                if self.file_bytes
            ]
            archive.writestr("spec.json", json.dumps(spec))
            archive.writestr("job.json", self._record(spec, files))
            archive.writestr("versions.json", json.dumps({"service": {"gaitway": "1.0.0"}}))
            _write(archive, "metrics.jsonl", self._rows())
            _write(archive, "log.txt", (b"x" * self.line_bytes + b"\n" for _ in range(self.lines)))
            listed = [{"path": f"files/{f['name']}", "size": f["size"], "sha256": f["sha256"]} for f in files]
            archive.writestr("contents.json", json.dumps({"format": 1, "files": listed}))
        return path

    def _file(self, archive: ZipFile, name: str, size: int) -> dict[str, Any]:
        """A file of this size that does not compress."""
        digest = hashlib.sha256()
        with archive.open(_stored(f"files/{name}"), "w", force_zip64=True) as file:
            for at in range(0, size, _PIECE):
                piece = os.urandom(min(size - at, _PIECE))
                file.write(piece)
                digest.update(piece)
        kind = {"role": "picture", "media_type": "image/png", "step": 1}
        return {"name": name, **kind, "size": size, "sha256": digest.hexdigest()}

    def _record(self, spec: dict[str, Any], files: list[dict[str, Any]]) -> str:
        record = {
            **{"id": "019aa3c2f0b1-5be0c1d2e3", "spec": spec, "status": "succeeded", "reason": "completed"},
            **{"message": "m" * LONGEST_MESSAGE, "created_at": _TIME, "finished_at": _TIME},
            "artifacts": files,
        }
        attempts: list[dict[str, Any]] = [
            {"number": n + 1, "worker": "w" * LONGEST_NAME, "started_at": _TIME, "details": {}}
            for n in range(self.attempts)
        ]
        room = LONGEST_DOCUMENT - len(json.dumps({**record, "attempts": attempts})) - 100
        if self.is_long:
            for attempt in attempts:
                size = min(LARGEST_FACTS_BYTES - 100, room // self.attempts - 30)
                attempt["details"] = {"told": "d" * max(0, size)}
        return json.dumps({**record, "attempts": attempts})

    def _rows(self) -> Iterator[bytes]:
        for step in range(self.rows):
            values = {f"eval/metric_{number:04}": step / 7 + number for number in range(self.names)}
            yield json.dumps({"step": step, "time": _TIME, "values": values}).encode() + b"\n"


def _write(archive: ZipFile, name: str, pieces: Iterator[bytes]) -> None:
    with archive.open(name, "w", force_zip64=True) as file:
        for piece in pieces:
            file.write(piece)


def _stored(name: str) -> ZipInfo:
    info = ZipInfo(name)
    info.compress_type = ZIP_STORED
    return info
