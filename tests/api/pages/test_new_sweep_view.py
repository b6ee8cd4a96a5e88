"""The form that starts a sweep."""

import ast
import json
from typing import Any
from urllib.parse import urlencode

import pytest
from playwright.sync_api import Page, expect
from pydantic import JsonValue, TypeAdapter

from api.page_files import page_files
from core.sweeps.axes import num_combinations
from core.sweeps.spec import Axis
from tests.api.conftest import Stack, job
from tests.api.pages.conftest import MakeTab, Tab

RATE = "algorithm.learning_rate"
AXIS: TypeAdapter[Axis] = TypeAdapter(Axis)


def add(page: Page, path: str) -> None:
    """Add this setting as an axis."""
    page.get_by_label("Setting", exact=True).select_option(path)
    page.get_by_role("button", name="Add the axis").click()


def document(page: Page) -> dict[str, Any]:
    """The JSON that the form shows and will send."""
    return json.loads(page.get_by_role("region", name="The submission as JSON").inner_text())


def start(page: Page) -> None:
    page.get_by_role("button", name="Start the sweep").click()


def test_a_grid_is_written_counted_and_started(stack: Stack, tab: Tab) -> None:
    page = tab.open("#/sweeps")
    page.get_by_role("link", name="Start the first one").click()
    size = page.get_by_role("status", name="Size")
    expect(size).to_contain_text("known once each axis has its values")
    add(page, RATE)
    rate = page.get_by_role("group", name=RATE, exact=True)
    # The new axis has the focus, and shows what the job has: what is tuned for the ant.
    expect(rate.get_by_label("values")).to_be_focused()
    expect(rate).to_contain_text("the job has 0.001")
    rate.get_by_role("button", name="A range").click()
    rate.get_by_label("low").fill("1e-4")
    rate.get_by_label("high").fill("1e-2")
    rate.get_by_label("points").fill("3")
    rate.get_by_label("Even in the logarithm").check()
    add(page, "seed")
    page.get_by_role("group", name="seed", exact=True).get_by_label("values").fill("1, 2")
    add(page, "algorithm.normalize_advantage")
    expect(size).to_contain_text("12 trials")
    # 3 × 2 × 2 trials of as many steps as a job on a GPU takes, which may be where they run.
    expect(size).to_contain_text("up to 50,000,000 environment steps each")
    expect(size).to_contain_text("600,000,000 steps in all, at most")
    page.get_by_label("name", exact=True).last.fill("by hand")
    expected = {
        "name": "by hand",
        "job": {"kind": "train", "environment": {"id": "ant"}},
        "method": "grid",
        "parameters": {
            RATE: {"low": 1e-4, "high": 1e-2, "points": 3, "log": True},
            "seed": [1, 2],
            "algorithm.normalize_advantage": [True, False],
        },
    }
    assert document(page) == expected
    start(page)
    expect(page.get_by_role("heading", name="by hand")).to_be_visible()
    [stored] = stack.http.get("/sweeps").json()["items"]
    assert (stored["max_trials"], stored["spec"]["parameters"]["seed"]) == (12, [1, 2])


@pytest.mark.extra
def test_a_jobs_page_leads_to_a_sweep_over_its_settings(stack: Stack, tab: Tab) -> None:
    settings = {"kind": "ppo", "num_timesteps": 1000, "learning_rate": 0.001}
    stack.store.add(job(name="good", algorithm=settings, labels={"trial": "3", "sweep": "x", "who": "me"}))
    page = tab.open("#/jobs/019aa3c2f0b1-5be0c1d2e3")
    page.get_by_role("link", name="Sweep over these settings").click()
    expect(page.get_by_role("heading", name="Start a sweep")).to_be_visible()
    add(page, "algorithm.num_timesteps")
    # Of a whole number: 1000 is what the job says.
    axis = page.get_by_role("group", name="algorithm.num_timesteps", exact=True)
    expect(axis).to_contain_text("whole number; the job has 1000")
    axis.get_by_label("values").fill("1000, 3000")
    expect(page.get_by_role("status", name="Size")).to_contain_text("4,000 steps in all")
    found = document(page)
    assert found["name"] == "good, swept"
    assert found["job"] == {
        "kind": "train",
        "name": "good",
        "labels": {"who": "me"},
        "environment": {"id": "ant"},
        "algorithm": settings,
    }


