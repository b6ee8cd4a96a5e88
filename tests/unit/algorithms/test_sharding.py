from typing import Any

import jax
import jax.numpy as jnp
import pytest

from core.algorithms.ppo.spec import PPOSpec
from core.algorithms.sharding import ONE_DEVICE, Sharding
from core.errors import Rejected


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"num_envs": 255}, "num_envs = 255 is not a multiple of the 2 devices that share the run"),
        ({"batch_size": 77}, "batch_size = 77 is not a multiple of the 2 devices that share the run"),
    ],
)
def test_what_two_devices_cannot_share_evenly_is_refused(
    change: dict[str, Any], sentence: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(jax, "local_devices", lambda process_index=0: jax.devices() * 2)
    with pytest.raises(Rejected, match=sentence):
        Sharding.over(2, PPOSpec.model_validate(change))


def test_more_devices_than_there_are_is_refused() -> None:
    with pytest.raises(Rejected, match="1000 devices were asked for, but JAX finds"):
        Sharding.over(1000, PPOSpec())


def test_one_device_is_left_alone() -> None:
    assert Sharding.over(1, PPOSpec.model_validate({"num_envs": 255})) == ONE_DEVICE
    numbers = jnp.arange(3)
    assert ONE_DEVICE.everywhere(numbers) is ONE_DEVICE.split(numbers) is numbers
    assert ONE_DEVICE.of_axes() is None
