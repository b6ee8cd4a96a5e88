"""A policy for the corridor, tried without noise: `python -m bench.try_corridor CHECKPOINT JOB.json`.

CHECKPOINT is a file of a job's, JOB.json the job's specification; `--set arena_seed=7` changes an option of
the corridor. It prints what `bench.ours.train_layouts.trial` says of the episodes, on the engine `native`.
"""

import argparse
import json
from pathlib import Path

from bench.ours.train_layouts import trial
from core.algorithms.policy import policy_from_checkpoint
from core.environments import catalog
from core.physics.choose import engine_builder
from gaitway.cli.submit import assigned


def main() -> None:
    """Print one line of JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("checkpoint", type=Path)
    parser.add_argument("job", type=Path)
    parser.add_argument("--episodes", type=int, default=16, metavar="N")
    parser.add_argument("--steps", type=int, default=2500, metavar="N", help="control steps of an episode")
    parser.add_argument("--set", dest="assignments", action="append", default=[], metavar="OPTION=VALUE")
    arguments = parser.parse_args()
    options = json.loads(arguments.job.read_bytes())["environment"]["options"]
    for text in arguments.assignments:
        assigned(options, text)
    environment = catalog.make(*catalog.resolve("corridor", options), engine_builder("native"))
    policy = policy_from_checkpoint(arguments.checkpoint.read_bytes())
    print(json.dumps(trial(policy, environment, num_episodes=arguments.episodes, num_steps=arguments.steps)))


if __name__ == "__main__":
    main()
