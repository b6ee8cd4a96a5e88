"""How many workers the queue wants, by kind: the numbers from which a scaler starts and stops workers.

A slot is a worker's place for one job. Its kind is what a job asks of a worker: a device, and how many of it.

The rule of `any`: a job that asks for no particular device runs in a slot with one GPU as well as in one with
a CPU, so it must count in one of the two, or both would be started for it. A scaler names which: the kind
that it prefers among those that it can start (`counted_as`).
"""

import re
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import cast

from core.environments.info import Device
from core.jobs.queue import MODELS
from core.jobs.spec import Accelerator

# As `core.jobs.queue.queue_name` makes it.
_QUEUE = re.compile(r"gaitway-(?:hosts(\d+)-)?(any|cpu|gpu)(\d*)(?:-shared)?-(?:high|normal|low)")


@dataclass(frozen=True, order=True)
class SlotKind:
    """accelerator: `any` is one GPU or a CPU. gpus: of each host; 0 unless it is `gpu`."""

    accelerator: Accelerator
    gpus: int = 0
    hosts: int = 1


ANY, CPU, GPU = SlotKind("any"), SlotKind("cpu"), SlotKind("gpu", 1)


@dataclass(frozen=True)
class QueueCount:
    """A queue's jobs. queued: those that may begin now. running: those that a worker holds.

    queue: None where an older version wrote the rows. oldest_queued_s: for how long the oldest of the queued
    has waited since its submission, or since its last attempt ended; None if none waits.
    """

    queue: str | None
    queued: int
    running: int
    oldest_queued_s: float | None


@dataclass(frozen=True)
class WantedSlots:
    """The jobs of a kind, as in `QueueCount`."""

    kind: SlotKind
    queued: int
    running: int
    oldest_queued_s: float | None


@cache
def kind_of_queue(name: str | None) -> SlotKind:
    """The kind of slot whose workers serve this queue."""
    match = _QUEUE.fullmatch(name or "")
    if (
        match is None
    ):  # Models, which every worker but those of several GPUs reads; or an older version's row.
        return ANY
    hosts, accelerator = int(match[1] or 1), cast("Accelerator", match[2])
    return SlotKind(accelerator, int(match[3] or 1) // hosts if accelerator == "gpu" else 0, hosts)


def wanted_slots(counts: Iterable[QueueCount]) -> list[WantedSlots]:
    """The counts of all queues by kind, in the order of kinds.

    Users' models that wait for a worker to read them count as one job of the kind `any`, however many they
    are: one worker reads them all within seconds.
    """
    by_kind = defaultdict[SlotKind, list[QueueCount]](list)
    for count in counts:
        if count.queue == MODELS and count.queued:
            count = replace(count, queued=1)
        by_kind[kind_of_queue(count.queue)].append(count)
    return [_together(kind, by_kind[kind]) for kind in sorted(by_kind)]


def counted_as(wanted: Sequence[WantedSlots], device: Device) -> list[WantedSlots]:
    """The same with the jobs of the kind `any` among those of one GPU or of a CPU."""
    by_kind = defaultdict[SlotKind, list[WantedSlots]](list)
    for slots in wanted:
        kind = (GPU if device == "gpu" else CPU) if slots.kind == ANY else slots.kind
        by_kind[kind].append(slots)
    return [_together(kind, by_kind[kind]) for kind in sorted(by_kind)]


def _together(kind: SlotKind, parts: Sequence[QueueCount | WantedSlots]) -> WantedSlots:
    ages = [part.oldest_queued_s for part in parts if part.oldest_queued_s is not None]
    queued, running = sum(part.queued for part in parts), sum(part.running for part in parts)
    return WantedSlots(kind, queued, running, max(ages, default=None))
