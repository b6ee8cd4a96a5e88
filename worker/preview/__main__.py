"""`python -m worker.preview FOLDER`: draw what `request.json` in the folder asks for.

Writes PNGs and exits with 0, or writes `failure.json` and exits with another status. Its caller sets
MUJOCO_GL: a process in which one back-end failed cannot try another.
"""

import sys
from pathlib import Path

from core.errors import GaitwayError
from core.previews.record import PreviewRequest
from core.rendering.gl import context_works
from core.rendering.request import FailureReason, RenderFailure
from worker.confinement.own_files import keep_to_own_files
from worker.host.processes import die_with_parent


def main() -> int:
    folder = Path(sys.argv[1])
    keep_to_own_files(folder)
    die_with_parent()

    def refuse(reason: FailureReason, message: str) -> int:
        failure = RenderFailure(reason=reason, message=message)
        (folder / "failure.json").write_text(failure.model_dump_json())
        return 1

    try:
        context_works()
    except Exception as error:  # Whatever GL raises means the same to our caller.
        return refuse("no_gl", f"{type(error).__name__}: {error}")
    # Imported here: only a process with working GL needs all of it.
    from worker.preview.stills import draw

    try:
        draw(PreviewRequest.model_validate_json((folder / "request.json").read_bytes()), folder)
    except GaitwayError as error:
        return refuse("bad_request", error.detail)
    return 0


if __name__ == "__main__":
    sys.exit(main())
