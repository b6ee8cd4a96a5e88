"""A model in its confined process: what is found in it, and what it cannot do to the worker."""

import dataclasses
import os
import re
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import mujoco
import psutil
import pytest

from core.adapters.postgres.store import PostgresJobStore
from core.environments.mjcf.model import SLEEP_IS_OFF, read
from core.environments.task_model import compiled
from core.environments.terms.describe import inventory
from core.errors import BadModel, ModelNotFound
from core.jobs.job import utc_now
from core.physics import trial
from core.physics.trial import EngineDifference
from core.storage import keys
from core.uploads import library
from core.user_models.record import Description
from tests import models
from tests.extra import extra
from tests.in_memory import MemoryJobQueue, MemoryObjectStore
from tests.unit.environments.mjcf.probe import XML
from tests.unit.environments.mjcf.test_archive import zipped
from worker.confinement.confinement import Limits
from worker.validation import confined, trials
from worker.validation.answer import ModelAnswer, read_answer
from worker.validation.confined import look, validate
from worker.validation.findings import findings

# Nothing can be driven.
ROLLS = b'<mujoco><worldbody><body><freejoint/><geom size="1"/></body></worldbody></mujoco>'
NO_MOTOR = XML.replace(
    b'<motor name="elbow" joint="elbow" gear="2" ctrllimited="true" ctrlrange="-0.5 1.5"/>', b""
)
# Two shapes on legs that touch each other without friction, which the engine `compiled` has not.
TOUCHING = b"""<mujoco>
  <worldbody><body name="trunk" pos="0 0 0.5"><freejoint/><geom size="0.05"/>
    <body name="left" pos="0 0.1 0"><joint name="left" axis="0 1 0"/>
      <geom type="cylinder" size="0.02 0.05" pos="0 0 -0.3" friction="0"/></body>
    <body name="right" pos="0 -0.1 0"><joint name="right" axis="0 1 0"/>
      <geom type="box" size="0.02 0.02 0.02" pos="0 0 -0.33" friction="0"/></body>
  </body></worldbody>
  <actuator><motor joint="left" ctrlrange="-3 3"/><motor joint="right" ctrlrange="-3 3"/></actuator>
</mujoco>"""
# Nine million geoms, written in 200 bytes.
SLOW = XML.replace(
    b'<body name="ball"',
    b'<replicate count="3000" euler="0 0 1"><replicate count="3000" offset="0 0 1"><geom size="0.1"/>'
    b'</replicate></replicate><body name="ball"',
)
URDF = b"""<robot name="arm">
  <link name="base"/>
  <link name="fore"><inertial><mass value="1"/>
    <inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
  <joint name="elbow" type="revolute"><parent link="base"/><child link="fore"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="1" effort="5" velocity="1"/></joint>
</robot>"""


def looked(body: bytes, folder: Path, limits: Limits | None = None) -> ModelAnswer:
    """The last word; and nothing runs on."""
    *_, answer = look(body, folder, folder, limits or Limits())
    assert not [child for child in psutil.Process().children() if str(folder) in child.cmdline()]
    return answer


def test_what_is_found_says_what_is_there_and_which_engines_can_run_it(tmp_path: Path) -> None:
    # MJX has no contacts of cylinders with boxes.
    body = XML.replace(b'<body name="ball"', b'<geom type="box" size="1 1 1" pos="0 0 -1"/><body name="ball"')
    body = body.replace(b'name="sphere" size="0.1"', b'name="sphere" type="cylinder" size="0.1 0.1"')
    first, last = look(body, tmp_path, tmp_path, Limits())
    assert first.description is not None
    assert (set(first.description.engines), first.description.complete) == ({"native", "compiled"}, False)
    found = last.description
    assert found is not None
    assert found.complete
    assert found.auto == {"cpu": "compiled", "gpu": "compiled"}
    assert "its qpos is off by" in found.trials["native"]
    assert found.trials["warp"] == "not tried here: it needs a GPU"
    assert found.inventory.bodies == ["world", "ball", "arm"]
    assert found.physics_steps_per_second > 1000
    assert found.settled_height == pytest.approx(0.5)  # There is no gravity.
    assert found.notes == []
    assert [found.engines[engine] for engine in ("native", "warp", "compiled")] == [None] * 3
    assert "not implemented" in (found.engines["mjx"] or "")


