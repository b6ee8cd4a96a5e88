"""A site's options for Slurm: a TOML file, and the command line, which comes before the file."""

import tomllib
from itertools import product
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, Field, ValidationError, model_validator

from core.documents import Strict
from core.environments.info import Device
from core.errors import Misconfigured
from core.jobs.slots import SlotKind
from core.jobs.spec import MOST_GPUS, MOST_HOSTS

# A word in a line `#SBATCH --name=word`: nothing that ends the line, or begins a comment.
Word = Annotated[str, Field(min_length=1, max_length=200, pattern=r"^[\w.,:+@%/=*!&|()\[\]-]+$")]
Duration = Annotated[str, Field(pattern=r"^(\d+-)?\d+(:\d{1,2}){0,2}$", examples=["8:00:00", "1-00:00:00"])]
Memory = Annotated[str, Field(pattern=r"^\d+[KMGT]?$", examples=["32G"])]


def _one_line(text: str) -> str:
    if "\n" in text or "\r" in text:
        raise ValueError("must be one line")
    return text


Line = Annotated[str, Field(min_length=1, max_length=1000), AfterValidator(_one_line)]


class Part(Strict):
    """The options of one kind of allocation, as sbatch has them."""

    partition: Word | None = None
    account: Word | None = None
    qos: Word | None = None
    constraint: Word | None = None
    time: Duration | None = Field(None, description="Time limit; by default the partition's own.")
    cpus: int = Field(8, ge=1, le=1024, description="CPU cores.")
    mem: Memory = Field("16G", description="Memory; without a unit in megabytes.")
    max: int | None = Field(None, ge=0, description="Allocations of this part at once.")
    options: list[Word] = Field(default=[], description="Further options of sbatch: `--nice=100`.")
    hosts: list[Annotated[int, Field(ge=1, le=MOST_HOSTS)]] = Field(
        default=[1],
        min_length=1,
        description="For jobs on these many hosts a worker is started on each of them, all at once.",
    )

    @property
    def mem_mib(self) -> int:
        """The memory in MiB, as sinfo counts it."""
        number, unit = int(self.mem.rstrip("KMGT")), self.mem[-1]
        return {"K": number // 1024, "G": number * 1024, "T": number * 1024**2}.get(unit, number)

    @property
    def time_s(self) -> float | None:
        """The time limit in seconds."""
        return None if self.time is None else seconds_of(self.time)


class CpuPart(Part):
    """Workers on a CPU."""


class GpuPart(Part):
    """Workers on GPUs: `cpus` and `mem` are for each GPU."""

    gpus: list[Annotated[int, Field(ge=1, le=MOST_GPUS)]] = Field(
        default=[1], min_length=1, description="For jobs of these many GPUs workers are started."
    )
    gres: Annotated[str, Field(pattern=r"^[\w.,:{}()-]+$")] = Field(
        "gpu:{gpus}", description="As `--gres`: `gpu:a100:{gpus}` names a type."
    )

    @model_validator(mode="after")
    def _names_the_number(self) -> Self:
        if "{gpus}" not in self.gres:
            raise ValueError("gres must contain {gpus}, in whose place the number of GPUs stands")
        return self


class Container(Strict):
    """The worker runs in a container image. options: of `apptainer exec`, or of `srun`."""

    kind: Literal["apptainer", "pyxis"]
    image: Line
    options: list[Line] = []
    command: Line = Field("python -m worker.main", description="The worker, inside the image.")


class Tunnel(Strict):
    """Compute nodes reach the stores by ssh to this host, for example the login node.

    key, known_hosts: files that the compute nodes see.
    """

    host: Word
    user: Word | None = None
    port: int = Field(22, ge=1, le=65535)
    key: Path | None = None
    known_hosts: Path | None = None

    @property
    def ssh(self) -> list[str]:
        """The options of an ssh that asks nobody anything."""
        words = ["-o", "BatchMode=yes", "-o", "ConnectTimeout=10", "-p", str(self.port)]
        if self.key is not None:
            words += ["-i", str(self.key), "-o", "IdentitiesOnly=yes"]
        if self.known_hosts is not None:
            words += ["-o", f"UserKnownHostsFile={self.known_hosts}", "-o", "StrictHostKeyChecking=yes"]
        return words

    @property
    def destination(self) -> str:
        return f"{self.user}@{self.host}" if self.user else self.host


class SlurmOptions(Strict):
    """Everything that `gaitway cluster slurm` is told."""

    max: int = Field(4, ge=1, le=10_000, description="Allocations at once.")
    idle: float = Field(120.0, ge=5, le=86_400, description="A worker without a job ends after this time.")
    grace: float = Field(
        25.0, ge=2, le=3600, description="A drain's time; less than Slurm's KillWait, which is 30 s."
    )
    warning: int | None = Field(
        None,
        ge=5,
        le=65_535,
        description="Slurm warns so many seconds before the end; by default grace + 30.",
    )
    start_margin: float = Field(
        120.0, gt=0, le=86_400, description="With less time left, a worker takes no further job."
    )
    any: Device | None = Field(
        None, description="Where jobs run that ask for no device; by default on a GPU where `gpu` is there."
    )
    modules: list[Word] = Field(default=[], description="Loaded by `module load`.")
    setup: str = Field("", max_length=20_000, description="Lines of the script before the worker starts.")
    template: Path | None = Field(None, description="A batch script of your own.")
    command: Line | None = Field(None, description="The worker; by default that of this installation.")
    environment: dict[Annotated[str, Field(pattern=r"^[A-Za-z_]\w*$")], Line] = {}
    container: Container | None = None
    tunnel: Tunnel | Literal["none"] | None = Field(
        None,
        description="By default ssh to this machine where the stores listen for it alone; `none`: the nodes "
        "reach the stores as this machine does.",
    )
    cpu: CpuPart | None = None
    gpu: GpuPart | None = None

    @model_validator(mode="after")
    def _has_a_part(self) -> Self:
        if self.cpu is None and self.gpu is None:
            raise ValueError("neither [cpu] nor [gpu] is there: no worker could be started")
        if self.any is not None and getattr(self, self.any) is None:
            raise ValueError(f"any = {self.any!r}, but there is no [{self.any}]")
        if self.container is not None and self.container.kind == "pyxis" and self._has_gangs:
            raise ValueError(
                "container.kind = 'pyxis' starts a worker by srun, as hosts above 1 do: use 'apptainer'"
            )
        for name in ("cpu", "gpu"):
            part: Part | None = getattr(self, name)
            if part is not None and part.time_s is not None and part.time_s <= self.least_s:
                raise ValueError(
                    f"{name}.time is {part.time_s:g} s, and {self.least_s:g} s of it are for starting and "
                    "draining: give it more, or a smaller start_margin"
                )
        return self

    @property
    def least_s(self) -> float:
        """The time of an allocation in which a job could not come to a checkpoint."""
        return self.grace + 15 + self.start_margin

    @property
    def any_as(self) -> Device:
        return self.any or ("cpu" if self.gpu is None else "gpu")

    @property
    def warning_s(self) -> int:
        return self.warning or round(self.grace) + 30

    @property
    def kinds(self) -> tuple[SlotKind, ...]:
        """The kinds of slots that can be started."""
        cpu = () if self.cpu is None else self.cpu.hosts
        gpu = () if self.gpu is None else product(self.gpu.gpus, self.gpu.hosts)
        return (
            *(SlotKind("cpu", hosts=hosts) for hosts in cpu),
            *(SlotKind("gpu", gpus, hosts) for gpus, hosts in gpu),
        )

    @property
    def _has_gangs(self) -> bool:
        return any(kind.hosts > 1 for kind in self.kinds)

    def part(self, kind: SlotKind) -> Part:
        """Raises KeyError for a kind that is not one of `kinds`."""
        part = self.cpu if kind.accelerator == "cpu" else self.gpu
        if part is None or kind not in self.kinds:
            raise KeyError(kind)
        return part


def read_options(file: Path | None, said: dict[str, Any]) -> SlurmOptions:
    """The file's options with those of the command line in their place.

    said: like the file; its [cpu] and [gpu] replace only what they name. Raises Misconfigured, which names
    the place in the file.
    """
    document: dict[str, Any] = {}
    if file is not None:
        try:
            document = tomllib.loads(file.read_text())
        except (OSError, UnicodeDecodeError) as error:
            raise Misconfigured(f"{file} cannot be read: {error}.") from None
        except tomllib.TOMLDecodeError as error:
            raise Misconfigured(f"{file} is not TOML: {error}.") from None
    for name, value in said.items():
        if isinstance(value, dict) and isinstance(document.get(name), dict):
            document[name] |= value
        else:
            document[name] = value
    try:
        # In JSON's mode a path is text.
        return SlurmOptions.model_validate(document, strict=False)
    except ValidationError as error:
        place = "The options" if file is None else str(file)
        problems = [
            f"/{'/'.join(map(str, one['loc']))}: {one['msg'].removeprefix('Value error, ')}"
            for one in error.errors()
        ]
        raise Misconfigured(f"{place} cannot be used. {'; '.join(problems)}.") from None


def seconds_of(time: str) -> float:
    """Slurm's minutes, minutes:seconds, hours:minutes:seconds, days-hours, … in seconds."""
    days, _, rest = time.rpartition("-")
    parts = [int(part) for part in rest.split(":")]
    if days:
        hours, minutes, seconds = [*parts, 0, 0][:3]
    elif len(parts) == 3:
        hours, minutes, seconds = parts
    else:
        hours, (minutes, seconds) = 0, [*parts, 0][:2]
    return int(days or 0) * 86_400 + hours * 3600 + minutes * 60 + seconds
