"""A run that is as fast as its learning rate: `python -m tests.unit.bench.tune_probe FOLDER`."""

import json
import sys
from pathlib import Path

request = json.loads(Path(sys.argv[1], "request.json").read_text())
settings, seed = request["settings"], request["seed"]
if settings["learning_rate"] == 2.5e-3:
    sys.exit("It broke." if settings["activation"] == "elu" else "core.errors.JobFailed: it diverged.")
# A seed from 2,000 on is slower.
speed = 1_000.0 * settings["learning_rate"] / (2.0 if seed >= 2_000 else 1.0)
for second in range(1, 101):
    print("a line of something else")
    print(json.dumps([100 * second, second * speed, float(second)]), flush=True)
