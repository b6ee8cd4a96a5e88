"""How queues are counted by what they ask of a worker."""

from core.jobs.queue import MODELS, all_queues, queue_names
from core.jobs.slots import (
    ANY,
    CPU,
    GPU,
    QueueCount,
    SlotKind,
    WantedSlots,
    counted_as,
    kind_of_queue,
    wanted_slots,
)


def test_every_queue_has_the_kind_of_the_workers_that_serve_it() -> None:
    for gpus in (1, 2, 8, 64):
        device = f"gpu:0-{gpus - 1}"
        kinds = {kind_of_queue(name) for name in queue_names(device) if name in all_queues()}
        assert kinds == ({SlotKind("gpu", gpus)} if gpus > 1 else {GPU, ANY})
    assert {kind_of_queue(name) for name in queue_names("cpu")} == {CPU, ANY}
    assert {kind_of_queue(name) for name in queue_names("gpu:0-3", 2)} == {SlotKind("gpu", 4, 2)}
    assert {kind_of_queue(name) for name in queue_names("cpu", 3)} == {SlotKind("cpu", 0, 3)}


def test_priorities_count_together_and_models_as_one_job() -> None:
    counts = [
        QueueCount("gaitway-gpu-high", 2, 1, 5.0),
        QueueCount("gaitway-gpu-low", 1, 0, 90.0),
        QueueCount("gaitway-gpu4-normal", 0, 1, None),
        QueueCount("gaitway-any-normal", 3, 0, 1.0),
        QueueCount(MODELS, 17, 0, 2.0),
        QueueCount(None, 1, 1, 0.5),
    ]
    assert wanted_slots(counts) == [
        WantedSlots(ANY, 5, 1, 2.0),
        WantedSlots(GPU, 3, 1, 90.0),
        WantedSlots(SlotKind("gpu", 4), 0, 1, None),
    ]


def test_jobs_for_any_device_count_where_their_reader_starts_workers() -> None:
    wanted = [WantedSlots(ANY, 2, 1, 7.0), WantedSlots(GPU, 1, 0, 9.0)]
    assert counted_as(wanted, "gpu") == [WantedSlots(GPU, 3, 1, 9.0)]
    assert counted_as(wanted, "cpu") == [WantedSlots(CPU, 2, 1, 7.0), WantedSlots(GPU, 1, 0, 9.0)]
