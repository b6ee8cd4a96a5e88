"""The environment of a task: on which GPUs of its worker, and on which engine."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jax
import pytest

from core.environments.task import TaskEnv
from core.errors import JobFailed
from core.jobs.spec import JOB_SPEC
from core.physics.availability import EngineName, PhysicsChoice
from worker.protocol import Task
from worker.training.built_environment import build_environment


def task(device: str) -> Task:
    spec = {
        "kind": "train",
        "environment": "inverted_pendulum",
        "physics": "native",
        "resources": {"gpus": 2},
    }
    return Task(job_id="j", attempt=1, spec=JOB_SPEC.validate_python(spec), device=device)


def pretend(monkeypatch: pytest.MonkeyPatch, *kinds: str) -> None:
    gpus = [SimpleNamespace(platform="gpu", device_kind=kind, process_index=0) for kind in kinds]
    monkeypatch.setattr(jax, "devices", lambda: gpus)


def test_it_calls_its_gpus_by_number_and_kind(monkeypatch: pytest.MonkeyPatch) -> None:
    pretend(monkeypatch, *["NVIDIA H200"] * 2)
    built = build_environment(task("gpu:2,3"))
    assert (built.num_devices, built.device_name, built.device) == (2, "2 × NVIDIA H200", "gpu")


def test_a_gpu_alone_is_called_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    pretend(monkeypatch, "NVIDIA H200")
    built = build_environment(task("gpu:2"))
    assert (built.num_devices, built.device_name) == (1, "NVIDIA H200")


def test_fewer_gpus_than_the_worker_serves_end_the_job_with_what_there_is(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    pretend(monkeypatch, "NVIDIA H200", "NVIDIA A2")
    with pytest.raises(JobFailed) as failure:
        build_environment(task("gpu:0,1,2"))
    assert failure.value.reason == "device_failed"
    assert failure.value.detail == ("The worker serves gpu:0,1,2, but JAX finds only NVIDIA H200, NVIDIA A2.")


@pytest.mark.extra
def test_a_job_that_goes_on_takes_the_engine_of_its_checkpoint_where_the_choice_is_left_to_auto() -> None:
    spec = JOB_SPEC.validate_python({"kind": "train", "environment": "inverted_pendulum"})
    begun = Task(job_id="j", attempt=2, spec=spec, device="cpu", begun_on="mjx")
    assert build_environment(begun).engine == "mjx"
    asked_for = spec.model_copy(update={"physics": "native"})
    assert build_environment(begun.model_copy(update={"spec": asked_for})).engine == "native"


@pytest.mark.parametrize(
    ("physics", "source_engine", "engine"),
    [
        # Environments that `warp` moved go on under no other, and `compiled` takes those of `native`.
        ("auto", "warp", "warp"),
        ("auto", "native", "compiled"),
        ("native", "mjx", "native"),
    ],
)
def test_a_job_that_resumes_from_another_gets_an_engine_that_can_go_on(
    physics: PhysicsChoice, source_engine: EngineName, engine: str
) -> None:
    spec = JOB_SPEC.validate_python({"kind": "train", "environment": "hopper", "physics": physics})
    task = Task(job_id="j", attempt=1, spec=spec, device="cpu", source_engine=source_engine)
    assert build_environment(task).engine == engine


def test_training_and_rollout_share_the_engine_that_auto_takes_and_a_begun_training_keeps_its_own() -> None:
    zero = {"kind": "rollout", "environment": "hopper", "policy": {"kind": "zero"}, "num_episodes": 1}
    for fields in ({"kind": "train", "environment": "hopper"}, zero):
        spec = JOB_SPEC.validate_python(fields)
        assert build_environment(Task(job_id="j", attempt=1, spec=spec, device="cpu")).engine == "compiled"
    # A job of before, when `auto` took `native` on a CPU, resumes to the same bits.
    spec = JOB_SPEC.validate_python({"kind": "train", "environment": "hopper"})
    begun = Task(job_id="j", attempt=2, spec=spec, device="cpu", begun_on="native")
    assert build_environment(begun).engine == "native"


def test_the_record_has_the_versions_of_what_the_engine_needs() -> None:
    spec = JOB_SPEC.validate_python({"kind": "train", "environment": "inverted_pendulum"})
    native = build_environment(Task(job_id="j", attempt=1, spec=spec, device="cpu"))
    for engine, also in (("native", set[str]()), ("warp", {"warp-lang"}), ("compiled", {"llvmlite"})):
        versions = replace(native, engine=engine).started().details["versions"]
        assert set(versions) == {"gaitway", "jax", "brax", "mujoco", "mujoco-mjx"} | also


# A ball on the floor; `far` looks for the nearest geom, which `compiled` does not compute.
OWN = """
<mujoco>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 1"/>
    <body name="wheel" pos="1 0 1">
      <joint name="axle"/>
      <geom type="sphere" size="0.1" contype="0" conaffinity="0"/>
    </body>
    <body name="ball" pos="0 0 0.1">
      <freejoint/>
      <geom name="ball" type="sphere" size="0.1"/>
      <site name="eye" pos="0 0 0.2"/>
    </body>
  </worldbody>
  <actuator><general name="motor" joint="axle" dyntype="filterexact" dynprm="0.1"/></actuator>
  <sensor><rangefinder name="far" site="eye"/><gyro name="turn" site="eye"/></sensor>
