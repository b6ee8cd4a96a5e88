"""Checks on a login node: whether `gaitway cluster slurm` could keep workers with these options."""

import shutil
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from core.errors import Misconfigured
from core.jobs.slots import SlotKind
from gaitway.service.doctor.check import Check
from worker.cluster.checks import NodeGroup, groups, refusal, what_is_wrong
from worker.cluster.launcher import SchedulerAway
from worker.cluster.main import Site
from worker.cluster.options import SlurmOptions, Tunnel
from worker.cluster.probe import READY
from worker.cluster.slurm import ask, last_words, name_of

_PROGRAMS = ("sbatch", "squeue", "scancel", "sinfo")
_NODE_WITHIN_S = 120.0
_SSH_WITHIN_S = 20.0


def examine_slurm(options: SlurmOptions, data: Path, folder: Path, *, on_node: bool) -> Iterator[Check]:
    """Each finding as soon as it is made. on_node: also run a job of each kind on a node."""
    lacking = [name for name in _PROGRAMS if shutil.which(name) is None]
    if lacking:
        remedy = "Run this on a login node of the cluster, or add Slurm's folder to PATH."
        yield Check("slurm", "fail", f"{lacking[0]} is not installed here, or not in PATH", remedy)
        return
    try:
        version, seen = ask(("sbatch", "--version")).stdout.strip(), groups()
    except SchedulerAway as error:
        yield Check(
            "slurm", "fail", f"the controller does not answer: {error}", "Ask those who run the cluster."
        )
        return
    yield Check("slurm", "pass", f"{version}; {len({one.partition for one in seen})} partitions")
    try:
        site = Site(options, data, folder)
    except Misconfigured as error:
        yield Check("stores", "fail", error.detail, "Start `gaitway up --workers 0`, or correct the option.")
        return
    yield _way(site.options.tunnel, site.object_store, on_node=on_node)
    for kind in options.kinds:
        check = _kind(kind, options, seen, site)
        yield check
        if on_node and check.state == "pass":
            yield _node(kind, site, folder)


def _way(tunnel: Tunnel | str | None, store: str, *, on_node: bool) -> Check:
    """How nodes reach the stores. Where no node tries it, ssh is tried from here."""
    if not isinstance(tunnel, Tunnel):
        return Check("stores", "pass", "nodes reach them themselves")
    wrong = None if on_node else _refused(tunnel, store)
    if wrong is None:
        return Check("stores", "pass", f"nodes reach them by ssh to {tunnel.host}")
    remedy = (
        'docs/clusters.md, "How nodes reach the stores", makes a key with which ssh asks nothing; `--node` '
        "tries it from a node."
    )
    return Check("stores", "fail", f"ssh to {tunnel.host} fails from here: {wrong}", remedy)


def _refused(tunnel: Tunnel, store: str) -> str | None:
    """Why ssh does not forward to this HOST:PORT, in its own words; None if it does."""
    host, _, port = store.partition(":")
    words = ["ssh", *tunnel.ssh, "-W", f"{host}:{port or 80}", tunnel.destination]
    try:
        run = subprocess.run(
            words,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=_SSH_WITHIN_S,
            check=False,
        )
    except FileNotFoundError:
        return "ssh is not installed."
    except subprocess.TimeoutExpired:
        return f"no answer within {_SSH_WITHIN_S:.0f} s."
    if run.returncode == 0:
        return None
    return next(reversed(run.stderr.strip().splitlines()), f"exit status {run.returncode}")


def _kind(kind: SlotKind, options: SlurmOptions, seen: list[NodeGroup], site: Site) -> Check:
    name = f"workers ({name_of(kind)})"
    wrong = what_is_wrong(kind, options.part(kind), seen)
    if wrong is not None:
        return Check(name, "fail", wrong, "`sinfo` shows what there is; correct the option at this place.")
    try:
        wrong = refusal(kind, site.script)
    except SchedulerAway as error:
        return Check(name, "warn", f"not tried: {error}")
    if wrong is not None:
        remedy = "`sacctmgr show assoc user=$USER` lists the accounts and QoS that you may use."
        return Check(name, "fail", wrong, remedy)
    return Check(name, "pass", f"partition {options.part(kind).partition or 'by default'} takes them")


def _node(kind: SlotKind, site: Site, folder: Path) -> Check:
    name = f"a node ({name_of(kind)})"
    script = site.script(kind, "gaitway-doctor", (), module="worker.cluster.probe")
    job = ask(("sbatch", "--parsable"), script).stdout.strip().partition(";")[0]
    if not job.isdigit():
        return Check(name, "fail", "Slurm refused the job of this check")
    state = _wait(lambda: ask(("squeue", "--noheader", f"--jobs={job}", "--format=%T|%r")).stdout.strip())
    if state:
        ask(("scancel", job))
        reason = state.partition("|")[2]
        return Check(
            name, "warn", f"no node was free within {_NODE_WITHIN_S:.0f} s ({reason})", "Try again later."
        )
    log = folder.absolute() / "logs" / f"{job}.log"
    words = last_words(log)
    if words.startswith(READY):
        return Check(name, "pass", words)
    if not words:
        remedy = f"Name a folder that all nodes see: --folder; now it is {folder.absolute()}."
        return Check(name, "fail", f"job {job} left no output here", remedy)
    return Check(name, "fail", words, f"See docs/clusters.md; the job's whole output is {log}.")


def _wait(state: Callable[[], str]) -> str:
    """The state until it is empty: the job has ended."""
    deadline = time.monotonic() + _NODE_WITHIN_S
    while (now := state()) and time.monotonic() < deadline:
        time.sleep(1.0)
    return now
