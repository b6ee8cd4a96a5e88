"""The reasons for which a job or one of its attempts ends."""

from enum import StrEnum


class Reason(StrEnum):
    """Why a job or one of its attempts ended."""

    COMPLETED = "completed"
    USER_CANCELLED = "user_cancelled"
    TIMEOUT = "timeout"
    WORKER_LOST = "worker_lost"
    WORKER_DRAINED = "worker_drained"
    PREEMPTED = "preempted"
    TRAINING_KILLED = "training_killed"
    TRAINING_STALLED = "training_stalled"
    NATIVE_CRASH = "native_crash"
    OUT_OF_MEMORY = "out_of_memory"
    OUT_OF_HOST_MEMORY = "out_of_host_memory"
    DIVERGED = "diverged"
    BAD_MODEL = "bad_model"
    BAD_CLIPS = "bad_clips"
    BAD_CHECKPOINT = "bad_checkpoint"
    NO_DEVICE = "no_device"
    DEVICE_FAILED = "device_failed"
    DEVICE_HELD = "device_held"
    STORAGE_UNAVAILABLE = "storage_unavailable"
    EXPORTED_UNFINISHED = "exported_unfinished"
    TRAINING_CRASHED = "training_crashed"
