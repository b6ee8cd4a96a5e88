"""A policy that was trained with an intention network, and another task that its decoder's body learns."""

from pathlib import Path
from typing import Any

from core.algorithms.run import make_run
from core.environments import catalog
from core.environments.environment import Environment
from core.physics.choose import engine_builder
from tests.exports import numpy_file_of
from tests.learning.runs import STEPS_PER_UPDATE, last_evaluation, small_settings

# A cart of 1 kg on a rail, moved by a motor of 5 N. It stops at the ends, and slides a little by itself.
XML = b"""<mujoco><option timestep="0.02"/><worldbody><body name="cart"><joint name="rail" type="slide"
  axis="1 0 0" damping="1"/><geom size="0.1" mass="1"/></body></worldbody>
  <actuator><motor joint="rail" gear="5" ctrllimited="true" ctrlrange="-1 1"/></actuator></mujoco>"""
MODEL = "sha256:" + "0" * 64
VELOCITY = {"kind": "qvel"}


def cart(folder: Path, decoder: Path | None = None, **task: Any) -> Environment:
    (folder / "model").write_bytes(XML)
    info = catalog.find("mjcf")
    given = {"model": MODEL, "n_frames": 2, "termination": [], **task}
    options = catalog.parse_options(info, given)
    return catalog.make(info, options, engine_builder("native"), folder / "model", decoder=decoder)


def test_the_body_learns_another_task_by_a_decoder_that_stays_as_it_is(tmp_path: Path) -> None:
    # The first policy drives forward. Its encoder sees where the cart is, its decoder how fast that moves.
    network = {"kind": "intention", "latent": 4, "encoder": [16], "decoder": [16], "places": [[0, 1]]}
    first = make_run(
        cart(tmp_path, observation=[{"kind": "qpos"}, VELOCITY]),
        small_settings(network=network, num_timesteps=4 * STEPS_PER_UPDATE, episode_length=40),
        seed=0,
        checkpoint_every_steps=None,
    )
    last_evaluation(first.events())
    file = tmp_path / "decoder"
    file.write_bytes(numpy_file_of(first.policy()))

    # The second drives backward, and acts by intentions.
    task: Any = catalog.parse_options(catalog.find("mjcf"), {"model": MODEL, "observation": [VELOCITY]})
    sees = [term.model_dump(mode="json") for term in task.observation]
    action = {"kind": "decoder", "job": "019aa3c2f0b1-5be0c1d2e3", "latent": 4, "sees": sees}
    backward = cart(
        tmp_path,
        file,
        observation=[VELOCITY],
        reward=[{"kind": "forward_velocity", "weight": -1.0}],
        action={**action, "reach": 4.0, "moves": {"kind": "control"}},
    )
    assert backward.action_size == 4
    settings = {"episode_length": 40, "discounting": 0.95, "num_evals": 40}
    second = make_run(backward, small_settings(**settings), seed=0, checkpoint_every_steps=None)
    returns = [
        event.metrics["eval/episode_reward"]
        for event in second.events()
        if getattr(event, "metrics", None) and "eval/episode_reward" in event.metrics
    ]
    # A motor that pushes with all of its 5 N against 1 N s/m has driven about 1.4 m in 40 steps of 0.04 s.
    assert returns[-1] > returns[0] + 10
