"""A worker's place among the hosts of a gang, by its settings or by Slurm's variables."""

from pathlib import Path
from typing import Any

import pytest

from core.errors import Misconfigured
from core.settings import WorkerSettings
from tests.faults.bench import unused_servers
from worker.gang.place import first_node, place_of

SLURM = {
    "SLURM_PROCID": "1",
    "SLURM_NTASKS": "2",
    "SLURM_JOB_NODELIST": "n[07-09],m1",
    "SLURM_JOB_ID": "4097",
}


def settings(**changes: Any) -> WorkerSettings:
    return unused_servers(Path("unused")).model_copy(update=changes)


def test_a_worker_of_one_host_has_no_place() -> None:
    assert place_of(settings(), SLURM) is None


def test_the_settings_name_the_place() -> None:
    place = place_of(settings(hosts=3, host_rank=2, coordinator="[fd00::5]:7000"), SLURM)
    assert place is not None
    assert (place.hosts, place.rank, place.host, place.port) == (3, 2, "fd00::5", 7000)


def test_under_slurm_its_variables_do() -> None:
    place = place_of(settings(hosts=2), SLURM)
    assert place is not None
    assert (place.rank, place.host, place.port) == (1, "n07", 57344 + 1)


@pytest.mark.parametrize(
    ("changes", "variables", "sentence"),
    [
        ({"hosts": 2}, {}, "GAITWAY_HOST_RANK is not set"),
        ({"hosts": 2, "host_rank": 2, "coordinator": "n1:7000"}, {}, "count from 0 to 1"),
        ({"hosts": 2, "host_rank": 0}, {}, "GAITWAY_COORDINATOR is not set"),
        ({"hosts": 3}, SLURM, "srun has started 2 tasks"),
    ],
)
def test_what_does_not_go_together_is_refused(
    changes: dict[str, Any], variables: dict[str, str], sentence: str
) -> None:
    with pytest.raises(Misconfigured, match=sentence):
        place_of(settings(**changes), variables)


@pytest.mark.parametrize(
    ("nodes", "first"),
    [
        ("n1", "n1"),
        ("n1,n2", "n1"),
        ("n[3,7]", "n3"),
        ("n[07-09],m1", "n07"),
        ("a,n[1-2]", "a"),
        ("r[1-2]-gpu", "r1-gpu"),
    ],
)
def test_the_first_of_slurms_nodes(nodes: str, first: str) -> None:
    assert first_node(nodes) == first