def test_a_field_of_an_object_among_the_options_is_an_axis(tab: Tab) -> None:
    # The algorithm's kind is left out, as it may be.
    written = {"kind": "train", "environment": {"id": "g1"}, "algorithm": {"network": {"kind": "intention"}}}
    page = tab.open(f"#/sweeps/new?{urlencode({'job': json.dumps(written)})}")
    add(page, "environment.options.command.every_s")
    axis = page.get_by_role("group", name="environment.options.command.every_s", exact=True)
    expect(axis).to_contain_text("number; the job has 5")
    add(page, "environment.options.action")  # As a whole it is one, too.
    add(page, "algorithm.clipping_epsilon")
    add(page, "algorithm.network.latent")
    others = page.get_by_label("Setting", exact=True).locator("option[value='algorithm.experts']")
    expect(others).to_have_count(0)


@pytest.mark.extra
def test_refusals_stand_beside_the_fields_that_they_name(tab: Tab) -> None:
    page = tab.open("#/sweeps/new")
    start(page)
    expect(page.get_by_role("alert")).to_contain_text("/parameters")
    expect(page.get_by_role("group", name="Axes")).to_contain_text("A sweep needs an axis")
    page.get_by_role("radio", name="random", exact=False).check()
    add(page, RATE)
    rate = page.get_by_role("group", name=RATE, exact=True)
    start(page)
    expect(rate.get_by_label("low")).to_have_attribute("aria-invalid", "true")
    expect(rate).to_contain_text("high is missing.")
    rate.get_by_label("low").fill("2")
    rate.get_by_label("high").fill("1")
    start(page)
    expect(rate).to_contain_text("low must be below high")
    rate.get_by_label("low").fill("0.1")
    start(page)
    expect(page.get_by_role("group", name="Budget")).to_contain_text(
        "The method random has no end of its own"
    )
    page.get_by_label("jobs", exact=True).fill("7")
    page.get_by_label("metric").fill("eval/reward")
    start(page)
    expect(page.get_by_role("group", name="Objective", exact=True)).to_contain_text("did you mean")
    expect(page.get_by_label("metric")).to_have_attribute("aria-invalid", "true")
    page.get_by_label("metric").fill("eval/episode_reward_forward")
    page.get_by_label("steps", exact=True).fill("10")
    start(page)
    expect(page.get_by_role("group", name="Budget")).to_contain_text("allows no trial")
    expect(page.get_by_label("steps", exact=True)).to_have_attribute("aria-invalid", "true")
    # The job's own problem opens its settings.
    page.get_by_text("Environment, algorithm and other settings of the job").click()
    page.get_by_label("num envs", exact=True).fill("-3")
    page.get_by_text("Environment, algorithm and other settings of the job").click()
    start(page)
    expect(page.get_by_label("num envs", exact=True)).to_have_attribute("aria-invalid", "true")


