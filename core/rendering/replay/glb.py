"""Writes binary glTF 2.0: numbers in one buffer, the rest as JSON.

Source: Khronos, glTF 2.0 specification, https://registry.khronos.org/glTF/specs/2.0/.
"""

import json
import struct
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

_COMPONENT_TYPES = {"uint8": 5121, "uint16": 5123, "uint32": 5125, "float32": 5126}
_SHAPES = {(): "SCALAR", (2,): "VEC2", (3,): "VEC3", (4,): "VEC4", (4, 4): "MAT4"}
_VERTICES, _INDICES = 34962, 34963
_JSON, _BINARY = 0x4E4F534A, 0x004E4942


@dataclass
class Glb:
    """A glTF that grows; each `add_…` returns the index by which others refer to what it added."""

    document: dict[str, Any] = field(default_factory=dict[str, Any])
    _buffer: bytearray = field(default_factory=bytearray)

    def add(self, kind: str, **entry: Any) -> int:
        """Add an entry to `nodes`, `meshes`, `materials`, … ; fields that are None are left out."""
        entries = self.document.setdefault(kind, [])
        entries.append({name: value for name, value in entry.items() if value is not None})
        return len(entries) - 1

    def add_array(self, values: NDArray[Any], *, target: int | None = None) -> int:
        """An accessor for [N, …]; a type of numbers that glTF lacks raises KeyError."""
        view = self.add_bytes(np.ascontiguousarray(values).tobytes(), target=target)
        bounds: dict[str, Any] = {}
        if values.ndim == 2 and len(values):  # Required of positions.
            bounds = {"min": values.min(axis=0).tolist(), "max": values.max(axis=0).tolist()}
        return self.add(
            "accessors",
            bufferView=view,
            componentType=_COMPONENT_TYPES[values.dtype.name],
            count=len(values),
            type=_SHAPES[values.shape[1:]],
            **bounds,
        )

    def add_vertices(self, values: NDArray[Any]) -> int:
        """An accessor for one number, or several, of each vertex [V, …]."""
        return self.add_array(values, target=_VERTICES)

    def add_indices(self, faces: NDArray[Any]) -> int:
        """An accessor for triangles [F, 3]."""
        kind = np.uint16 if faces.max(initial=0) < 2**16 - 1 else np.uint32
        return self.add_array(faces.ravel().astype(kind), target=_INDICES)

    def add_bytes(self, content: bytes, *, target: int | None = None) -> int:
        """A view of the buffer."""
        self._buffer += b"\0" * (-len(self._buffer) % 4)
        self._buffer += content
        start = len(self._buffer) - len(content)
        return self.add("bufferViews", buffer=0, byteOffset=start, byteLength=len(content), target=target)

    def to_bytes(self) -> bytes:
        """The file."""
        binary = bytes(self._buffer) + b"\0" * (-len(self._buffer) % 4)
        document = {"asset": {"version": "2.0", "generator": "gaitway"}, **self.document}
        text = json.dumps(
            document | {"buffers": [{"byteLength": len(binary)}]}, separators=(",", ":")
        ).encode()
        text += b" " * (-len(text) % 4)
        chunks = b"".join(
            struct.pack("<II", len(content), kind) + content
            for kind, content in ((_JSON, text), (_BINARY, binary))
        )
        return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks
