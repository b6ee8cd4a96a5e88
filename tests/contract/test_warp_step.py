"""A substep in another order, and kernels compiled before they run: neither changes what comes out."""

from typing import Any

import mujoco
import numpy as np
import pytest

from tests.contract.test_warp import BALL

pytestmark = [pytest.mark.extra, pytest.mark.usefixtures("warp_kernels")]


@pytest.fixture
def mjw() -> Any:
    """MuJoCo Warp. Loading it takes seconds, also where these tests are only collected."""
    from mujoco.mjx.third_party import mujoco_warp

    return mujoco_warp


@pytest.fixture
def warp_step() -> Any:
    """The module under test. It loads MuJoCo Warp."""
    from core.physics import warp_step

    return warp_step


def balls(mjw: Any) -> tuple[Any, Any]:
    """A model, and three worlds of it that are pushed with different forces."""
    model = mujoco.MjModel.from_xml_string(BALL)
    device_model = mjw.put_model(model)
    device_model.opt.warn_overflow = 0
    data = mjw.make_data(model, 3, naconmax=24, njmax=24)
    data.qfrc_applied.assign([[-1.0] * 6, [0.0] * 6, [1.0] * 6])
    return device_model, data


def test_the_order_of_a_substep_changes_no_bit(mjw: Any, warp_step: Any) -> None:
    model, data = balls(mjw)
    _, reference = balls(mjw)
    substep = warp_step.Substep(model, data.qpos.device, reads_sensors=False)
    for _ in range(250):  # 0.5 s: the balls have fallen 0.9 m to the floor
        substep(data)
        mjw.step(model, reference)
    assert reference.nacon.numpy()[0] == 3
    for name in ("qpos", "qvel", "qacc_warmstart", "qfrc_actuator", "cinert"):
        np.testing.assert_array_equal(getattr(data, name).numpy(), getattr(reference, name).numpy())


def test_in_sequence_a_substep_leaves_the_devices_stream_alone(
    mjw: Any, warp_step: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Kernels are loaded beside JAX's calls, and a device has one stream for all threads."""
    model, data = balls(mjw)
    _, reference = balls(mjw)
    substep = warp_step.Substep(model, data.qpos.device, reads_sensors=False)
    # As on a GPU, where changing to a stream is seen: a CPU has none, and this is none for a GPU.
    monkeypatch.setattr(substep, "_streams", [None, None])
    with pytest.raises((RuntimeError, AttributeError), match=r"not a CUDA device|cached_event"):
        substep(reference)
    substep(data, in_sequence=True)
    _, reference = balls(mjw)
    mjw.step(model, reference)
    np.testing.assert_array_equal(data.qvel.numpy(), reference.qvel.numpy())


def test_a_model_whose_sensors_are_read_takes_the_librarys_step(
    mjw: Any, warp_step: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    model, data = balls(mjw)
    stepped: list[Any] = []
    monkeypatch.setattr(mjw, "step", lambda model, data: stepped.append(data))
    warp_step.Substep(model, data.qpos.device, reads_sensors=True)(data)
    assert stepped == [data]


def test_loading_the_kernels_of_a_program_runs_none_of_them(warp_step: Any) -> None:
    import warp as wp

    @wp.kernel
    def count(number: wp.array[wp.float32]) -> None:
        number[wp.tid()] += 1.0

    number, device, launch = wp.zeros(1, dtype=wp.float32), wp.get_device("cpu"), wp.launch

    def program() -> None:
        wp.launch(count, dim=1, inputs=[number])

    warp_step.load_kernels([program], device)
    assert number.numpy()[0] == 0
    assert wp.launch is launch
    assert count.module.execs  # it is loaded,
    program()
    assert number.numpy()[0] == 1  # and runs when it is asked to
