"""The package of the documentation, installed into a service: its body and its term, up to a resume."""

import os
import shutil
import signal
import sys
import sysconfig
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from venv import EnvBuilder

import pytest
from playwright.sync_api import Browser, expect

from gaitway.client import Client
from tests.api.pages.conftest import Tab, browser
from tests.compiling import compiling_quickly
from tests.e2e.conftest import serving

__all__ = ["browser"]  # The fixture.

pytestmark = [pytest.mark.extra, pytest.mark.timeout(240)]

EXAMPLE = Path(__file__).parents[2] / "examples" / "mylab" / "mylab"
JOB: dict[str, Any] = {
    "algorithm": {
        "num_timesteps": 2000,
        "num_envs": 16,
        "unroll_length": 10,
        "batch_size": 16,
        "num_minibatches": 4,
        "num_evals": 2,
        "num_eval_envs": 4,
        "episode_length": 20,
        "policy_hidden_layer_sizes": [16],
        "value_hidden_layer_sizes": [16],
    },
    "physics": "native",
    "checkpoints": {"every_steps": 640},
    "video": {"width": 160, "height": 120, "seconds": 0.4},
}


@pytest.fixture(scope="module")
def python(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An interpreter that has this environment's packages and the example's: a stack hides PYTHONPATH
    from its processes, and other tests use this environment meanwhile."""
    folder = tmp_path_factory.mktemp("lab")
    EnvBuilder(symlinks=True).create(folder)
    for program in Path(sys.prefix, "bin").iterdir():
        if not (folder / "bin" / program.name).exists():
            (folder / "bin" / program.name).symlink_to(program)
    site = folder / "lib" / f"python3.{sys.version_info.minor}" / "site-packages"
    (site / "ours.pth").write_text(f"import site; site.addsitedir({sysconfig.get_path('purelib')!r})\n")
    shutil.copytree(EXAMPLE, site / "mylab", ignore=shutil.ignore_patterns("__pycache__"))
    facts = site / "mylab-0.1.0.dist-info"
    facts.mkdir()
    (facts / "METADATA").write_text("Metadata-Version: 2.1\nName: mylab\nVersion: 0.1.0\n")
    (facts / "entry_points.txt").write_text("[gaitway.environments]\nmylab = mylab.environments\n")
    return folder / "bin" / "python"


@pytest.fixture(scope="module")
def package(python: Path) -> Path:
    """The folder of the example where it is installed."""
    return next(python.parents[1].glob("lib/*/site-packages/mylab"))


@pytest.fixture(scope="module")
def client(python: Path, tmp_path_factory: pytest.TempPathFactory, postgres_data: Path) -> Iterator[Client]:
    """A client of a stack of that interpreter with one worker, which compiles quickly."""
    data = tmp_path_factory.mktemp("stack")
    shutil.copytree(postgres_data, data / "postgres" / "data")
    with pytest.MonkeyPatch.context() as environment:
        for name, value in compiling_quickly().items():
            environment.setenv(name, value)
        with serving(data, python=str(python)) as client:
            yield client


def test_its_body_is_trained_with_its_term(client: Client) -> None:
    job = client.wait(client.submit(JOB, environment="mylab/monopod").id, timeout=200)
    assert job.succeeded, job.message
    assert {"checkpoint", "policy", "video", "replay", "simulation"} <= {a.role for a in job.artifacts}
    simulation = job.artifact("simulation.json")
    assert simulation is not None
    assert simulation.metadata["can_run"] is True
    measured = {name for row in client.metrics(job.id) for name in row.values}
    assert "eval/episode_reward_uneven_power" in measured
    assert "mylab" in job.attempts[0].details["versions"]


def test_the_form_has_its_body_and_its_term(client: Client, browser: Browser) -> None:
    page = browser.new_page(viewport={"width": 1280, "height": 900}, reduced_motion="reduce")
    page.set_default_timeout(60_000)
    Tab(page, str(client.base_url).rstrip("/")).open("#/submit?environment=mylab/monopod")
    page.get_by_text("reward 3 by default").click()
    reward = page.get_by_role("group", name="reward", exact=True)
    search = reward.get_by_label("Add to reward")
    search.fill("busiest joint")
    expect(reward.get_by_role("option")).to_have_count(1)
    search.press("Enter")
    expect(
        reward.get_by_role("group", name="reward 4: mylab/uneven_power").get_by_label("weight")
    ).to_be_focused()


def test_a_resume_tells_that_the_package_changed_and_a_worker_without_it_leaves_the_job(
    client: Client, package: Path
) -> None:
    long = {**JOB["algorithm"], "num_timesteps": 10**7}
    job = client.submit(JOB, environment="mylab/monopod", algorithm=long, video=None)
    pid = None
    for event in client.events(job.id):
        if event.kind == "phase" and event.data["name"] == "process":
            pid = int(event.data["pid"])
        if event.kind == "artifact" and event.data["role"] == "checkpoint":
            break
    assert pid is not None
    code = package / "environments.py"
    code.write_text(code.read_text() + "\n# Another version.\n")
    os.kill(pid, signal.SIGKILL)
    assert next(
        line for line in client.logs(job.id, follow=True) if "The checkpoint was made with mylab" in line
    )
    client.cancel(job.id)
    client.wait(job.id, timeout=100)

    code.write_text("import nowhere\n")
    (old,) = client.workers()
    os.kill(old.pid, signal.SIGTERM)  # The stack starts another one in its place, which cannot load it.
    until_worker_changes(client, old.name)
    waiting = client.get(client.submit(JOB, environment="mylab/monopod").id)
    assert waiting.waiting_for is not None
    assert "No suitable worker can run the terms and bodies mylab/…" in waiting.waiting_for


def until_worker_changes(client: Client, old: str) -> None:
    while [worker.name for worker in client.workers()] in ([], [old]):
        time.sleep(0.2)
