"""Jobs whose environments differ in their models, and the models that they get."""

from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from pydantic import TypeAdapter, ValidationError

from core.environments.info import CRITIC_GROUP
from core.environments.randomization import FIELDS, Randomization, Randomizations
from core.environments.wrappers.domain_randomization import NUM_MODELS, draw_models, randomize
from core.errors import JobFailed
from core.physics.engine import CONSTANTS, MODEL_FIELDS
from core.physics.model import brax_model
from tests.unit.environments.mjcf.probe import KEY, build

MODEL = mujoco.MjModel.from_xml_string(
    """
<mujoco>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 1" friction="0.5 0.01 0.001"/>
    <body name="ball" pos="0 0 1">
      <freejoint name="root"/>
      <geom name="ball" type="sphere" size="0.1" mass="2" friction="1 0.01 0.001"/>
      <body name="arm">
        <joint name="hinge" damping="1" frictionloss="0.1"/>
        <geom name="arm" type="sphere" size="0.1" mass="1" pos="0.2 0 0"/>
      </body>
    </body>
  </worldbody>
  <actuator><position name="servo" joint="hinge" kp="10"/></actuator>
</mujoco>
"""
)


def rule(field: str, low: float, high: float, **more: Any) -> Randomization:
    return Randomization.model_validate({"field": field, "range": [low, high], **more})


def draw(*rules: Randomization) -> dict[str, np.ndarray]:
    return draw_models(MODEL, rules)


def test_a_named_geoms_sliding_friction_differs_and_nothing_else() -> None:
    friction = draw(rule("geom_friction", 0.6, 1.4, names=["floor"], axis=0))["geom_friction"]
    assert friction.shape == (NUM_MODELS, 3, 3)
    sliding = friction[:, 0, 0]
    # The model's 0.5 times 0.6 to 1.4, spread evenly: every tenth of the range has its tenth of the
    # environments.
    counts, _ = np.histogram(sliding, bins=10, range=(0.3, 0.7))
    assert sliding.min() >= 0.3
    assert sliding.max() <= 0.7
    assert np.ptp(counts) <= 2
    friction[:, 0, 0] = MODEL.geom_friction[0, 0]
    np.testing.assert_array_equal(friction, np.float32(np.tile(MODEL.geom_friction, (NUM_MODELS, 1, 1))))


def test_one_number_is_for_all_unless_each_has_its_own() -> None:
    alike = draw(rule("geom_friction", 0.5, 2.0))["geom_friction"] / MODEL.geom_friction
    np.testing.assert_allclose(alike, np.tile(alike[:, :1, :1], (1, 3, 3)), rtol=1e-5)
    each = draw(rule("geom_friction", 0.5, 2.0, each=True))["geom_friction"] / MODEL.geom_friction
    np.testing.assert_allclose(each, np.tile(each[:, :, :1], (1, 1, 3)), rtol=1e-5)
    assert abs(np.corrcoef(each[:, 0, 0], each[:, 1, 0])[0, 1]) < 0.15


def test_numbers_are_added_or_set() -> None:
    gravity = draw(rule("opt.gravity", -0.5, 0.5, axis=2, operation="add"))["opt.gravity"]
    assert gravity.shape == (NUM_MODELS, 3)
    assert not gravity[:, :2].any()
    assert -10.31 <= gravity[:, 2].min() < -10.2
    damping = draw(rule("dof_damping", 3, 4, names=["hinge"], operation="set"))["dof_damping"]
    assert not damping[:, :6].any()  # the free joint's
    assert ((damping[:, 6] >= 3) & (damping[:, 6] <= 4)).all()


def test_a_free_joints_six_degrees_of_freedom_share_its_number() -> None:
    armature = draw(rule("dof_armature", 0.1, 0.2, operation="set", each=True))["dof_armature"]
    np.testing.assert_array_equal(armature[:, :6], np.tile(armature[:, :1], (1, 6)))
    assert not np.allclose(armature[:, 0], armature[:, 6])


def test_log_uniform_numbers_are_as_often_halves_as_doubles() -> None:
    damping = draw(rule("dof_damping", 0.25, 4.0, names=["hinge"], distribution="log_uniform"))["dof_damping"]
    assert np.median(damping[:, 6]) == pytest.approx(1.0, rel=0.01)
    assert damping[:, 6].min() == pytest.approx(0.25, rel=0.01)


def test_rules_with_the_same_draw_move_together() -> None:
    # A position servo's gain and its bias are the same stiffness, with opposite signs.
    fields = draw(
        rule("actuator_gainprm", 0.5, 2, axis=0, draw="kp"),
        rule("actuator_biasprm", 0.5, 2, axis=1, draw="kp"),
    )
    np.testing.assert_allclose(fields["actuator_gainprm"][:, 0, 0], -fields["actuator_biasprm"][:, 0, 1])
    apart = draw(rule("actuator_gainprm", 0.5, 2, axis=0), rule("actuator_biasprm", 0.5, 2, axis=1))
    assert not np.allclose(apart["actuator_gainprm"][:, 0, 0], -apart["actuator_biasprm"][:, 0, 1])


