"""The files of a policy for programs elsewhere: `policy.npz`, `policy.onnx`, `policy.robot.onnx` and
`simulation.json`.

With the last, the page steps the body itself (docs/push.md). What is done at checkpoints besides training is
kept to a share of the training's time.
"""

import json
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from functools import partial
from typing import Any

from core.algorithms.catalog import ALGORITHMS
from core.algorithms.export.contract import PolicyOrigin, contract
from core.algorithms.export.network import NotExportable, PolicyNetwork, network_of
from core.algorithms.export.numpy_file import numpy_file
from core.environments.deployment import Deployment, NotDeployed
from core.environments.environment import Environment, Wrapped
from core.environments.mujoco_env import MujocoEnv
from core.environments.simulated_model import NotSimulated
from core.environments.task import TaskEnv
from core.environments.wrappers.decoded import is_decoded
from core.jobs.spec import TrainSpec
from worker.protocol import Noted
from worker.training.built_environment import BuiltEnvironment
from worker.training.event_writer import EventWriter
from worker.training.prepared import Prepared

SIMULATION = "simulation.json"
_Writer = Callable[[PolicyNetwork, Mapping[str, Any]], bytes]
_NUMPY, _NUMPY_TYPE, _ONNX_TYPE = "policy.npz", "application/x-npz", "application/octet-stream"
_LAST, _BEST = "policy", "policy-best"


@dataclass(frozen=True)
class PolicyInTraining:
    """The policy of a training, or of one of its seeds.

    spec: of the training, or of the seed's own. events: where its files go. step: the environment steps that
    it has been trained for. content: the algorithm's own file of it as it is. seed: None where the training
    has a single one.
    """

    spec: TrainSpec
    events: EventWriter
    step: Callable[[], int]
    content: Callable[[], bytes]
    seed: int | None = None


@dataclass
class TimeBudget:
    """Says when another one may be done, by what the last one took.

    The first one also compiles or imports what the end of the job needs as well, so it says nothing about the
    next.
    """

    share: float = 0.03
    _is_prepared: bool = False
    _next_at: float = 0.0

    def allows_another(self) -> bool:
        """Whether the last one's cost has become a small share of the time since then."""
        return time.monotonic() >= self._next_at

    def spent(self, began: float) -> None:
        """Another one is done. began: its start, by `time.monotonic`."""
        now = time.monotonic()
        self._next_at = now + (now - began) / self.share if self._is_prepared else now
        self._is_prepared = True


def keep_simulation(document: Mapping[str, Any], events: EventWriter) -> None:
    """Keep the document of `simulation_document` as a file."""
    content = json.dumps(document, separators=(",", ":")).encode()
    facts = {"can_run": "refusal" not in document, "follows_commands": bool(document.get("command"))}
    events.keep(SIMULATION, content, "simulation", "application/json", metadata=facts)


def simulation_document(environment: Environment) -> dict[str, Any]:
    """The simulation of the body as its model says, or a refusal that says why it cannot be stepped; a
    randomised body differs from it in each episode."""
    try:
        if is_decoded(environment):
            raise NotSimulated("a decoder stands between its actions and the body, which the page lacks")
        return _document(_unwrapped(environment))
    except NotSimulated as error:
        return {"refusal": f"This body cannot be pushed: {error}."}


def _document(environment: Environment) -> dict[str, Any]:
    if not isinstance(environment, MujocoEnv):
        raise NotSimulated("its environment is that of another package")
    try:
        return environment.simulation().document()
    except (ValueError, RuntimeError) as error:  # Models of users may have anything in them.
        raise NotSimulated(f"its model cannot be written as XML: {error}") from error


def _unwrapped(environment: Environment) -> Environment:
    while isinstance(environment, Wrapped):
        environment = environment.environment
    return environment


