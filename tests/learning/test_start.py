"""What a run does before its first update, and what a second run on the machine need not do again."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from core.algorithms.ppo.programs import trace
from core.algorithms.ppo.update import Hyperparameters, Learner
from core.environments import probes
from tests.learning.runs import small_settings
from tests.learning.start_process import run


def test_an_update_is_traced_once(monkeypatch: pytest.MonkeyPatch) -> None:
    # The loop over updates needs the update's shapes before it, and the update in it.
    times = 0
    update = Learner.update

    def counted(*arguments: object) -> object:
        nonlocal times
        times += 1
        return update(*arguments)  # pyright: ignore

    monkeypatch.setattr(Learner, "update", counted)
    settings = small_settings()
    trace(Learner(probes.endless(), settings), Hyperparameters.of(settings))
    assert times == 1


def test_a_second_process_compiles_no_program_with_native_physics(compiled_programs: Path) -> None:
    run(learning_rate=1e-3)
    kept = {file.name for file in compiled_programs.iterdir()}
    for name in ("init", "epoch", "evaluate"):
        assert any(file.startswith(f"jit_{name}-") for file in kept)
    said = subprocess.run(
        [sys.executable, "-m", "tests.learning.start_process", str(compiled_programs)],
        env={**os.environ, "JAX_PLATFORMS": "cpu"},
        stdout=subprocess.PIPE,
        check=True,
    )
    answer = json.loads(said.stdout.splitlines()[-1])
    # Another learning rate is the same program.
    assert answer["misses"] == 0
    assert answer["hits"] >= 3
    # Of Brax only the training code is loaded, without physics that would take as long as all the rest.
    assert answer["physics"] == []
