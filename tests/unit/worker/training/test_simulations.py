"""What a training hands over for the page's physics."""

import json
import os
from pathlib import Path
from typing import Any

from core.environments.environment import Environment
from core.environments.wrappers.domain_randomization import RandomizedEnvironment
from tests.probes import endless
from tests.unit.environments.test_simulation import of_the_catalog
from worker.training.event_writer import EventWriter
from worker.training.exports import keep_simulation, simulation_document


def handed_over(spool: Path, environment: Environment) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """The messages, and the file."""
    read, write = os.pipe()
    events = EventWriter(spool, write)
    keep_simulation(simulation_document(environment), events)
    events._pipe.close()
    with os.fdopen(read) as pipe:
        said = [json.loads(line) for line in pipe]
    return said, json.loads((spool / "simulation.json").read_bytes())


def test_a_body_is_told_as_it_is_before_it_is_randomised(tmp_path: Path) -> None:
    hopper = of_the_catalog("hopper")
    [message], document = handed_over(tmp_path, RandomizedEnvironment(hopper, {}))
    assert (message["role"], message["media_type"]) == ("simulation", "application/json")
    assert message["metadata"] == {"can_run": True, "follows_commands": False}
    assert document["format"] == "gaitway-simulation"
    assert document == json.loads(json.dumps(hopper.simulation().document()))


def test_another_body_has_a_file_that_says_why_it_cannot_be_pushed(tmp_path: Path) -> None:
    [message], document = handed_over(tmp_path, endless())
    assert message["metadata"] == {"can_run": False, "follows_commands": False}
    assert document["refusal"].startswith("This body cannot be pushed: ")
    assert document["refusal"].endswith(".")
