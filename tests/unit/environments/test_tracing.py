"""Functions of JAX as operations on numbers give what JAX gives."""

import json
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from core.environments.expression import NotExpressed
from core.environments.tracing import expressed

FUNCTIONS: dict[str, Callable[..., Any]] = {
    "moved": lambda x, m, i: jnp.concatenate([m[:, 1], x[::-1][:2], m.T.reshape(-1)[2:5], jnp.roll(x, 1)]),
    "picked": lambda x, m, i: m[np.array([2, 0]), np.array([1, 2])] - x[np.array([0, 3])],
    "set": lambda x, m, i: x.at[np.array([3, 1])].set(m[0, :2]).at[0].set(7.0),
    "product": lambda x, m, i: m @ m @ x[:3] + jnp.einsum("ij,kj->ki", m, m)[1],
    "batched": lambda x, m, i: jnp.einsum("bi,bij->bj", m, jnp.stack([m, m.T, m + 1.0])),
    "vectors": lambda x, m, i: jnp.cross(m, x[:3]) / jnp.linalg.norm(m, axis=1, keepdims=True),
    "rounded": lambda x, m, i: jnp.stack([jnp.floor(x), x % 1.0, jnp.clip(x, -0.5, 0.5), x.astype(int) / 3]),
    "whole": lambda x, m, i: jnp.stack([(i + 7) // 3, (i + 7) % 5, -i // 2]),
    "truth": lambda x, m, i: jnp.where((x > 0) & ~(x > 0.8) | jnp.isnan(x), jnp.exp(-x), jnp.any(m > 2)),
    "reduced": lambda x, m, i: jnp.stack([m.sum(), m.max(0)[1], jnp.prod(x), m.mean(1)[0], jnp.all(x < 9)]),
    "curved": lambda x, m, i: jnp.stack([x**3, jnp.arctan(x), jnp.tanh(x), jax.nn.sigmoid(x), x**2]),
    "read at i": lambda x, m, i: jnp.append(m[i], jax.lax.dynamic_slice(x, (i,), (2,))),
    "read at several": lambda x, m, i: m[jnp.stack([i, 2 - i])] + x[jnp.array([i, i + 1, 0])],
    "written at i": lambda x, m, i: m.at[i].set(x[:3]),
    "constants": lambda x, m, i: x * np.array([1.0, np.inf, -2.0, 0.5], np.float32) + np.arange(4),
    "chance": lambda x, m, i: x + jax.random.uniform(jax.random.key(0), (4,)),
    "a branch": lambda x, m, i: jax.lax.cond(i > 1, lambda: x, lambda: -x),
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_an_expression_gives_what_its_function_gives(name: str) -> None:
    function = FUNCTIONS[name]
    expression = expressed(
        lambda given: {"result": function(**given)},
        {
            "x": jax.ShapeDtypeStruct((4,), jnp.float32),
            "m": jax.ShapeDtypeStruct((3, 3), jnp.float32),
            "i": jax.ShapeDtypeStruct((), jnp.int32),
        },
    ).only(["result"])
    random = np.random.default_rng(0)
    for i in range(3):
        given = {"x": random.normal(size=4), "m": random.normal(size=(3, 3)), "i": i}
        wanted = function(**{key: jnp.asarray(value) for key, value in given.items()})
        np.testing.assert_allclose(expression(given)["result"], wanted, rtol=1e-5, atol=1e-5)
    json.dumps(expression.document(), allow_nan=False)


def test_only_what_an_output_needs_is_kept() -> None:
    whole = expressed(
        lambda given: {"sum": given["x"][1] + 1.0, "sorted": jnp.sort(given["y"])},
        {name: jax.ShapeDtypeStruct((3,), jnp.float32) for name in "xy"},
    )
    assert whole.only(["sum"]).document() == {
        "inputs": [["x", [1]]],
        "constants": [1.0],
        "operations": [["add", 1, [0], [1]]],
        "outputs": {"sum": [2]},
    }
    with pytest.raises(NotExpressed, match="it needs the operation sort"):
        whole.only(["sum", "sorted"])
