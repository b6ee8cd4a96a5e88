"""What a run does before its first update, and what a second run on the machine need not do again."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from core.algorithms.compiled_functions import trace
from core.algorithms.dqn.learner import DQN
from core.algorithms.dqn.learner import Learner as DQNLearner
from core.algorithms.ppo.learner import PPO, Learner
from core.algorithms.sac.learner import SAC
from core.algorithms.sac.learner import Learner as SACLearner
from tests import probes
from tests.compiling import compiling_quickly
from tests.extra import extra
from tests.learning.dqn_runs import dqn_settings
from tests.learning.runs import small_settings
from tests.learning.sac_runs import sac_settings


@pytest.mark.parametrize(
    ("algorithm", "learner", "settings"),
    [
        (PPO, Learner, small_settings()),
        *extra((SAC, SACLearner, sac_settings()), (DQN, DQNLearner, dqn_settings())),
    ],
    ids=["ppo", "sac", "dqn"],
)
def test_an_update_is_traced_once(
    algorithm: Any, learner: Any, settings: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    # The loop over updates needs the update's shapes before it, and the update in it.
    times = 0
    update = learner.update

    def counted(*arguments: object) -> object:
        nonlocal times
        times += 1
        return update(*arguments)

    monkeypatch.setattr(learner, "update", counted)
    trace(algorithm(probes.endless(), settings, seed=0))
    assert times == 1


# What may be another number without being another program.
CHANGES = {
    "learning_rate": 2e-3,
    "discounting": 0.9,
    "reward_scaling": 0.1,
    "seed": 7,
    "num_timesteps": 1024,
    "checkpoint_every_steps": 512,
}
CHANGES_OF = {
    "ppo": {
        "entropy_cost": 0.1,
        "clipping_epsilon": 0.2,
        "gae_lambda": 0.9,
        "vf_loss_coefficient": 0.25,
        "max_grad_norm": 1.0,
    },
    "sac": {"tau": 0.1, "target_entropy_per_action": -1.0},
    "dqn": {"tau": 0.1, "epsilon": {"start": 0.9, "end": 0.1, "decay_decisions": 100}},
}


@pytest.mark.extra
@pytest.mark.parametrize("algorithm", CHANGES_OF)
def test_a_second_process_compiles_no_program_with_native_physics_whatever_numbers_changed(
    algorithm: str, tmp_path: Path
) -> None:
    first, second = (start(tmp_path, algorithm, changes) for changes in ({}, CHANGES | CHANGES_OF[algorithm]))
    assert first["hits"] == 0
    for name in ("init", "epoch", "evaluate"):
        assert any(file.name.startswith(f"jit_{name}-") for file in tmp_path.iterdir())
    assert second["misses"] == 0
    assert second["hits"] == first["misses"]
    # Of Brax only the training code is loaded, without physics that would take as long as all the rest.
    assert second["physics"] == []


def start(cache: Path, algorithm: str, changes: dict[str, Any]) -> dict[str, Any]:
    """The output of a process that trains with these changes."""
    said = subprocess.run(
        [sys.executable, "-m", "tests.learning.start_process", str(cache), algorithm, json.dumps(changes)],
        env={**os.environ, **compiling_quickly(), "JAX_PLATFORMS": "cpu"},
        stdout=subprocess.PIPE,
        check=True,
    )
    return json.loads(said.stdout.splitlines()[-1])