@pytest.mark.extra
def test_an_engine_that_moves_a_model_otherwise_than_mujoco_does_not_run_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Issue 41: an engine was believed because it loads a model."""
    differences = {
        "native": EngineDifference("qpos", 2e-7, 4e-7, 0),
        "compiled": EngineDifference("qvel", 0.03, 0.2, 0),
    }
    monkeypatch.setattr(
        trial,
        "compare",
        lambda engine, _: differences.get(engine.name, EngineDifference("qvel", 0.0, 0.0, 7)),
    )
    for load in ("_load_mjx", "_load_warp"):
        monkeypatch.setattr(trials, load, lambda _: None)
    (tmp_path / "model").write_bytes(XML)
    *_, found = findings(tmp_path / "model")
    assert found.engines["native"] is None
    assert "its qpos is off by 2e-07 of the motion" in found.trials["native"]
    assert "its qvel is off by 0.03 of the motion in half of the tries" in (found.engines["compiled"] or "")
    assert "7 of 50 states are not finite" in (found.engines["mjx"] or "")
    assert (found.auto, found.complete) == ({"cpu": "native", "gpu": "warp"}, True)
    assert set(found.code_seconds) == {"native"}


@pytest.mark.extra
@pytest.mark.parametrize(
    ("limit", "said"),
    [
        ("_TRIALS_S", "not tried here: the trials took more than 60 s"),
        ("_GIVES_WAY_AFTER_S", "not tried here: a job waited for the worker"),
    ],
)
def test_trials_end_in_time_and_give_way_to_jobs(
    limit: str, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(confined, limit, 0.0)
    first, last = look(XML, tmp_path, tmp_path, Limits(), is_wanted=lambda: True)
    assert first.description is not None
    assert not first.description.complete
    found = last.description
    assert found is not None
    assert (found.complete, found.trials["mjx"], found.trials["warp"]) == (True, said, said)
    assert found.engines["native"] is None


@pytest.mark.extra
def test_what_an_engine_can_hold_but_not_step_is_found_too(tmp_path: Path) -> None:
    # A rangefinder that sees one geom alone: MJX takes the model, and its step cannot be traced.
    one_geom = XML.replace(b'<geom name="floor" type="plane" size="5 5 1"/>', b"")
    (tmp_path / "model").write_bytes(one_geom.replace(b"<sensor>", b'<sensor><rangefinder site="middle"/>'))
    *_, found = findings(tmp_path / "model")
    assert found.complete
    assert found.engines["mjx"] is not None
    assert found.engines["warp"] is None


def test_a_body_without_a_floor_is_described_with_a_word_about_that(tmp_path: Path) -> None:
    falling = XML.replace(b'gravity="0 0 0"', b"")
    # Half a second of the trial's wall time is enough for its 2 s: g t² / 2 = 19.6 m.
    for body, said in (
        (falling.replace(b'name="floor"', b'contype="0" conaffinity="0"'), "It fell 20 m"),
        (falling, ""),
    ):
        (tmp_path / "model").write_bytes(body)
        notes = next(findings(tmp_path / "model")).notes
        assert (len(notes), " ".join(notes)[: len(said)]) == (bool(said), said)
        remedy = '`edits` {"floor": true} puts one below it, as its recipe does.'
        assert " ".join(notes).endswith(remedy) == bool(said)


def first_findings(body: bytes, folder: Path) -> Description:
    """The refusal comes before any engine is loaded."""
    (folder / "model").write_bytes(body)
    return next(findings(folder / "model"))


CAR = b"""<mujoco><option timestep="0.004"/><worldbody><geom type="plane" size="5 5 .1"/>
  <body pos="0 0 .11"><freejoint/><geom type="box" size=".2 .1 .03" mass="1"/>
    <body pos=".15 .14 0"><joint name="left" axis="0 1 0"/>
      <geom type="cylinder" size=".1 .02" euler="90 0 0" mass=".2"/></body>
    <body pos=".15 -.14 0"><joint name="right" axis="0 1 0"/>
      <geom type="cylinder" size=".1 .02" euler="90 0 0" mass=".2"/></body>
  </body></worldbody>
  <actuator><velocity joint="left" kv="5"/><velocity joint="right" kv="5"/></actuator></mujoco>"""


def test_of_a_model_that_bursts_is_said_what_helps(tmp_path: Path) -> None:
    """Issue 41, a06_wheel_velocity: a smaller time step does not help a servo on a wheel."""
    assert first_findings(CAR, tmp_path).notes == [
        'It becomes unstable within 2 s, without any action: `integrator="implicitfast"` helps.'
    ]
    helped = CAR.replace(b'timestep="0.004"', b'timestep="0.004" integrator="implicitfast"')
    assert first_findings(helped, tmp_path).notes == []


def test_of_a_body_that_is_thrown_away_is_said_how_far_and_what_helps(tmp_path: Path) -> None:
    """Issue 41, a11_frictionless: a box "settled" at 39 m, without a word."""
    sled = b"""<mujoco><option timestep="0.01" gravity="1 0 -1"/><worldbody>
      <geom name="ice" type="plane" size="50 50 .1" friction="0 0 0"/>
      <body pos="0 0 .1"><freejoint/><geom name="sled" type="box" size=".1 .1 .1" friction="0 0 0" mass="1"/>
        <body pos="0 0 .15"><joint name="j" axis="0 0 1" damping=".1"/><geom size=".03" mass=".01"/></body>
      </body></worldbody><actuator><motor joint="j"/></actuator></mujoco>"""
    said = first_findings(sled, tmp_path)
    words = r'It is \d+ m away within 2 s, without any action: `cone="elliptic"` helps\.'
    assert [bool(re.fullmatch(words, note)) for note in said.notes] == [True]
    assert "'ice' and 'sled' can touch with hardly any friction" in (said.engines["warp"] or "")
    assert said.engines["native"] is None


def test_sleep_is_switched_off_with_a_note(tmp_path: Path) -> None:
    """Issue 41, o_sleep: a training ended with a traceback."""
    sleepy = XML.replace(b"<mujoco>", b'<mujoco><option><flag sleep="enable"/></option>')
    said = first_findings(sleepy, tmp_path)
    assert said.notes == [SLEEP_IS_OFF]
    assert (said.engines["native"], said.engines["compiled"]) == (None, None)
    with read(tmp_path / "model") as (spec, _):
        assert not compiled(spec).opt.enableflags & mujoco.mjtEnableBit.mjENBL_SLEEP


def test_what_engines_would_leave_out_is_said_at_once(tmp_path: Path) -> None:
    """Issue 41, o_act_delay: all engines were said to run it."""
    late = XML.replace(b'<motor name="elbow"', b'<motor name="elbow" delay="0.02" nsample="4"')
    engines = first_findings(late, tmp_path).engines
    assert (engines.pop("native"), engines.pop("compiled")) == (None, None)
    assert set(engines) == {"mjx", "warp"}
    assert all("'elbow' acts with a delay" in (why or "") for why in engines.values())


@pytest.mark.parametrize(
    ("body", "sentence"),
    [
        (XML.replace(b'joint="elbow"', b'joint="knee"'), "MuJoCo cannot compile the model: Error: unknown"),
        *extra(
            (XML.replace(b"<mujoco>", b'<mujoco><size memory="900G"/>'), "memory"),
            (XML.replace(b'mass="0.1"', b'mass="1e309"'), "number is too large"),
            (b'<!DOCTYPE m [<!ENTITY a "b">]><mujoco/>', "document type"),
            (b'<mujoco><include file="/etc/hostname"/></mujoco>', "send both in a zip"),
            (zipped({"model.xml": XML, "m.stl": b"\0" * 2**22}), "times its size"),
        ),
    ],
)
def test_a_model_that_no_job_could_use_is_refused(body: bytes, sentence: str, tmp_path: Path) -> None:
    answer = looked(body, tmp_path)
    assert answer.description is None
    assert answer.refusal is not None
    assert sentence in answer.refusal
    assert str(tmp_path) not in answer.refusal


@pytest.mark.extra
@pytest.mark.parametrize("data", ["1", "0 0 0 0 0 0 0 0 0"])
def test_an_init_qpos_of_another_length_is_refused_with_both(data: str, tmp_path: Path) -> None:
    custom = f'<custom><numeric name="init_qpos" data="{data}"/></custom></mujoco>'.encode()
    answer = looked(XML.replace(b"</mujoco>", custom), tmp_path)
    length = len(data.split())
    assert answer.refusal == (
        f"The model's custom numeric init_qpos has length {length}, but the model has 8 positions (nq)."
    )


def test_a_model_whose_root_cannot_go_forward_is_described_with_a_word_about_that(tmp_path: Path) -> None:
    body = XML.replace(b'<freejoint name="root"/>', b'<joint name="root" type="slide" axis="0 0 1"/>')
    body = body.replace(b'<key name="raised" qpos="0 0 0.8 1 0 0 0 0.5"/>', b"")
    (tmp_path / "model").write_bytes(body)
    notes = next(iter(findings(tmp_path / "model"))).notes
    assert any("The root, 'ball', cannot move along x" in note for note in notes)
    # A free body can.
    (tmp_path / "model").write_bytes(XML)
    assert next(iter(findings(tmp_path / "model"))).notes == []


@pytest.mark.parametrize("timestep", [b"0", b"-0.002", b"1e-9", b"10"])
def test_a_time_step_that_no_job_could_take_is_refused(timestep: bytes, tmp_path: Path) -> None:
    (tmp_path / "model").write_bytes(XML.replace(b'"0.01"', b'"%s"' % timestep, 1))
    with pytest.raises(BadModel, match=r"timestep is .* s, and may be 1e-05 s to 0.1 s"):
        next(findings(tmp_path / "model"))


def test_a_model_that_takes_too_long_is_refused_and_its_process_is_gone(tmp_path: Path) -> None:
    answer = looked(SLOW, tmp_path, Limits(wall_s=0.2))
    assert answer.refusal == "MuJoCo was not done with the model within 0.2 s; make it smaller."


@pytest.mark.extra
def test_a_model_that_needs_too_much_memory_is_refused(tmp_path: Path) -> None:
    texture = b'<asset><texture name="t" type="2d" builtin="flat" width="30000" height="30000"/></asset>'
    limits = dataclasses.replace(Limits(), memory_bytes=2 * 2**30)
    answer = looked(XML.replace(b"<mujoco>", b"<mujoco>" + texture), tmp_path, limits)
    assert answer.refusal is not None
    assert "memory" in answer.refusal


@pytest.mark.parametrize("body", [URDF, zipped({"arm.urdf": URDF}), zipped({"arm.xml": URDF})])
def test_a_urdf_gets_a_motor_for_each_joint_whatever_it_is_called(body: bytes, tmp_path: Path) -> None:
    (tmp_path / "model").write_bytes(body)
    with read(tmp_path / "model") as (spec, _):
        has = inventory(compiled(spec))
    assert [(one.name, one.control_range) for one in has.actuators] == [("elbow", (-1.0, 1.0))]


# Runs the same program, after something was taken away from the kernel.
_WITHOUT = """
from worker.confinement import landlock, seccomp
from worker.validation import __main__ as it
{change}
it.main()
"""
_NO_LANDLOCK = "landlock.version = lambda: 0"
_NO_SECCOMP = "seccomp._PROCESSORS.clear()"


@pytest.mark.parametrize(("change", "layer"), [(_NO_LANDLOCK, "files"), (_NO_SECCOMP, "calls")])
def test_a_model_is_refused_unread_where_its_process_cannot_be_confined(
    change: str, layer: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(confined, "_PROGRAM", ("-c", _WITHOUT.format(change=change)))
    answer = looked(XML, tmp_path)
    assert answer.description is None
    assert answer.refusal is not None
    assert answer.refusal.startswith(
        f"This worker's system cannot confine the process that reads models, so it reads none ({layer}: "
    )
    assert "GAITWAY_MODELS" in answer.refusal


@pytest.mark.extra
def test_whoever_accepts_that_has_models_read_in_the_layers_that_hold(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    change = f"{_NO_LANDLOCK}; {_NO_SECCOMP}"
    monkeypatch.setattr(confined, "_PROGRAM", ("-c", _WITHOUT.format(change=change)))
    answer = next(look(XML, tmp_path, tmp_path, Limits(), strictly=False))
    assert answer.description is not None
    assert answer.layers == ("limits", "privileges")


@pytest.mark.parametrize("kind", ["link", "pipe", "nonsense", "nothing"])
def test_a_reader_that_was_taken_over_cannot_make_its_worker_read_or_wait(kind: str, tmp_path: Path) -> None:
    secret, said = tmp_path / "secret", tmp_path / "answer.json"
    secret.write_text(ModelAnswer(refusal="secret").model_dump_json())
    if kind == "link":
        said.symlink_to(secret)
    elif kind == "pipe":
        os.mkfifo(said)
    elif kind == "nonsense":
        said.write_bytes(b'{"refusal": 7')
    assert read_answer(said, ModelAnswer) == ModelAnswer()


def test_a_confined_process_dies_with_its_worker(tmp_path: Path) -> None:
    (tmp_path / "slow.xml").write_bytes(SLOW)
    program = (
        "import sys; from pathlib import Path; from worker.validation.confined import look, Limits;"
        "here = Path(sys.argv[1]);"
        "list(look((here / 'slow.xml').read_bytes(), here, here, Limits(), strictly=False))"
    )
    with subprocess.Popen([sys.executable, "-c", program, str(tmp_path)]) as worker:
        while not (confined := psutil.Process(worker.pid).children()):
            time.sleep(0.02)
        worker.kill()
    until = time.monotonic() + 10
    while confined[0].is_running() and confined[0].status() != psutil.STATUS_ZOMBIE:
        assert time.monotonic() < until
        time.sleep(0.02)


def test_a_model_without_actuators_is_told_of_servos(tmp_path: Path) -> None:
    file = tmp_path / "model"
    file.write_bytes(NO_MOTOR)
    found = next(findings(file))
    assert "It has no actuators: jobs give it servos (`edits.servos`)." in found.notes
    assert found.inventory.sizes.nu == 0


def test_what_compiled_leaves_out_is_told(tmp_path: Path) -> None:
    shell = b'<asset><mesh name="shell" vertex="0 0 0 .1 0 0 0 .1 0 0 0 .1"/></asset><worldbody>'
    meshes = TOUCHING.replace(b"<worldbody>", shell).replace(b'friction="0"', b"")
    meshes = meshes.replace(b'type="cylinder"', b'type="mesh" mesh="shell" name="one"')
    meshes = meshes.replace(b'type="box"', b'type="mesh" mesh="shell" name="other"')
    (said,) = (one for one in first_findings(meshes, tmp_path).notes if "compiled" in one)
    assert said == (
        "On the engine `compiled`, its geoms 'one' and 'other' pass through each other, as both are meshes."
    )


def test_a_refusal_of_compiled_names_the_edits_that_help_and_there_is_a_recipe(tmp_path: Path) -> None:
    file = tmp_path / "model"
    file.write_bytes(TOUCHING)
    found = next(findings(file))
    why = found.engines["compiled"]
    assert why is not None
    assert "hardly any friction" in why
    assert why.endswith('Or let less of it collide: `edits` {"floor": true, "collide": "floor"}.')
    assert found.recipe is not None
    assert found.recipe["edits"]["feet"] == ["left", "right"]
    assert found.recipe_engines == {"native": None, "compiled": None}


def test_the_library_keeps_what_was_found_and_of_a_refused_one_no_file(
    tmp_path: Path, job_store: PostgresJobStore
) -> None:
    objects, queue = MemoryObjectStore(), MemoryJobQueue()
    stores: Any = {"store": job_store.models, "objects": objects, "queue": queue}
    record = models.add(ROLLS, **stores, now=utc_now())
    assert queue.take_upload() == ("model", record.id)
    validate(record.id, job_store.models, objects, tmp_path, tmp_path)
    found = library.find(record.id, job_store.models)
    assert (found.status, found.message) == (
        "refused",
        "The model has no actuators, and no hinge or slide that a servo could move.",
    )
    assert found.refused_at is not None
    assert found.refused_at >= record.created_at
    assert list(objects.list("")) == []
    # Sent again, it is looked at again.
    again = models.add(ROLLS, **stores, now=utc_now())
    assert (again.status, queue.contains_upload("model", record.id)) == ("validating", True)


def test_a_refusal_that_was_interrupted_is_told_as_such_and_the_model_can_be_sent_again(
    tmp_path: Path, job_store: PostgresJobStore
) -> None:
    objects, queue = MemoryObjectStore(), MemoryJobQueue()
    stores: Any = {"store": job_store.models, "objects": objects, "queue": queue}
    record = models.add(ROLLS, **stores, now=utc_now())
    objects.delete_prefix(keys.model_source(record.id))  # as a worker that was killed before it kept why
    validate(record.id, job_store.models, objects, tmp_path, tmp_path)
    found = library.find(record.id, job_store.models)
    assert (found.status, found.message) == (
        "refused",
        "A worker was stopped while it refused the model; send it again to learn why.",
    )
    models.add(ROLLS, **stores, now=utc_now())
    assert objects.get(keys.model_source(record.id)) == ROLLS


def test_a_model_that_was_deleted_meanwhile_does_not_come_back(
    tmp_path: Path, job_store: PostgresJobStore
) -> None:
    with pytest.raises(ModelNotFound):
        validate(f"sha256:{'0' * 64}", job_store.models, MemoryObjectStore(), tmp_path, tmp_path)
