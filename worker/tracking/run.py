"""A run of Weights & Biases."""

import os
import tarfile
from contextlib import chdir
from pathlib import Path
from typing import Any, Literal

import wandb

from core.algorithms.events import metric_of_seed
from worker.tracking.items import NAMES, About, Configured, EndItem, Item, MetricsItem, PolicyItem, VideoItem

# How long the server may take to accept a run.
_OPEN_S = 30.0
# Where a run's folder keeps its policy, beside wandb's own files.
_POLICY_FOLDER = "policy"
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


def log_item(run: Any, item: Item) -> None:
    """Log one item. Raises what wandb raises."""
    match item:
        case Configured(values=values):
            run.config.update(values, allow_val_change=True)
        case MetricsItem(step=step, values=values):
            run.log({_STEP: step, **values})
        case VideoItem(step=step, path=path, seed=seed):
            name = path.stem.partition("-")[0]
            name = name if seed is None else metric_of_seed(seed, name)
            run.log({_STEP: step, name: wandb.Video(str(path), format="mp4")})
        case PolicyItem():
            log_policy(run, item, item.path)
        case EndItem(exit_code=exit_code):
            run.finish(exit_code=exit_code)


def log_policy(run: Any, policy: PolicyItem, path: Path) -> None:
    """Log the file as the run's model, or that of one of its seeds; returns when the server has it.

    The path is recorded relative to the working directory, in which `wandb sync` later looks for it.
    """
    names = {name: run.config[name] for name in NAMES if name in run.config}
    suffix = "" if policy.seed is None else f"-seed-{policy.seed}"
    about = {**names, _STEP: policy.step}
    model = wandb.Artifact(f"policy-{run.id}{suffix}", type="model", metadata=about)
    model.add_file(os.path.relpath(path), name="policy", policy="immutable", skip_cache=True)
    logged = run.log_artifact(model)
    if not run.offline:
        logged.wait()


def log_archived_policy(run: Any, policy: PolicyItem) -> None:
    """Log the policy of an offline run, and move it into the run's folder.

    Its path is recorded from the folder's parent, which is where users will unpack the archive.
    """
    run_folder = Path(run.dir).parent
    kept = run_folder / _POLICY_FOLDER / policy.path.name
    kept.parent.mkdir(exist_ok=True)
    policy.path.rename(kept)
    with chdir(run_folder.parent):
        log_policy(run, policy, kept)


def archive(folder: Path, path: Path) -> None:
    """Write the folder's one offline run, which must have ended, as a tar file for `wandb sync`.

    wandb's own logs are left out.
    """
    # `Run.finish` may return before the run's file is written: under load, 2 of 38 files were still empty.
    wandb.teardown()
    (run,) = (folder / "wandb").glob("offline-run-*")
    with tarfile.open(path, "w") as file:
        for part in [*run.glob("*.wandb"), run / "files", run / _POLICY_FOLDER]:
            if part.exists():
                file.add(part, f"{run.name}/{part.name}", filter=_of_nobody)


def _of_nobody(entry: tarfile.TarInfo) -> tarfile.TarInfo:
    entry.uid = entry.gid = 0
    entry.uname = entry.gname = ""
    return entry