@pytest.mark.extra
def test_each_method_asks_and_sends_only_what_it_takes(tab: Tab) -> None:
    page = tab.open("#/sweeps/new")
    page.get_by_label("Example of a sweep").select_option("population-based training")
    size = page.get_by_role("status", name="Size")
    # 8 members in 5 generations train 20,000,000 steps each.
    expect(size).to_contain_text("40 trials")
    expect(size).to_contain_text("4,000,000 environment steps each")
    expect(size).to_contain_text("160,000,000 steps in all")
    expect(page.get_by_role("group", name="Pruning")).to_have_count(0)
    options = (
        page.get_by_label("Setting", exact=True)
        .locator("option")
        .evaluate_all("all => all.map(o => o.value)")
    )
    assert all(option.startswith("algorithm.") for option in options if option)
    page.get_by_role("radio", name="grid", exact=False).check()
    expect(page.get_by_role("group", name="Population", exact=True)).to_have_count(0)
    found = document(page)
    assert "population" not in found
    # A grid takes five values of each of the two ranges.
    expect(size).to_contain_text("25 trials")
    page.get_by_role("radio", name="tpe", exact=False).check()
    page.get_by_label("pruning").select_option("median")
    page.get_by_role("button", name="Add another objective").click()
    page.get_by_label("metric").last.fill("eval/avg_episode_length")
    page.get_by_label("direction").last.select_option("minimize")
    page.get_by_label("jobs", exact=True).fill("20")
    expect(size).to_contain_text("20 trials")
    expect(size).to_contain_text("400,000,000 steps in all, at most")
    found = document(page)
    assert found["objective"] == [{}, {"metric": "eval/avg_episode_length", "direction": "minimize"}]
    assert found["pruning"] == {"kind": "median"}
    start(page)
    expect(page.get_by_role("alert")).to_contain_text("Pruning compares trials by one objective")
    expect(page.get_by_role("group", name="Pruning")).to_contain_text(
        "Pruning compares trials by one objective"
    )
    page.get_by_role("radio", name="cma_es", exact=False).check()
    expect(page.get_by_role("group", name="Objective 2")).to_have_count(0)
    found = document(page)
    assert (found["method"], found["pruning"]) == ("cma_es", {"kind": "median"})
    assert "objective" not in found  # The first one is the default.


@pytest.mark.extra
def test_a_job_is_pasted_or_taken_from_the_list(stack: Stack, tab: Tab) -> None:
    stack.store.add(job(name="of the list", environment="hopper"))
    page = tab.open("#/sweeps/new")
    add(page, "seed")
    page.get_by_role("button", name="Pasted JSON").click()
    pasted = page.get_by_label("A job or a whole sweep, as JSON")
    for text, sentence in [("{", "This is not JSON"), ("[1]", "neither a job nor a sweep")]:
        pasted.fill(text)
        page.get_by_role("button", name="Take it").click()
        expect(page.get_by_role("alert")).to_contain_text(sentence)
    pasted.fill('{"kind": "train", "environment": "walker2d", "seed": 3}')
    page.get_by_role("button", name="Take it").click()
    expect(page.get_by_role("alert")).to_have_count(0)
    expect(page.get_by_role("group", name="seed", exact=True)).to_contain_text("the job has 3")
    assert document(page)["job"]["environment"] == {"id": "walker2d"}
    page.get_by_role("button", name="Another job").click()
    page.get_by_label("Job whose settings to take").select_option("019aa3c2f0b1-5be0c1d2e3")
    expect(page.get_by_role("region", name="The submission as JSON")).to_contain_text("hopper")
    assert document(page)["parameters"] == {"seed": []}
    page.get_by_role("button", name="Pasted JSON").click()
    page.get_by_label("A job or a whole sweep, as JSON").fill(
        '{"job": {"environment": "ant"}, "parameters": {"seed": [1]}}'
    )
    page.get_by_role("button", name="Take it").click()
    expect(page.get_by_role("radio", name="random", exact=False)).to_be_checked()
    page.get_by_role("button", name="Remove the axis seed").click()
    expect(page.get_by_label("Setting", exact=True)).to_be_focused()
    expect(page.get_by_text("Nothing varies yet")).to_be_visible()


@pytest.mark.extra
def test_an_axis_that_the_job_does_not_have_is_said_at_once(tab: Tab) -> None:
    page = tab.open("#/sweeps/new")
    add(page, "algorithm.entropy_cost")
    expect(page.get_by_text("The job has no such setting")).to_have_count(0)
    page.get_by_text("Environment, algorithm and other settings of the job").click()
    page.get_by_label("Environment", exact=True).select_option("brittle_star")
    page.get_by_label("algorithm", exact=True).select_option("q_learning")
    expect(page.get_by_text("The job has no such setting")).to_be_visible()


