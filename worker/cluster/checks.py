"""Checks of a site's options by Slurm itself, before anything is started."""

import re
from collections.abc import Sequence
from dataclasses import dataclass

from core.jobs.slots import SlotKind
from worker.cluster.launcher import SchedulerAway
from worker.cluster.options import GpuPart, Part, SlurmOptions, seconds_of
from worker.cluster.slurm import Script, ask, name_of, sentence

_FORMAT = "%P|%a|%D|%G|%c|%m|%l"


@dataclass(frozen=True)
class NodeGroup:
    """Equal nodes of a partition, as sinfo lists them. gpus: of each; memory: MiB; limit_s: None without."""

    partition: str
    is_default: bool
    is_up: bool
    nodes: int
    gpus: int
    cpus: int
    memory_mib: int
    limit_s: float | None


def groups() -> list[NodeGroup]:
    """The partitions that this user sees. Raises Misconfigured without sinfo, and SchedulerAway."""
    answer = ask(("sinfo", "--noheader", f"--format={_FORMAT}"))
    if answer.returncode != 0:
        raise SchedulerAway(sentence(answer.stderr))
    return [_group(line) for line in answer.stdout.splitlines() if line.count("|") == 6]


def problems(options: SlurmOptions, script: Script) -> list[str]:
    """A sentence for each thing that cannot work, with its place in the options. Raises as `groups`."""
    found, seen = list[str](), groups()
    for kind in options.kinds:
        wrong = what_is_wrong(kind, options.part(kind), seen)
        if wrong is None:
            wrong = refusal(kind, script)
        if wrong is not None:
            found.append(wrong)
    return found


def refusal(kind: SlotKind, script: Script) -> str | None:
    """A sentence if Slurm would refuse it: account, QoS and the limits of the site are known to it alone."""
    asked = ask(("sbatch", "--test-only"), script(kind, "gaitway-test", ()))
    if asked.returncode == 0:
        return None
    return f"/{kind.accelerator}: Slurm refuses a job for {name_of(kind)}: {sentence(asked.stderr)}"


def what_is_wrong(kind: SlotKind, part: Part, seen: Sequence[NodeGroup]) -> str | None:
    """A sentence if no node of the part's partition can hold an allocation of this kind."""
    at = f"/{kind.accelerator}"
    name = part.partition
    here = [one for one in seen if (one.partition == name if name else one.is_default)]
    if not here:
        names = ", ".join(sorted({one.partition for one in seen})) or "none that you may use"
        said = f"there is no partition {name!r}" if name else "there is no default partition; name one"
        return f"{at}/partition: {said}. Slurm has {names}."
    name = here[0].partition
    if not any(one.is_up for one in here):
        return f"{at}/partition: {name} is down: Slurm takes no jobs there now."
    if kind.hosts > sum(one.nodes for one in here):
        return (
            f"{at}: {kind.hosts} hosts are wanted, and partition {name} has {sum(one.nodes for one in here)}."
        )
    if isinstance(part, GpuPart) and kind.gpus > (most := max(one.gpus for one in here)):
        has = f"at most {most}" if most else "none (`sinfo -o %G` shows no gpu)"
        return f"{at}/gpus: {kind.gpus} GPUs of one node are wanted; a node of partition {name} has {has}."
    number = kind.gpus if isinstance(part, GpuPart) else 1
    if part.cpus * number > (most := max(one.cpus for one in here)):
        return f"{at}/cpus: {part.cpus * number} cores are wanted; a node of partition {name} has {most}."
    if part.mem_mib * number > (most := max(one.memory_mib for one in here)):
        return f"{at}/mem: {part.mem_mib * number} MiB are wanted; a node of partition {name} has {most}."
    limits = [one.limit_s for one in here]
    if part.time_s is not None and None not in limits and part.time_s > max(one or 0 for one in limits):
        return f"{at}/time: {part.time} is more than partition {name} allows."
    return None


def _group(line: str) -> NodeGroup:
    partition, availability, nodes, gres, cpus, memory, limit = line.split("|")
    # Several types: gpu:a100:4(S:0-1),gpu:h100:2
    gpus = [int(number) for number in re.findall(r"\bgpu:(?:[^:,(]+:)?(\d+)", gres)]
    is_limited = re.fullmatch(r"(\d+-)?\d+(:\d+){0,2}", limit) is not None
    return NodeGroup(
        partition.rstrip("*"),
        partition.endswith("*"),
        availability == "up",
        int(nodes),
        sum(gpus),
        _number(cpus),
        _number(memory),
        seconds_of(limit) if is_limited else None,
    )


def _number(text: str) -> int:
    """Of `16` or, for nodes that differ, `16+`."""
    found = re.match(r"\d+", text)
    return int(found[0]) if found else 0