@dataclass
class ExportWriter:
    """Keeps an attempt's exports, and the simulation that the page steps under them.

    Nothing for an algorithm whose policies have no such form.
    """

    algorithm: str
    built: BuiltEnvironment
    _has_simulation: bool = False
    _budget: TimeBudget = field(default_factory=TimeBudget)

    def __post_init__(self) -> None:
        self._simulation = Prepared(partial(simulation_document, self.built.environment))

    def prepare(self) -> None:
        """Begin to make the simulation, in a thread."""
        if ALGORITHMS[self.algorithm].no_export is None:
            self._simulation.begin()

    def keep_newest(self, policies: Sequence[PolicyInTraining]) -> None:
        """Replace the `policy.npz` of each by the one of a checkpoint, where that costs next to nothing.

        A policy that has no such file is left to the end, which says why.
        """
        if ALGORITHMS[self.algorithm].no_export is not None or not self._budget.allows_another():
            return
        began = time.monotonic()
        for policy in policies:
            self._keep_simulation(policy)
            with suppress(NotExportable):
                step = policy.step()
                content = self._written(policy.content(), step, numpy_file)
                policy.events.keep(_NUMPY, content, "export", _NUMPY_TYPE, step=step)
        self._budget.spent(began)

    def keep_last(self, policy: PolicyInTraining, content: bytes) -> None:
        """Keep the files. One that cannot be written is a note: the job has its policy."""
        if ALGORITHMS[self.algorithm].no_export is None:
            self._keep_files(_LAST, policy, content, policy.step())
            self._keep_simulation(policy)

    def keep_best(self, policy: PolicyInTraining, content: bytes, step: int) -> None:
        """Keep the files of the best evaluation's policy. content, step: as they were then."""
        if ALGORITHMS[self.algorithm].no_export is None:
            self._keep_files(_BEST, policy, content, step)

    def _keep_files(self, stem: str, policy: PolicyInTraining, content: bytes, step: int) -> None:
        # Their import takes 0.3 s, which no start waits for.
        from core.algorithms.export.onnx_file import onnx_file
        from core.algorithms.export.robot_file import policy_metadata, robot_file

        robot = self._robot()
        metadata = {} if robot is None else policy_metadata(robot)
        writers: dict[str, tuple[_Writer, str]] = {
            f"{stem}.npz": (numpy_file, _NUMPY_TYPE),
            f"{stem}.onnx": (lambda network, about: onnx_file(network, about, metadata), _ONNX_TYPE),
        }
        if robot is not None:
            writers[f"{stem}.robot.onnx"] = (
                lambda network, about: robot_file(network, robot, about),
                _ONNX_TYPE,
            )
        for name, (write, media_type) in writers.items():
            try:
                file = self._written(content, step, write)
                policy.events.keep(name, file, "export", media_type, step=step)
            except NotExportable as error:
                policy.events.send(Noted(text=f"There is no {name}: {error}."))

    def _robot(self) -> Deployment | None:
        """The task as a robot runs it; None where it has no such form."""
        environment = _unwrapped(self.built.environment)
        if not isinstance(environment, TaskEnv) or is_decoded(self.built.environment):
            return None
        try:
            return environment.deployment()
        except NotDeployed:
            return None

    def _keep_simulation(self, policy: PolicyInTraining) -> None:
        if not self._has_simulation:
            keep_simulation(self._simulation.value(), policy.events)
            self._has_simulation = True

    def _written(self, policy: bytes, step: int, write: _Writer) -> bytes:
        """policy: the algorithm's own file. Raises NotExportable."""
        network, info, robot = network_of(policy), self.built.info, self._robot()
        origin = PolicyOrigin(
            algorithm=self.algorithm,
            environment=info.id,
            options=info.option_values.model_dump(mode="json"),
            step_s=self.built.environment.dt,
            trained_steps=step,
            observation_parts=[asdict(part) for part in info.spaces.group(network.observation_name)],
            action_parts=[asdict(part) for part in info.spaces.action],
            robot=None if robot is None else robot.document(),
        )
        return write(network, contract(network, origin))
