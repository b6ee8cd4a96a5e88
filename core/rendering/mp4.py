"""H.264 in an MP4 that a browser plays while it loads, written frame by frame."""

import os
from fractions import Fraction
from pathlib import Path
from types import TracebackType
from typing import Self

import av
import numpy as np
from numpy.typing import NDArray

CODEC = "h264"
# With one thread, the bytes depend only on the frames; `veryfast` encodes faster than a software GL draws.
_OPTIONS = {"preset": "veryfast", "crf": "21", "threads": "1"}


class Mp4Writer:
    """A video that appears under its name once it is complete, or not at all.

    width, height: pixels, both even (yuv420p halves the colour's resolution). One key frame a second.
    """

    def __init__(self, path: Path, *, width: int, height: int, fps: int) -> None:
        self._path = path
        self._part = partial(path)
        self._container = av.open(str(self._part), "w", format="mp4", options={"movflags": "+faststart"})
        self._stream = self._container.add_stream("libx264", rate=fps, options=_OPTIONS)
        self._stream.width, self._stream.height = width, height
        self._stream.pix_fmt = "yuv420p"
        self._stream.codec_context.gop_size = fps
        self._tick = Fraction(1, fps)
        self._num_frames = 0

    def write(self, frame: NDArray[np.uint8]) -> None:
        """Append RGB [height, width, 3]."""
        picture = av.VideoFrame.from_ndarray(frame, format="rgb24")
        picture.pts = self._num_frames
        picture.time_base = self._tick
        self._num_frames += 1
        self._container.mux(self._stream.encode(picture))

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is not None:
            self._container.close()
            self._part.unlink(missing_ok=True)
            return
        self._container.mux(self._stream.encode(None))
        self._container.close()
        os.replace(self._part, self._path)


def write_png(path: Path, frame: NDArray[np.uint8]) -> None:
    """Store RGB [height, width, 3] as a PNG, complete or not at all."""
    part = partial(path)
    part.write_bytes(png_bytes(frame))
    os.replace(part, path)


def png_bytes(frame: NDArray[np.uint8]) -> bytes:
    """RGB [height, width, 3] as a PNG."""
    height, width, _ = frame.shape
    encoder = av.VideoCodecContext.create("png", "w")
    encoder.width, encoder.height = width, height
    encoder.pix_fmt = "rgb24"
    encoder.time_base = Fraction(1, 1)
    packets = [*encoder.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")), *encoder.encode(None)]
    return b"".join(bytes(packet) for packet in packets)


def partial(path: Path) -> Path:
    """The file to write before the rename: in the same folder, so that the rename is atomic."""
    return path.with_name(f".{path.name}.{os.getpid()}.part")
