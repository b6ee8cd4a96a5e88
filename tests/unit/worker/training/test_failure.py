"""What a training process says of the exception that ended it; the texts are XLA's, Warp's and Python's."""

import errno

import pytest

from core.reasons import Reason
from worker.training.run import failure

# As JAX 0.11.2 said it on an H100.
_XLA_MEMORY = (
    "RESOURCE_EXHAUSTED: Out of memory while trying to allocate 232.83GiB with allocator GPU_0_bfc on device "
    "0. [executable_name='jit__lambda'] [tf-allocator-allocation-error='']"
)


@pytest.mark.parametrize(
    ("error", "device", "reason"),
    [
        (RuntimeError(_XLA_MEMORY), "gpu:0", Reason.OUT_OF_MEMORY),
        (RuntimeError("Failed to allocate 4096 bytes on device 'cuda:0'"), "gpu:0", Reason.OUT_OF_MEMORY),
        (RuntimeError("INTERNAL: CUDA_ERROR_OUT_OF_MEMORY: out of memory"), "gpu:0", Reason.OUT_OF_MEMORY),
        (
            RuntimeError("RESOURCE_EXHAUSTED: Out of memory allocating 8 bytes."),
            "cpu",
            Reason.OUT_OF_HOST_MEMORY,
        ),
        (MemoryError(), "gpu:0", Reason.OUT_OF_HOST_MEMORY),
        # Native physics under a learner on a GPU.
        (RuntimeError("RESOURCE_EXHAUSTED: MemoryError: "), "gpu:0", Reason.OUT_OF_HOST_MEMORY),
        (RuntimeError("INTERNAL: CUDA_ERROR_ILLEGAL_ADDRESS: illegal"), "gpu:0,1", Reason.DEVICE_FAILED),
        (RuntimeError("INTERNAL: an uncorrectable ECC error was met"), "gpu:0", Reason.DEVICE_FAILED),
        (RuntimeError("Warp CUDA error 719: unspecified launch failure"), "gpu:0", Reason.DEVICE_FAILED),
        (RuntimeError("INTERNAL: The device is lost"), "gpu:0", Reason.DEVICE_FAILED),
        (
            RuntimeError("INTERNAL: NCCL operation ncclGroupEnd() failed: unhandled system error"),
            "gpu:0,1",
            Reason.DEVICE_FAILED,
        ),
        # A worker on the CPU has no such device.
        (RuntimeError("CUDA_ERROR_NO_DEVICE"), "cpu", Reason.TRAINING_CRASHED),
        (ValueError("The section has 3 rows."), "gpu:0", Reason.TRAINING_CRASHED),
        (OSError(errno.ENOSPC, "No space left"), "cpu", Reason.STORAGE_UNAVAILABLE),
    ],
)
def test_an_exception_has_its_reason(error: Exception, device: str, reason: Reason) -> None:
    said = failure(error, device)
    assert said.reason == reason


def test_a_lost_host_is_no_fault_of_the_own_gpus() -> None:
    error = RuntimeError("INTERNAL: NCCL operation ncclAllReduce() failed: remote process exited")
    assert failure(error, "gpu:0,1", in_gang=True).reason == Reason.TRAINING_CRASHED


def test_a_lack_of_memory_names_the_device_and_what_to_lower() -> None:
    message = failure(RuntimeError(_XLA_MEMORY), "gpu:0,1").message
    assert message.startswith("The memory of gpu:0,1 ran out. Lower num_envs, batch_size or unroll_length")
    assert "232.83GiB" in message


def test_a_job_that_shares_a_gpu_hears_of_its_part() -> None:
    said = failure(RuntimeError("RESOURCE_EXHAUSTED: Out of memory"), "gpu:0", gpu_part=0.25)
    assert said.reason == Reason.OUT_OF_MEMORY
    assert said.message.startswith("The job shares gpu:0, and its 25% of the memory ran out. Ask for more by")
