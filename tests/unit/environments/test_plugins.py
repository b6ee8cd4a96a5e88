"""Packages that add terms and bodies: the example of the documentation, and broken ones."""

import json
import shutil
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from importlib.metadata import distributions
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from typer.testing import CliRunner

from core.algorithms import catalog as algorithms
from core.algorithms.ppo.spec import PPOSpec
from core.algorithms.ppo.tuned import MJCF
from core.environments import catalog, plugins
from core.environments.describe_bodies import bodies_of_plugin
from core.environments.describe_terms import page_of_plugin
from core.environments.plugins import LISTS, TABLE, Plugin, hold_only, load
from core.environments.robots.info import ROBOTS
from core.environments.task import TaskEnv
from core.environments.terms.inventory import OF_PLUGINS
from core.environments.terms.step import Step
from core.environments.terms.task import TaskOptions
from core.errors import EnvironmentNotFound, JobFailed, Rejected
from core.jobs.job import Job
from core.jobs.workers import how_to_install, packages_for, packages_here
from core.physics.choose import engine_builder
from gaitway.cli.main import app
from tests.unit.jobs.making import make_job
from worker.confinement.confinement import plugin_folders

EXAMPLE = Path(__file__).parents[3] / "examples" / "mylab" / "mylab"
Install = Callable[..., Plugin]


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Install]:
    """Installs a package whose module is this text, or the example; as pip does, and loads it into the
    catalog."""
    before = [kinds.added for kinds in LISTS.values()]

    def installed(
        text: str | None = None, name: str = "mylab", change: Callable[[Path], object] = id
    ) -> Plugin:
        site = tmp_path / name
        if text is None:
            shutil.copytree(EXAMPLE, site / "mylab")
        else:
            (site / "mylab").mkdir(parents=True)
            (site / "mylab" / "environments.py").write_text(text)
        change(site / "mylab")
        facts = site / f"{name}-0.1.0.dist-info"
        facts.mkdir()
        (facts / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 0.1.0\n")
        (facts / "entry_points.txt").write_text("[gaitway.environments]\nmylab = mylab.environments\n")
        monkeypatch.syspath_prepend(site)
        for module in [module for module in sys.modules if module.partition(".")[0] == "mylab"]:
            monkeypatch.delitem(sys.modules, module)
        points = [point for one in distributions(path=[str(site)]) for point in one.entry_points]
        plugin, *_ = plugins = load(points)
        monkeypatch.setattr(catalog, "PLUGINS", plugins)
        for row in plugin.rows:
            monkeypatch.setitem(catalog.ENVIRONMENTS, row.id, row)
        return plugin

    yield installed
    hold_only(before)
    for registry in (ROBOTS, OF_PLUGINS):
        registry.pop("mylab/monopod", None)
    for module in [module for module in sys.modules if module.partition(".")[0] == "mylab"]:
        del sys.modules[module]


def job(options: dict[str, Any], environment: str = "g1") -> Job:
    chosen = {"id": environment, "options": options}
    return make_job(environment=chosen)


UNEVEN = {"kind": "mylab/uneven_power", "weight": 0.01}


def test_the_term_of_a_package_goes_where_ours_go(install: Install) -> None:
    plugin = install()
    assert (plugin.problem, plugin.kinds, plugin.loads) == ("", ["mylab/uneven_power", "mylab/kick"], ())
    _, options = catalog.resolve("g1", {"reward": [{"kind": "track_linear_velocity"}, UNEVEN]})
    assert [term.weight for term in options.reward] == [1.0, 0.01]  # pyright: ignore
    schema = json.dumps(catalog.find("mjcf").options.model_json_schema())
    assert '"mylab/uneven_power"' in schema
    page = page_of_plugin(plugin)
    assert "| `mylab/uneven_power` | cost: max " in page
    assert "## `events`" in page
    with pytest.raises(Rejected) as refused:
        catalog.resolve("g1", {"reward": [{**UNEVEN, "weigth": 1}]})
    assert [problem.pointer for problem in refused.value.problems] == ["/environment/options/reward/0/weigth"]


def test_the_body_of_a_package_is_a_row_that_trains(install: Install) -> None:
    install()
    info, options = catalog.resolve("mylab/monopod", {})
    assert (info.family, info.observation_size, info.action_size, info.dt) == ("mylab", 8, 2, 0.02)
    environment = catalog.make(info, options, engine_builder("native"))
    state = environment.reset(jax.random.key(0))
    np.testing.assert_allclose(state.physics.qpos[2:], [0.4, -0.8], atol=0.02)
    state = environment.step(state, np.array([1.0, 0.0]))
    power = abs(state.physics.derived["qfrc_actuator"] * state.physics.qvel)
    expected = power.max() - power.mean()
    np.testing.assert_allclose(state.metrics["reward_uneven_power"], -0.001 * expected, rtol=1e-4)
    with pytest.raises(Rejected, match="no body 'trunc'"):
        catalog.resolve("mylab/monopod", {"root": "trunc"})


def test_a_body_brings_hyperparameters(install: Install) -> None:
    install()
    monopod = catalog.find("mylab/monopod")
    on_a_cpu = algorithms.tuned("ppo", monopod, "cpu")
    assert on_a_cpu["num_timesteps"] == 1_000_000  # As the body says,
    assert on_a_cpu["reward_scaling"] == MJCF["cpu"].reward_scaling  # and the rest as on `mjcf`.
    assert algorithms.tuned("ppo", monopod, "gpu")["num_timesteps"] == 50_000_000
    settings = algorithms.resolve(PPOSpec(num_envs=128), monopod, "cpu")
    assert (settings.num_envs, settings.num_timesteps) == (128, 1_000_000)


@pytest.mark.parametrize(
    ("tuned", "problem"),
    [
        ('{"ppo": {"cpu": {"num_env": 8}}}', "tuned.ppo.cpu.num_env: Extra inputs are not permitted."),
        (
            '{"ppo": {"tpu": {}}}',
            "tuned.ppo.tpu: there are the algorithms ppo, dqn, q_learning, sac, distillation, on cpu",
        ),
        ('{"ppo": {"gpu": {"num_envs": 100, "batch_size": 64}}}', "The body monopod: tuned.ppo.gpu: "),
    ],
)
def test_hyperparameters_that_no_job_could_take_are_refused(
    install: Install, tuned: str, problem: str
) -> None:
    def other(folder: Path) -> None:
        code = folder / "environments.py"
        code.write_text(code.read_text() + f"\nobject.__setattr__(MONOPOD, 'tuned', {tuned})\n")

    assert problem in install(change=other).problem


def test_the_table_of_the_example_is_that_of_its_model(install: Install) -> None:
    assert json.loads((EXAMPLE / TABLE).read_text()) == bodies_of_plugin(install())


def test_a_changed_model_needs_another_table(install: Install) -> None:
    def heavier(folder: Path) -> None:
        model = folder / "monopod.xml"
        model.write_text(model.read_text().replace('mass="3"', 'mass="4"'))

    plugin = install(change=heavier)
    assert "`gaitway plugins mylab --describe` writes" in plugin.problem
    with pytest.raises(EnvironmentNotFound, match=r"mylab 0\.1\.0 could not be loaded here"):
        catalog.find("mylab/monopod")
    with pytest.raises(Rejected, match=r"inventories\.json lacks the body monopod"):
        catalog.resolve("g1", {"reward": [UNEVEN]})


def test_a_job_needs_a_worker_that_has_the_package(install: Install) -> None:
    needs = packages_for(job({"reward": [UNEVEN]}))
    assert needs["mylab"] == "the terms and bodies mylab/…"
    assert "mylab" not in packages_here()
    with pytest.raises(Rejected, match="no package that is installed here has the entry point 'mylab'"):
        catalog.resolve("g1", {"reward": [UNEVEN]})
    plugin = install()
    assert "mylab" in packages_here()
    assert how_to_install("mylab") == "the Python package mylab, here 0.1.0"
    assert "mylab" in packages_for(job({}, "mylab/monopod"))
    assert catalog.plugin_versions("g1", {"reward": [UNEVEN]}) == {"mylab": f"0.1.0 (code {plugin.code})"}
    with pytest.raises(Rejected, match=r"it has mylab/uneven_power, .* Did you mean"):
        catalog.resolve("g1", {"reward": [{"kind": "mylab/uneven_powers"}]})


_OTHERS = """
from typing import Literal
from gaitway.environments import ActionTerm, CommandRange, CommandTerm, OfBody

class Spin(OfBody, CommandTerm):
    "How fast to turn: what is drawn, and how far the hip is bent."
    kind: Literal["mylab/spin"] = "mylab/spin"
    ranges = property(lambda self: [CommandRange("turn", "rad/s", -1.0, 1.0)])
    num_random = property(lambda self: 1)
    follows = property(lambda self: True)
    def drawn(self, uniform, step, model): return 2.0 * uniform - 1.0
    def told(self, target, step, model): return target + step.after.qpos[2:3]

class Alike(ActionTerm):
    "One number for both motors, less half of the knee's angle."
    kind: Literal["mylab/alike"] = "mylab/alike"
    def names(self, model): return ["push"]
    def controls(self, action, step, model):
        return (action[0] - 0.5 * step.after.qpos[3]) * step.xp.ones(model.model.nu)
"""
_TERM = """
from typing import Literal
from gaitway.environments import ActionTerm, CommandTerm, EventTerm
from gaitway.environments import CostTerm, ObservationTerm, RewardTerm, Term
class Mine({base}):
    kind: Literal["{kind}"] = "{kind}"
    {more}
"""
_MEASURE = "def measure(self, step, model): return 0.0"


def with_others(folder: Path) -> None:
    code = folder / "environments.py"
    code.write_text(code.read_text() + _OTHERS)


def test_a_command_and_an_action_of_a_package_go_where_ours_go(install: Install) -> None:
    assert not install(change=with_others).problem
    task = {
        "command": {"kind": "mylab/spin", "every_s": 0.02},
        "action": {"kind": "mylab/alike"},
        "observation": [{"kind": "command"}, {"kind": "previous_action"}],
        "reward": [{"kind": "control_cost", "of": "control"}],
    }
    info, options = catalog.resolve("mylab/monopod", task)
    assert [part.components for part in info.spaces.observation] == [("turn",), ("push",)]
    assert [part.components for part in info.spaces.action] == [("push",)]
    environment = catalog.make(info, options, engine_builder("native"))
    assert environment.action_size == 1
    before = environment.reset(jax.random.key(0))
    np.testing.assert_allclose(before.obs[0], before.info["target"][0] + before.physics.qpos[2], rtol=1e-6)
    after = environment.step(before, jnp.array([0.25]))
    assert after.info["target"] != before.info["target"]
    np.testing.assert_allclose(after.obs[0], after.info["target"][0] + after.physics.qpos[2], rtol=1e-6)
    control = 0.25 - 0.5 * before.physics.qpos[3]
    np.testing.assert_allclose(after.reward, -2.0 * control**2, rtol=1e-5)


def test_what_a_package_brings_is_checked_as_ours_is(install: Install) -> None:
    install(change=with_others)
    with pytest.raises(Rejected) as refused:
        catalog.resolve("mylab/monopod", {"command": {"kind": "mylab/spin", "body": "trunc"}})
    assert [problem.pointer for problem in refused.value.problems] == ["/environment/options/command/body"]
    for option, wrong in (("command", {"kind": "mylab/spim"}), ("events", [{"kind": "mylab/kik"}])):
        with pytest.raises(Rejected, match=r"mylab 0\.1\.0, which is installed here.*Did you mean"):
            catalog.resolve("mylab/monopod", {option: wrong})
    for option in ("action", "events"):
        wrong = {"kind": "yourlab/x"} if option == "action" else [{"kind": "yourlab/x"}]
        with pytest.raises(Rejected, match="no package that is installed here has the entry point 'yourlab'"):
            catalog.resolve("g1", {option: wrong})
    named = {"command": {"kind": "mylab/spin"}, "events": [{"kind": "mylab/kick"}]}
    assert "mylab" in packages_for(job(named))


def test_a_list_of_one_kind_names_the_package_that_is_not_there() -> None:
    with pytest.raises(Rejected, match="no package that is installed here has the entry point 'mylab'"):
        catalog.resolve("g1", {"events": [{"kind": "mylab/kick"}]})


def test_an_event_of_a_package_changes_the_velocities(install: Install) -> None:
    install()
    info, options = catalog.resolve(
        "mylab/monopod",
        {"events": [{"kind": "mylab/kick", "joints": ["hip"], "every_s": 0.02, "speed": 3.0}]},
    )
    environment = catalog.make(info, options, engine_builder("native"))
    assert isinstance(environment, TaskEnv)
    assert isinstance(options, TaskOptions)
    [kick] = options.events
    at_rest = environment.reset(jax.random.key(0))
    nothing = jnp.zeros(2)
    step = Step(at_rest.physics, at_rest.physics, nothing, nothing, environment.dt, jnp)
    parts = environment._parts  # pyright: ignore[reportPrivateUsage]
    np.testing.assert_allclose(kick.drawn(np.array([0.75]), step, parts), [0.0, 0.0, 1.5, 0.0])
    quiet = {"kind": "mylab/kick", "joints": ["hip"], "every_s": 0.02, "speed": 0.0}
    info, options = catalog.resolve("mylab/monopod", {"events": [quiet]})
    without = catalog.make(info, options, engine_builder("native"))
    moved = [one.step(at_rest, jnp.zeros(2)).physics.qpos[2] for one in (environment, without)]
    assert abs(moved[0] - moved[1]) > 1e-3


@pytest.mark.parametrize(
    ("code", "problem"),
    [
        ("import nowhere", "ModuleNotFoundError: No module named 'nowhere' (environments.py, line 1)"),
        ("raise SystemExit(3)", "SystemExit: 3 (environments.py, line 1)"),
        (_TERM.format(base="RewardTerm", kind="alive", more=_MEASURE), 'call it "mylab/…"'),
        (_TERM.format(base="RewardTerm", kind="mylab/x", more="pass"), "The term Mine has no `measure`."),
        (_TERM.format(base="ObservationTerm", kind="mylab/x", more=_MEASURE), "has no `size`"),
        (_TERM.format(base="Term", kind="mylab/x", more=_MEASURE), "none of the bases RewardTerm"),
        (
            _TERM.format(base="RewardTerm", kind="mylab/x", more=f"lock: type = int\n    {_MEASURE}"),
            "PydanticInvalidForJsonSchema",
        ),
        (_TERM.format(base="CommandTerm", kind="mylab/x", more="num_random = property(id)"), "no `ranges`"),
        (_TERM.format(base="EventTerm", kind="mylab/x", more="def drawn(self, *_): ..."), "no `num_random`"),
        (_TERM.format(base="ActionTerm", kind="mylab/x", more="def names(self, _): ..."), "no `controls`"),
        (
            "from gaitway.environments import Body\n"
            "DOG = Body('dog', file='dog.xml', description='', options={})",
            "The body dog has no file dog.xml beside the module.",
        ),
    ],
)  # fmt: skip
def test_a_broken_package_says_why_and_harms_nothing(install: Install, code: str, problem: str) -> None:
    assert problem in install(code).problem
    catalog.resolve("g1", {})
    assert not any(kinds.added for kinds in LISTS.values())


def test_a_field_of_its_own_may_be_called_like_ours(install: Install) -> None:
    target = f"target: float = 0.3\n    {_MEASURE}"
    install(_TERM.format(base="RewardTerm", kind="mylab/x", more=target))
    catalog.resolve("g1", {"reward": [{"kind": "track_linear_velocity"}, {"kind": "mylab/x", "target": 0.5}]})


def test_a_term_that_cannot_be_computed_ends_the_job_with_its_name(install: Install) -> None:
    install(
        _TERM.format(base="RewardTerm", kind="mylab/x", more="def measure(self, step, model): return 1 / 0")
    )
    page = catalog.find("inverted_pendulum")
    bad = TaskOptions.model_validate({"reward": [{"kind": "mylab/x"}]})
    row = replace(page, arguments={**page.arguments, "task": lambda _: bad})
    with pytest.raises(JobFailed, match=r"The term mylab/x cannot be computed\. ZeroDivisionError"):
        catalog.make(row, page.options(), engine_builder("native"))


def test_a_confined_process_may_read_a_package_that_lies_anywhere(install: Install, tmp_path: Path) -> None:
    install()
    assert list(plugin_folders()) == [tmp_path / "mylab" / "mylab"]


def test_without_a_package_the_list_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plugins, "installed", tuple)
    listed = CliRunner().invoke(app, ["plugins"])
    assert (listed.exit_code, listed.stdout) == (0, "No package here adds terms or bodies.\n")
