"""What code that runs any algorithm's job can read from its hyperparameters."""

from abc import abstractmethod
from typing import ClassVar

from core.algorithms.memory import Memory
from core.documents import Strict
from core.environments.info import Device, EnvironmentInfo
from core.errors import Problem, Rejected


class BaseSpec(Strict):
    """An algorithm's hyperparameters; a subclass adds `kind` and its fields.

    fixed_by_checkpoint: names of the values that a resumed run must share with its checkpoint; all others
    may change. checkpoint_holds_envs: whether a resumed run continues in the environments that it left.
    """

    fixed_by_checkpoint: ClassVar[tuple[str, ...]] = ()
    checkpoint_holds_envs: ClassVar[bool] = False

    @classmethod
    def algorithm(cls) -> str:
        """The only value of `kind`."""
        return cls.model_fields["kind"].default

    @property
    @abstractmethod
    def num_parallel_envs(self) -> int:
        """How many environments a run steps side by side for most of its time."""

    @property
    @abstractmethod
    def budget(self) -> int:
        """Environment steps that the run was asked to take; a last update may pass it."""

    def refusal(self, environment: EnvironmentInfo, device: Device) -> Rejected | None:
        """Why these values do not go together, or not with this environment; None where they do."""
        return None

    def least_memory(self, environment: EnvironmentInfo, num_devices: int) -> Memory:
        """The memory that a run under these resolved values certainly needs on each of its devices."""
        return Memory([])

    def check_sharing(self, num_devices: int) -> None:
        """Raises Rejected where `num_devices` devices cannot share the run: by default, more than one."""
        if num_devices > 1:
            detail = f"{self.algorithm()} runs on one device, but the job asks for {num_devices} GPUs."
            raise Rejected(detail, [Problem("/resources/gpus", detail)])


def check_resumption(wanted: BaseSpec, made_with: BaseSpec) -> None:
    """Raises Rejected if a run under `wanted` cannot resume from a checkpoint of one under `made_with`."""
    names = ("kind",) if type(wanted) is not type(made_with) else wanted.fixed_by_checkpoint
    problems = [
        Problem(f"/algorithm/{name}", f"The checkpoint was made with {name} = {had}; this job has {has}.")
        for name in names
        if (had := getattr(made_with, name)) != (has := getattr(wanted, name))
    ]
    if problems:
        raise Rejected(
            "The job cannot resume from that checkpoint. " + " ".join(problem.detail for problem in problems),
            problems,
        )
