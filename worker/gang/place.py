"""The place of a worker among the machines that take a job together: a gang, with one worker on each host."""

import hashlib
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass

from core.errors import Misconfigured
from core.settings import WorkerSettings
from core.variables import variable

# Slurm's jobs on one machine get different ports, below those that JAX's own rule for Slurm takes.
_FIRST_PORT, _NUM_PORTS = 57344, 4096


@dataclass(frozen=True)
class Place:
    """Which of `hosts` machines this is, and where that of rank 0 listens; secret: what all of them share."""

    hosts: int
    rank: int
    host: str
    port: int
    secret: bytes


def place_of(settings: WorkerSettings, variables: Mapping[str, str] = os.environ) -> Place | None:
    """The place that the settings name, or Slurm's variables; None for a worker that takes jobs alone.

    Raises Misconfigured where they do not go together.
    """
    if settings.hosts == 1:
        return None
    rank = settings.host_rank
    if rank is None and (number := variables.get("SLURM_PROCID")) is not None:
        _check_tasks(settings.hosts, variables)
        rank = int(number)
    if rank is None:
        raise Misconfigured(
            f"{variable('hosts')}={settings.hosts}, but {variable('host_rank')} is not set: say "
            "which of them this machine is, from 0. Under Slurm's srun it is known."
        )
    if rank >= settings.hosts:
        raise Misconfigured(
            f"{variable('host_rank')} is {rank}, but the {settings.hosts} hosts count from 0 to "
            f"{settings.hosts - 1}."
        )
    host, _, port = (settings.coordinator or _of_slurm(variables)).rpartition(":")
    secret = settings.gang_secret or settings.s3_secret_key
    key = hashlib.sha256(b"gaitway gang\0" + secret.get_secret_value().encode()).digest()
    return Place(settings.hosts, rank, host.strip("[]"), int(port), key)


def _check_tasks(hosts: int, variables: Mapping[str, str]) -> None:
    tasks = variables.get("SLURM_STEP_NUM_TASKS") or variables.get("SLURM_NTASKS")
    if tasks is not None and int(tasks) != hosts:
        raise Misconfigured(
            f"{variable('hosts')}={hosts}, but srun has started {tasks} tasks: start one on each host "
            f"(srun --nodes={hosts} --ntasks-per-node=1)."
        )


def _of_slurm(variables: Mapping[str, str]) -> str:
    nodes = variables.get("SLURM_STEP_NODELIST") or variables.get("SLURM_JOB_NODELIST")
    job = variables.get("SLURM_JOB_ID", "")
    if nodes is None or not job.isdecimal():
        raise Misconfigured(
            f"{variable('coordinator')} is not set: give all hosts the HOST:PORT at which the worker of host "
            "0 is to listen. Under Slurm's srun it is known."
        )
    return f"{first_node(nodes)}:{_FIRST_PORT + int(job) % _NUM_PORTS}"


def first_node(nodes: str) -> str:
    """The first of Slurm's list of nodes: `n07` of `n[07-09,12],m1`."""
    name, _, rest = nodes.partition("[")
    if "," in name or not rest:
        return name.partition(",")[0]
    numbers, _, suffix = rest.partition("]")
    first = re.split(r"[-,]", numbers, maxsplit=1)[0]
    return f"{name}{first}{suffix.partition(',')[0]}"
