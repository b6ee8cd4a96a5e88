import re
from pathlib import Path
from typing import Any

import pytest

from core.algorithms.catalog import resolve
from core.algorithms.sac.spec import SACSpec
from core.environments import catalog
from core.errors import Rejected
from core.jobs.checks import check
from core.jobs.spec import JOB_SPEC
from core.jobs.store import JobStore


def refused(**changes: Any) -> Rejected:
    """Why the ant is not trained with this on a CPU."""
    with pytest.raises(Rejected) as refusal:
        resolve(SACSpec.model_validate(changes), catalog.find("ant"), "cpu")
    return refusal.value


def test_critics_need_a_range_of_returns() -> None:
    told = refused(value_min=5, value_max=5)
    assert "value_min = 5 is not below value_max = 5" in told.detail
    assert [problem.pointer for problem in told.problems] == ["/algorithm/value_min", "/algorithm/value_max"]


@pytest.mark.parametrize(("unroll_length", "n_step", "least"), [(8, 3, 8), (2, 5, 6)])
def test_a_replay_holds_an_update_and_a_sample(unroll_length: int, n_step: int, least: int) -> None:
    shape = {"num_envs": 10, "unroll_length": unroll_length, "n_step": n_step}
    told = refused(**shape, max_replay_size=10 * least - 1)
    assert f"keeps {least - 1} actions of each of 10 environments" in told.detail
    assert f"it has to keep {least}: {10 * least} or more" in told.detail
    settings = SACSpec.model_validate({**shape, "max_replay_size": 10 * least})
    assert resolve(settings, catalog.find("ant"), "cpu").replay_rows == least


def test_a_run_lasts_until_it_learns() -> None:
    # 3 updates of 10 × 8 transitions.
    told = refused(num_envs=10, unroll_length=8, num_timesteps=240, min_replay_size=241)
    assert "The run ends after 240 transitions, before there are min_replay_size = 241" in told.detail


def test_a_replay_fits_into_a_checkpoint() -> None:
    # A transition of the ant has 27 + 8 + 3 floats, 152 bytes: 21,192,272 of them fit into 3 GiB.
    told = refused(num_envs=1, max_replay_size=21_192_273)
    assert "max_replay_size = 21192273 transitions of ant take 3 GiB" in told.detail
    assert [problem.pointer for problem in told.problems] == ["/algorithm/max_replay_size"]
    resolve(SACSpec(num_envs=1, max_replay_size=21_192_272), catalog.find("ant"), "cpu")


def test_several_gpus_are_refused() -> None:
    with pytest.raises(Rejected, match="sac runs on one device, but the job asks for 2 GPUs"):
        SACSpec().check_sharing(2)


def test_the_jobs_of_the_page_are_jobs(jobs: JobStore) -> None:
    page = (Path(__file__).parents[4] / "docs" / "sac.md").read_text()
    found = re.findall(r"```json\n(.*?)```", page, re.DOTALL)
    assert len(found) == 2
    for job in found:
        check(JOB_SPEC.validate_json(job), jobs)
