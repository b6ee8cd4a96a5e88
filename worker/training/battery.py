"""The battery of a trained policy, as a file and as metrics. It ends no job: an error in it is a note."""

import json
import traceback
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from statistics import fmean
from typing import Any, cast

from core.algorithms.battery.clips import ClipBattery
from core.algorithms.battery.result import BatteryResult
from core.algorithms.battery.run import Battery
from core.algorithms.battery.spec import BatterySpec
from core.algorithms.events import metric_of_seed
from core.algorithms.trained_policy import TrainedPolicy, load_policy
from core.environments.task import TaskEnv
from core.environments.terms.task import TaskOptions
from core.jobs.spec import RolloutSpec, TrainSpec
from worker.protocol import Measured, Noted
from worker.training.built_environment import BuiltEnvironment
from worker.training.event_writer import EventWriter
from worker.training.exports import PolicyInTraining
from worker.training.prepared import Prepared

BATTERY = "battery.json"


@dataclass
class BatteryWriter:
    """Tests policies as the job asks, and keeps each result as `battery.json`.

    is_stopped: whether the job is to end; a battery is then given up, and nothing of it is kept.
    """

    battery: BatterySpec
    built: BuiltEnvironment
    is_stopped: Callable[[], bool]
    _compiled: Prepared[Battery | ClipBattery] | None = None

    def prepare(self, policy: PolicyInTraining) -> None:
        """Begin to compile it, in a thread, for policies such as this one."""
        algorithm, content = policy.spec.algorithm.algorithm(), policy.content()
        self._compiled = Prepared(lambda: self._battery(load_policy(content, algorithm, is_checkpoint=False)))
        self._compiled.begin()

    def test_trained(self, policies: Sequence[PolicyInTraining]) -> None:
        """Test each policy as it is now. Of several seeds a metric's plain name is the mean over them."""
        by_name = defaultdict[str, list[float]](list)
        for policy in policies:
            metrics = self.test(policy.spec, partial(_loaded, policy), policy.step(), policy.events)
            for name, value in metrics.items():
                by_name[name].append(value)
            if metrics and policy.seed is not None:
                of_seed = {metric_of_seed(policy.seed, name): value for name, value in metrics.items()}
                policy.events.send(Measured(step=policy.step(), values=dict(of_seed)))
        if by_name:
            means = {name: fmean(values) for name, values in by_name.items()}
            policies[0].events.send(Measured(step=policies[0].step(), values=dict(means)))

    def test(
        self,
        spec: TrainSpec | RolloutSpec,
        load: Callable[[], TrainedPolicy],
        step: int | None,
        events: EventWriter,
    ) -> dict[str, float]:
        """Test one policy; its metrics, none where there is no result. step: that it was trained for."""
        try:
            policy = load()
            if self._compiled is None:
                self._compiled = Prepared(partial(self._battery, policy))
            battery = self._compiled.value()
            result = battery.run(policy.parameters, seed=spec.seed, is_stopped=self.is_stopped)
        except Exception as error:  # The job has its policy; what its test meets must not take it away.
            traceback.print_exc()
            line = str(error).splitlines()[0][:500] if str(error) else ""
            events.send(Noted(text=f"There is no battery: {type(error).__name__}: {line}"))
            return {}
        if result is None:
            events.send(Noted(text="There is no battery: the job was stopped meanwhile."))
            return {}
        facts = result.model_dump(mode="json")
        whole = {**facts, "step": step, **self._origin(spec)}
        events.keep(
            BATTERY, _as_json(whole), "battery", "application/json", step=step, metadata=_shown(facts)
        )
        return metrics_of(result)

    def _battery(self, policy: TrainedPolicy) -> Battery | ClipBattery:
        task = cast("TaskOptions", self.built.task)
        kind = Battery if task.reference is None else ClipBattery
        return kind(
            lambda tested: cast("TaskEnv", self.built.doing(tested, "native")),
            task,
            policy,
            self.battery,
        )

    def _origin(self, spec: TrainSpec | RolloutSpec) -> dict[str, Any]:
        """What the numbers depend on, besides the policy."""
        environment = {
            "id": spec.environment.id,
            "options": self.built.job.options.model_dump(mode="json"),
        }
        return {"environment": environment, "versions": self.built.versions, "commit": self.built.commit}


def _loaded(policy: PolicyInTraining) -> TrainedPolicy:
    return load_policy(policy.content(), policy.spec.algorithm.algorithm(), is_checkpoint=False)


def metrics_of(result: BatteryResult) -> dict[str, float]:
    """`battery/passed`, 1 or 0, and the judged quantities by name."""
    values = {f"battery/{one.quantity}": one.value for one in result.criteria}
    return {
        "battery/passed": float(result.passed),
        **{name: value for name, value in values.items() if value is not None},
    }


def _shown(facts: dict[str, Any]) -> dict[str, Any]:
    """What the page, the report and the terminal show."""
    return {name: facts[name] for name in ("passed", "criteria", "commands", "clips", "spec", "took_s")}


def _as_json(document: dict[str, Any]) -> bytes:
    return json.dumps(document, allow_nan=False).encode()