@pytest.mark.extra
def test_the_page_counts_the_values_of_an_axis_as_the_service_does(tab: Tab) -> None:
    page = tab.open("#/sweeps/new")
    axes: list[tuple[JsonValue, bool]] = [
        (["a", "b", [1, 2]], False),
        ({"low": 0.1, "high": 0.3, "step": 0.1}, True),
        ({"low": 5, "high": 21, "step": 5}, False),
        ({"low": 1e-5, "high": 1e-2, "log": True, "points": 7}, True),
        ({"low": 1, "high": 4, "points": 9}, False),
        ({"low": 0, "high": 5, "points": 3}, False),
        ({"low": 1, "high": 100, "log": True, "points": 20}, False),
        ({"low": 3, "high": 9, "points": 1}, False),
        ({"low": 1e-4, "high": 1e-3, "log": True}, True),
        ({"low": 2, "high": 5, "points": None, "step": None}, False),
    ]
    counted = page.evaluate(
        """async ([path, axes]) => {
            const { numValues } = await import(path);
            return axes.map(([axis, isFractional]) => numValues(axis, isFractional));
        }""",
        [f"/pages/{page_files().version}/lib/sweep_size.js", axes],
    )
    of_service = [num_combinations({"a": AXIS.validate_python(axis)}) for axis, _ in axes]
    # By hand: 0.1, 0.2, 0.3; 5, 10, 15, 20; 1, 2, 3, 4 from nine; 0, 2.5 (to 2) and 5; five; 2, 3, 4 and 5.
    assert counted[1:3] + counted[4:6] + counted[8:] == [3, 4, 4, 3, 5, 4]
    assert counted == of_service


@pytest.mark.extra
def test_a_form_that_was_begun_goes_on_as_a_sweep_and_the_sweep_as_python(tab: Tab) -> None:
    page = tab.open("#/submit?environment=hopper")
    page.get_by_label("seed", exact=True).fill("7")
    page.get_by_role("link", name="Sweep over these settings").click()
    expect(page.get_by_role("heading", name="Start a sweep")).to_be_visible()
    add(page, "physics")
    page.get_by_role("group", name="physics", exact=True).get_by_label("warp").uncheck()
    page.get_by_role("button", name="Python").click()
    tree = ast.parse(page.get_by_role("region", name="The submission as Python").inner_text())
    [call] = [
        node
        for node in ast.walk(tree)
        if isinstance(node, ast.Call) and ast.unparse(node.func) == "client.sweep"
    ]
    assert ast.literal_eval(call.args[0]) == {
        "job": {"kind": "train", "environment": {"id": "hopper"}, "seed": 7},
        "method": "grid",
        "parameters": {"physics": ["auto", "native", "mjx", "compiled"]},
    }


@pytest.mark.extra
@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
@pytest.mark.parametrize("width", [1200, 380])
def test_the_form_is_accessible_and_fits(make_tab: MakeTab, width: int, dark: bool) -> None:
    tab = make_tab(width, dark)
    page = tab.open("#/sweeps/new")
    expect(page.locator("main h1")).to_be_visible()
    tab.picture(f"new_sweep-empty-{width}-{'dark' if dark else 'light'}")
    assert tab.violations() == []
    page.get_by_label("Example of a sweep").select_option("a grid")
    add(page, "algorithm.normalize_advantage")
    add(page, "environment.options.healthy_reward")
    start(page)
    expect(page.get_by_role("alert")).to_be_visible()
    assert (tab.violations(), tab.overflow()) == ([], 0)
    tab.picture(f"new_sweep-grid-{width}-{'dark' if dark else 'light'}")
    page.get_by_label("Example of a sweep").select_option("population-based training")
    expect(page.get_by_role("alert")).to_have_count(0)
    page.get_by_text("Environment, algorithm and other settings of the job").click()
    expect(page.get_by_label("num envs", exact=True)).to_be_visible()
    assert (tab.violations(), tab.overflow()) == ([], 0)
    tab.picture(f"new_sweep-pbt-{width}-{'dark' if dark else 'light'}")
