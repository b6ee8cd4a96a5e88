"""A run of Weights & Biases."""

import tarfile
from pathlib import Path
from typing import Any, Literal

import wandb

from worker.tracking.items import About, Configured, End, Row, VideoFile

# How long the server may take to accept a run.
_OPEN_S = 30.0
# The horizontal axis: environment steps, by the name that Brax gives them to its progress function.
_STEP = "num_steps"


def open_run(about: About, mode: Literal["online", "offline"]) -> Any:
    """The job's run: a new one, or the one that an earlier attempt began. Raises what wandb raises.

    Nothing is sent about this machine, its packages or its code.
    """
    settings = wandb.Settings(
        console="off",
        silent=True,
        disable_git=True,
        disable_code=True,
        save_code=False,
        init_timeout=_OPEN_S,
        login_timeout=_OPEN_S,
        x_disable_stats=True,
        x_disable_meta=True,
        x_disable_machine_info=True,
        x_save_requirements=False,
    )
    run = wandb.init(
        project=about.project,
        entity=about.entity,
        name=about.name,
        id=about.job_id,
        resume="allow",
        mode=mode,
        dir=str(about.folder),
        config=about.config,
        settings=settings,
    )
    # A resumed run begins before the last step that was sent, so it cannot use W&B's own step.
    run.define_metric(_STEP)
    run.define_metric("*", step_metric=_STEP)
    return run


def log_item(run: Any, item: Configured | Row | VideoFile | End) -> None:
    """Log one item."""
    match item:
        case Configured(values=values):
            run.config.update(values, allow_val_change=True)
        case Row(step=step, values=values):
            run.log({_STEP: step, **values})
        case VideoFile(step=step, path=path):
            run.log({_STEP: step, path.stem.partition("-")[0]: wandb.Video(str(path), format="mp4")})
        case End(exit_code=exit_code):
            run.finish(exit_code=exit_code)


def archive(folder: Path, path: Path) -> None:
    """Write the folder's one offline run, which must have ended, as a tar file for `wandb sync`.

    wandb's own logs are left out.
    """
    # `Run.finish` may return before the run's file is written: under load, 2 of 38 files were still empty.
    wandb.teardown()
    (run,) = (folder / "wandb").glob("offline-run-*")
    with tarfile.open(path, "w") as file:
        for part in [*run.glob("*.wandb"), run / "files"]:
            if part.exists():
                file.add(part, f"{run.name}/{part.name}", filter=_of_nobody)


def _of_nobody(entry: tarfile.TarInfo) -> tarfile.TarInfo:
    entry.uid = entry.gid = 0
    entry.uname = entry.gname = ""
    return entry
