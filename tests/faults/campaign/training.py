"""A training process without physics, whose every byte follows from the job's seed.

A step hashes the state, prints a line and measures a row. It speaks and stops as the real one does. The job's
labels `steps` and `step_s` say how many there are, and how long each takes.
"""

import hashlib
import json
import os
import signal
import sys
import time
from pathlib import Path

TOTAL = 20
CHECKPOINT_EVERY = 5
STEP_S = 0.04


def state_after(seed: int, steps: int) -> str:
    """The state that a run has learned after so many steps."""
    state = f"seed {seed}"
    for step in range(1, steps + 1):
        state = hashlib.sha256(f"{state} {step}".encode()).hexdigest()
    return state


def checkpoint(seed: int, step: int) -> bytes:
    """The bytes of a checkpoint: large enough to be cut in transit."""
    return checkpoint_of(step, state_after(seed, step))


def main() -> None:
    spool, events = Path(sys.argv[1]), int(sys.argv[2])
    asked = set[int]()
    for number in (signal.SIGTERM, signal.SIGUSR1):
        signal.signal(number, lambda number, _: asked.add(number))

    def say(**message: object) -> None:
        os.write(events, json.dumps(message).encode() + b"\n")

    def keep(name: str, role: str, body: bytes, step: int) -> None:
        try:
            (spool / name).write_bytes(body)
        except OSError as error:
            say(type="failed", reason="storage_unavailable", message=str(error))
            sys.exit(1)
        say(type="file", name=name, path=name, role=role, media_type="application/octet-stream", step=step)

    say(type="hello", pid=os.getpid())
    task = json.loads((spool / "task.json").read_text())
    seed = task["spec"].get("seed", 0)
    step, state = 0, state_after(seed, 0)
    if task["checkpoint"]:
        saved = json.loads((spool / task["checkpoint"]).read_bytes().partition(b"\n")[0])
        step, state = saved["step"], saved["state"]
    say(type="started", device="cpu", engine="none", details={"resumed_at_step": step})
    labels = task["spec"].get("labels") or {}
    total, step_s = int(labels.get("steps", TOTAL)), float(labels.get("step_s", STEP_S))
    kept = step
    while step < total and not asked:
        time.sleep(step_s)
        step += 1
        state = hashlib.sha256(f"{state} {step}".encode()).hexdigest()
        print(f"attempt {task['attempt']} step {step}", flush=True)
        say(type="metrics", step=step, values={"training/state": float(int(state[:8], 16))})
        say(type="progress", step=step, total=total, steps_per_second=1 / step_s, eta_s=0.0)
        if step % CHECKPOINT_EVERY == 0:
            keep(f"checkpoint-{step:012d}.msgpack", "checkpoint", checkpoint_of(step, state), step)
            kept = step
    if kept != step:
        keep(f"checkpoint-{step:012d}.msgpack", "checkpoint", checkpoint_of(step, state), step)
    leaves = signal.SIGUSR1 in asked
    if not leaves:
        keep("policy", "policy", state.encode(), step)
    say(type="finished", stopped=leaves or (bool(asked) and step < total))


def checkpoint_of(step: int, state: str) -> bytes:
    return json.dumps({"step": step, "state": state}).encode() + b"\n" + bytes(100_000)


if __name__ == "__main__":
    from worker.host.processes import die_with_parent

    die_with_parent()
    main()