</mujoco>
"""
OPTIONS = {"model": f"sha256:{'0' * 64}", "reward": [{"kind": "alive"}], "termination": []}


def own(folder: Path, options: Mapping[str, Any] = {}, **fields: Any) -> Task:
    """A training of the model on a CPU, as its worker hands it on."""
    (folder / "model").write_text(OWN)
    environment = {"id": "mjcf", "options": {**OPTIONS, **options}}
    spec = JOB_SPEC.validate_python({"kind": "train", "environment": environment, **fields})
    return Task(job_id="j", attempt=1, spec=spec, device="cpu", model=str(folder / "model"))


def test_auto_takes_compiled_for_a_users_model_with_many_environments(tmp_path: Path) -> None:
    assert build_environment(own(tmp_path)).engine == "compiled"
    few = {"kind": "ppo", "num_envs": 32, "batch_size": 32, "num_minibatches": 1}
    assert build_environment(own(tmp_path, algorithm=few)).engine == "native"
    refused = own(tmp_path).model_copy(update={"engines_that_cannot": {"compiled": "It is too large."}})
    assert build_environment(refused).engine == "native"
    begun = own(tmp_path).model_copy(update={"begun_on": "native"})
    assert build_environment(begun).engine == "native"


READS = {"observation": [{"kind": "sensors"}]}
LAGS = [{"field": "actuator_dynprm", "operation": "scale", "range": [0.5, 2.0]}]


@pytest.mark.parametrize(
    ("options", "fields", "why"),
    [
        (READS, {}, "sensordata: its sensor 'far' is of the kind rangefinder"),
        ({}, {"randomization": LAGS}, "actuator_dynprm: its actuator 'motor' is an exact filter"),
    ],
)
def test_where_compiled_lacks_what_a_job_reads_or_randomises_auto_takes_native_and_says_why(
    tmp_path: Path, options: Mapping[str, Any], fields: Mapping[str, Any], why: str
) -> None:
    built = build_environment(own(tmp_path, options, **fields))
    assert built.engine == "native"
    assert built.engine_reason == f"The engine 'compiled' cannot run the model: {why}."
    with pytest.raises(JobFailed, match=why.partition(":")[0]):
        build_environment(own(tmp_path, options, physics="compiled", **fields))


def test_a_sensor_that_a_job_does_not_read_keeps_no_engine_from_it(tmp_path: Path) -> None:
    """Issue 41, an IMU: a job that read another sensor, or counted contacts, fell to `native`."""
    turns = {"observation": [{"kind": "sensors", "names": ["turn"]}]}
    touches = {"reward": [{"kind": "contact", "geoms": ["ball"]}]}
    for reads, num_read in ((turns, 3), (touches, 1)):
        built = build_environment(own(tmp_path, reads))
        assert built.engine == "compiled"
        assert isinstance(built.environment, TaskEnv)
        assert built.environment.model.nsensordata == num_read


def test_what_no_engine_can_run_fails_as_before(tmp_path: Path) -> None:
    with pytest.raises(JobFailed, match="has no body 'nobody'"):
        build_environment(own(tmp_path, {"root": "nobody"}))
