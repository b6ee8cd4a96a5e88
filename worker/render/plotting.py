"""The process that plots numbers, so that no other process loads matplotlib.

`python -m worker.render.plotting path TRAJECTORY.npz PICTURE.png TITLE`
`python -m worker.render.plotting tables TABLES.npz FOLDER TITLE`: a file per picture; prints their names.
"""

import signal
import sys
from collections.abc import Sequence
from pathlib import Path

from worker.host.processes import die_with_parent


def main(arguments: Sequence[str]) -> int:
    die_with_parent()
    # A signal to the whole group is meant for the parent, which may still want these pictures.
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    match arguments:
        case ["path", numbers, picture, title]:
            draw_path(Path(numbers), Path(picture), title)
        case ["tables", numbers, folder, title]:
            draw_tables(Path(numbers), Path(folder), title)
        case _:
            return 2
    return 0


def draw_path(numbers: Path, picture: Path, title: str) -> None:
    from core.environments import trajectory
    from core.rendering.plots.path import Walk, path_from_above
    from core.rendering.plots.style import save

    episodes = trajectory.load(numbers).episodes
    walks = [Walk(one.time, one.position, one.terminated, one.target) for one in episodes]
    save(path_from_above(walks, title=title), picture)


def draw_tables(numbers: Path, folder: Path, title: str) -> None:
    import numpy as np

    from core.rendering.plots.style import save
    from core.rendering.plots.tables import pictures

    with np.load(numbers, allow_pickle=False) as tables:
        for name, figure in pictures(dict(tables), title=title).items():
            save(figure, folder / f"{name}.png")
            sys.stdout.write(f"{name}.png\n")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