def test_rules_about_one_field_are_applied_one_after_the_other() -> None:
    fields = draw(rule("body_mass", 2, 2), rule("body_mass", 1, 1, names=["arm"], operation="add"))
    np.testing.assert_allclose(fields["body_mass"], np.tile([0, 4, 3], (NUM_MODELS, 1)))


def test_what_mujoco_derives_from_a_mass_is_derived_anew() -> None:
    fields = draw(rule("body_mass", 2, 2), rule("body_inertia", 2, 2))
    assert set(fields) == {"body_mass", "body_inertia", *CONSTANTS} - {"tendon_invweight0"}  # no tendons
    # Everything twice as heavy: what it weighs doubles, and how easily it moves halves.
    for name, factor in (("body_subtreemass", 2.0), ("body_invweight0", 0.5), ("dof_invweight0", 0.5)):
        np.testing.assert_allclose(fields[name][7], factor * getattr(MODEL, name), rtol=1e-5)


PENDULUM = mujoco.MjModel.from_xml_string(
    """
<mujoco>
  <worldbody>
    <body name="rod">
      <joint name="hinge" axis="0 1 0"/>
      <geom type="sphere" size="0.1" mass="1" pos="0.2 0 0"/>
    </body>
    <body name="ball" pos="2 0 0"><freejoint/><geom type="sphere" size="0.1"/></body>
  </worldbody>
</mujoco>
"""
)


def test_a_centre_of_mass_moves_and_takes_the_constants_with_it() -> None:
    fields = draw_models(PENDULUM, [rule("body_ipos", 0.1, 0.1, names=["r.d"], axis=0, operation="add")])
    np.testing.assert_allclose(fields["body_ipos"][7], [[0, 0, 0], [0.3, 0, 0], [0, 0, 0]], rtol=1e-6)
    # About the hinge: 0.4 m r² + m d² = 0.004 + 0.09 kg m².
    assert fields["dof_invweight0"][7, 0] == pytest.approx(1 / 0.094, rel=1e-6)


def test_a_payload_brings_its_inertia() -> None:
    carried = {"names": ["ball"], "operation": "add", "recompute_inertia": True}
    fields = draw(rule("body_mass", 1, 1, **carried))
    np.testing.assert_allclose(fields["body_mass"][7], [0, 3, 1])  # It was 2 kg.
    np.testing.assert_allclose(fields["body_inertia"][7], MODEL.body_inertia * [[1], [1.5], [1]], rtol=1e-6)


def test_nothing_is_derived_where_nothing_calls_for_it() -> None:
    assert set(draw(rule("geom_friction", 0.5, 2))) == {"geom_friction"}


def test_equal_rules_give_equal_models() -> None:
    rules = [rule("geom_friction", 0.5, 2, each=True), rule("dof_damping", 1, 2)]
    for name, values in draw(*rules).items():
        np.testing.assert_array_equal(values, draw(*rules)[name])


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        (rule("geom_friction", 0.5, 2, names=["flor"]), "no geom 'flor'; there are floor, ball, arm"),
        (rule("body_mass", 1, 2, names=["torso"]), "no body 'torso'; there are world, ball, arm"),
        (rule("dof_damping", 1, 2, names=["knee"]), "no joint 'knee'; there are root, hinge"),
        (rule("actuator_gear", 1, 2, names=["motor"]), "no actuator 'motor'; there are servo"),
        (rule("dof_damping", -2, 0, operation="add"), "dof_damping becomes negative"),
        (rule("body_mass", 0, 0), "body_mass becomes 0"),
        (rule("dof_frictionloss", 0.1, 0.2, operation="set"), "no dof_frictionloss in the model"),
    ],
)
def test_what_the_model_has_not_got_or_cannot_be_ends_the_job(wrong: Randomization, says: str) -> None:
    with pytest.raises(JobFailed, match=says) as failure:
        draw(wrong)
    assert failure.value.reason == "bad_model"


