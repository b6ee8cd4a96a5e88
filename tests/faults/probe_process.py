"""A stand-in for the training process: does what its first argument says. No numerical stack."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

from worker.stopping import DRAIN_SIGNAL, STOP_SIGNAL

behaviour, spool, events_fd = sys.argv[1], Path(sys.argv[2]), int(sys.argv[3])
asked = set[int]()

for wish in (STOP_SIGNAL, DRAIN_SIGNAL):
    signal.signal(
        wish, signal.SIG_IGN if behaviour == "ignores_signals" else lambda number, _: asked.add(number)
    )


def say(**message: object) -> None:
    os.write(events_fd, json.dumps(message).encode() + b"\n")


def keep(name: str, role: str, body: bytes, step: int | None = None, **facts: object) -> None:
    (spool / name).write_bytes(body)
    media_type = "application/octet-stream"
    say(type="file", name=name, path=name, role=role, media_type=media_type, step=step, metadata=facts)


say(type="hello", pid=os.getpid())
say(type="started", device="probe", engine="none", details={"answer": 42})
match behaviour:
    case "succeeds":
        print("a line of the log", flush=True)
        for step in (10, 20):
            say(type="metrics", step=step, values={"eval/episode_reward": float(step)})
            say(type="progress", step=step, total=20, steps_per_second=5.0, eta_s=0.0)
            keep(f"checkpoint-{step:012d}.msgpack", "checkpoint", b"state %d" % step, step)
        say(type="finished")
    case "is_filmed":
        say(
            type="started",
            device="probe",
            engine="none",
            details={"hyperparameters": {"learning_rate": 0.25}},
        )
        while "PROBE_WAITS_FOR" in os.environ and not Path(os.environ["PROBE_WAITS_FOR"]).exists():
            time.sleep(0.01)
        for step in (10, 20):
            say(type="metrics", step=step, values={"eval/episode_reward": step / 4})
        keep("policy", "policy", b"weights", 20)
        keep("video.mp4", "video", b"film", 20)
        say(type="finished")
    case "is_killed_after_a_measurement":
        say(type="started", device="probe", engine="none")
        while not Path(os.environ["PROBE_WAITS_FOR"]).exists():
            time.sleep(0.01)
        say(type="metrics", step=5, values={"eval/episode_reward": 0.5})
        os.kill(os.getpid(), signal.SIGKILL)
    case "compiles" | "compiles_and_crashes":
        Path("cache/jax").mkdir(parents=True, exist_ok=True)
        Path("cache/jax/compiled").write_bytes(b"another program")
        if behaviour == "compiles_and_crashes":
            sys.exit(3)
        say(type="phase", name="compile", seconds=0.1)
        say(type="finished")
    case "waits" | "ignores_signals":
        keep("checkpoint-000000000010.msgpack", "checkpoint", b"state", 10)
        while not asked:
            time.sleep(0.01)
        keep("checkpoint-000000000020.msgpack", "checkpoint", b"state", 20)
        if STOP_SIGNAL in asked:
            keep("video.mp4", "video", b"film", 20)
        say(type="finished", stopped=True)
    case "waits_for_its_job":
        say(type="started", device=os.environ["CUDA_VISIBLE_DEVICES"], engine="none")
        while not asked and not Path(os.environ["PROBE_WAITS_FOR"], spool.name.partition(".")[0]).exists():
            time.sleep(0.01)
        say(type="finished", stopped=bool(asked))
    case "has_nothing_new_to_keep":
        signal.signal(DRAIN_SIGNAL, signal.SIG_DFL)
        keep("checkpoint-000000000010.msgpack", "checkpoint", b"state", 10)
        signal.pause()
    case "misses_the_first_word_to_go":
        signal.signal(DRAIN_SIGNAL, lambda number, _: signal.signal(number, signal.SIG_DFL))
        keep("checkpoint-000000000010.msgpack", "checkpoint", b"state", 10)
        while True:
            signal.pause()
    case "goes_on_from_a_checkpoint":
        task = json.loads((spool / "task.json").read_text())
        body = (spool / task["checkpoint"]).read_bytes() if task["checkpoint"] else b"nothing"
        keep("policy", "policy", body, task["checkpoint_step"])
        say(type="finished")
    case "says_what_it_runs_on_and_is_killed":
        hyperparameters = {"kind": "ppo", "num_envs": 64, "learning_rate": 0.125, "of_another_version": 1}
        say(type="started", device="cpu × 2", engine="mjx", details={"hyperparameters": hyperparameters})
        keep("checkpoint-000000000010.msgpack", "checkpoint", b"state", 10)
        os.kill(os.getpid(), signal.SIGKILL)
    case "keeps_its_task":
        keep("policy", "policy", (spool / "task.json").read_bytes(), 0)
        say(type="finished")
    case "is_evaluated_and_killed":
        keep("policy-best", "best_policy", b"the best", 10, **{"return": 81.5})
        os.kill(os.getpid(), signal.SIGKILL)
    case "shows_the_best_before":
        best = next(iter(json.loads((spool / "task.json").read_text())["best"]), None)
        body = (spool / best.pop("path")).read_bytes() if best and best.pop("seed") is None else b"nothing"
        keep("policy", "policy", body, 0, best=best)
        say(type="finished")
    case "fails":
        say(type="failed", reason="diverged", message="The reward became non-finite at environment step 7.")
        sys.exit(1)
    case "crashes":
        print("Traceback: something", flush=True)
        sys.exit(3)
    case "says_a_line_and_waits":
        print("it runs", flush=True)
        signal.pause()
    case "takes_memory":
        taken: list[bytearray] = []
        while len(taken) < 256:  # 4 GiB: nobody would stop it.
            taken.append(bytearray(b"x") * 2**24)
            time.sleep(0.02)
    case "crashes_natively" | "breaks_its_device":
        if behaviour == "breaks_its_device":
            Path(os.environ["PROBE_DEVICE_WORKS"]).unlink()
        # Without a word of Python's own, and no core file.
        signal.signal(signal.SIGSEGV, signal.SIG_DFL)
        os.kill(os.getpid(), signal.SIGSEGV)
    case "is_killed":
        keep("checkpoint-000000000010.msgpack", "checkpoint", b"state", 10)
        os.kill(os.getpid(), signal.SIGKILL)
    case "leaves_a_child":
        child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(1000)"])
        keep("summary.json", "summary", str(child.pid).encode())
        say(type="finished")
    case "prints_much" | "floods":
        # 3 and 10 MB.
        for _ in range(15_000 if behaviour == "prints_much" else 50_000):
            print("x" * 199)
        say(type="finished")
    case _:
        raise SystemExit(f"no such behaviour: {behaviour}")