def test_a_body_without_room_for_another_centre_is_named() -> None:
    with pytest.raises(JobFailed, match="body 'ball' moves alone"):
        draw_models(PENDULUM, [rule("body_ipos", 0, 0.1, operation="add")])


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ({"range": [2, 1]}, "low <= high"),
        ({"range": [0, 1], "distribution": "log_uniform"}, "above 0"),
        ({"range": [-1, 1]}, "must not be negative"),
        ({"range": [-1, 1], "operation": "set"}, "geom_friction must not be negative"),
        ({"axis": 3}, "geom_friction has 3 numbers"),
        ({"field": "body_mass", "axis": 1}, "body_mass has one number"),
        ({"field": "opt.gravity", "each": True}, "belongs to the whole model"),
        ({"field": "geom_size"}, "geom_friction"),
        ({"names": []}, "at least 1"),
        ({"names": ["(floor"]}, "no regular expression"),
        ({"recompute_inertia": True}, "goes with body_mass"),
        ({"every_s": 0}, "greater than 0"),
        ({"field": "body_mass", "every_s": 5}, "body_mass stays the same in an episode"),
        ({"field": "dof_armature", "every_s": 5}, "derives constants of the whole .*: leave every_s out"),
        ({"rnage": [0, 1]}, "not permitted"),
    ],
)
def test_what_does_not_go_together_is_refused(wrong: dict[str, Any], says: str) -> None:
    with pytest.raises(ValidationError, match=says):
        Randomization.model_validate({"field": "geom_friction", "range": [0.5, 1], **wrong})


@pytest.mark.parametrize(
    ("second", "says"),
    [
        ({"field": "geom_friction"}, "rules 0 and 1 change 'geom_friction', so every_s must be the same"),
        ({"field": "dof_damping", "draw": "a"}, "rules 0 and 1 share the draw 'a'"),
        ({"field": "dof_damping", "draw": "a", "every_s": 4.0}, "rules 0 and 1 share the draw 'a'"),
    ],
)
def test_rules_that_act_together_act_at_the_same_times(second: dict[str, Any], says: str) -> None:
    first = {"field": "geom_friction", "range": [0.5, 1], "draw": "a", "every_s": 5.0}
    with pytest.raises(ValidationError, match=says):
        TypeAdapter(Randomizations).validate_python([first, {"range": [0.5, 1], **second}])


def test_a_running_episode_gets_new_numbers_after_each_interval(tmp_path: Path) -> None:
    friction = {"field": "geom_friction", "names": ["sphere"], "axis": 0}
    seen = [{"kind": "projected_gravity"}]
    inner = build(tmp_path, observation=seen, critic=[*seen, {"kind": "randomized", **friction}])
    rules = [
        rule("geom_friction", 0.5, 1.5, names=["sphere"], axis=0, every_s=0.02),
        rule("opt.gravity", -0.3, 0.3, axis=2, operation="add", every_s=0.03),
        rule("dof_damping", 0.1, 0.2, names=["elbow"], operation="set"),
    ]
    environment = randomize(inner, rules)
    states = jax.jit(jax.vmap(environment.reset))(jax.random.split(KEY, 8))
    step = jax.jit(jax.vmap(environment.step))
    shown = list[dict[str, np.ndarray]]()
    for _ in range(7):
        states = step(states, jnp.zeros((8, 1)))
        own = states.physics.model
        frictions = np.asarray(own["geom_friction"][:, inner.model.geom("sphere").id, 0])
        # The critic sees the values of the step: the sphere's friction is 1 in the model.
        np.testing.assert_allclose(states.obs[CRITIC_GROUP][:, 3], frictions - 1, atol=1e-6)
        gravity, damping = own["opt.gravity"][:, 2], own["dof_damping"][:, 6]
        shown.append({"friction": frictions, "gravity": np.asarray(gravity), "damping": np.asarray(damping)})
    # Steps of 0.01 s: those that make a new value are every second one, every third one, and none.
    for name, new in (("friction", [2, 4, 6]), ("gravity", [3, 6]), ("damping", [])):
        for number in range(1, 7):
            before, now = shown[number - 1][name], shown[number][name]
            assert (before != now).all() if number in new else (before == now).all(), (name, number)
        assert len(np.unique(shown[-1][name])) == 8  # each environment has its own
    every = {name: np.stack([one[name] for one in shown]) for name in shown[0]}
    for name, low, high in (("friction", 0.5, 1.5), ("gravity", -0.3, 0.3), ("damping", 0.1, 0.2)):
        assert low - 1e-5 <= every[name].min() < every[name].max() <= high + 1e-5, name


def test_an_environment_without_intervals_carries_no_clock(tmp_path: Path) -> None:
    inner = build(tmp_path)
    plain = randomize(inner, [rule("geom_friction", 0.5, 1.5)]).reset(KEY)
    assert set(plain.info) == set(inner.reset(KEY).info)


def test_every_field_has_its_shape_and_is_one_that_engines_take() -> None:
    assert set(FIELDS) <= set(MODEL_FIELDS)
    ant = brax_model("ant")
    for name, about in FIELDS.items():
        if about.kind is not None:
            assert int(np.prod(getattr(ant, name).shape[1:])) == about.size, name
