"""A host function in a compiled program: what it is given, what comes back, and what happens if it fails."""

import itertools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mujoco_compiled.code import host_call as module
from mujoco_compiled.code.host_call import host_call

_numbers = itertools.count()


def weigh(vector: Any, factor: Any) -> tuple[Any, Any]:
    """[..., 3], [...] -> [..., 3], [...]; a sum over environments would show if they came one by one."""
    return vector * factor[..., None], vector.sum(axis=-1)


def weighed(vector: jax.Array, factor: jax.Array) -> tuple[jax.Array, ...]:
    return host_call(weigh, "weigh", [(3,), ()], vector, factor)


def failing(function: Callable[..., Any]) -> Callable[[jax.Array], tuple[jax.Array, ...]]:
    """The function as a program, by a name that no other test has."""
    name = f"failing {next(_numbers)}"
    return jax.jit(lambda x: host_call(function, name, [()], x))


@pytest.fixture(params=["by name", "by callback"])
def way(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """On a GPU the host is called by JAX's own callback, which does on a CPU, too."""
    if request.param == "by callback":
        monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    return request.param


def test_results_have_their_shapes_and_values(way: str) -> None:
    scaled, total = jax.jit(weighed)(jnp.array([1.0, 2.0, 3.0]), jnp.float32(2.0))
    np.testing.assert_array_equal(scaled, [2.0, 4.0, 6.0])
    assert (float(total), total.dtype) == (6.0, jnp.float32)


def test_mapped_axes_come_together_and_in_front(way: str) -> None:
    seen: list[tuple[int, ...]] = []

    def first(x: Any, y: Any) -> tuple[Any]:
        seen.append(x.shape)
        return (x[..., 0] + y,)

    name = f"first {way} {next(_numbers)}"
    call = jax.vmap(lambda x, y: host_call(first, name, [()], x, y)[0], in_axes=(1, None))
    x = jnp.arange(24.0).reshape(2, 3, 4)
    result = jax.jit(jax.vmap(call, in_axes=(0, None)))(x, jnp.float32(0.5))  # environments: axes 0 and 2
    np.testing.assert_array_equal(result, x[:, 0, :] + 0.5)
    assert set(seen) == {(2, 4, 3)}


def test_loops_may_call_it(way: str) -> None:
    def double(x: jax.Array) -> jax.Array:
        return host_call(lambda x: (2 * x,), "double", [()], x)[0]

    scanned = jax.jit(lambda x: jax.lax.scan(lambda x, _: (double(x), x), x, length=5))(jnp.float32(1.0))
    assert float(scanned[0]) == 32.0
    np.testing.assert_array_equal(scanned[1], [1.0, 2.0, 4.0, 8.0, 16.0])
    assert float(jax.lax.while_loop(lambda x: x < 1000, double, jnp.float32(1.0))) == 1024.0


def test_a_failure_ends_the_program_with_its_sentence_and_nothing_else(way: str) -> None:
    def refuse(x: Any) -> Any:
        if x > 1:
            raise ValueError("no more than one, please")
        return (x,)

    program = failing(refuse)
    with pytest.raises(jax.errors.JaxRuntimeError, match="ValueError: no more than one, please"):
        jax.block_until_ready(program(jnp.float32(2.0)))
    assert float(program(jnp.float32(1.0))[0]) == 1.0


@pytest.mark.parametrize(
    ("value", "says"),
    [
        (lambda x: (np.zeros(2, np.float32),), r"shape \(2,\), but should have \(\)"),
        (lambda x: (x, x), "longer"),
        (lambda x: np.float32(1), "TypeError"),
    ],
    ids=["a wrong shape", "too many", "no tuple"],
)
def test_a_result_that_does_not_fit_is_an_error(value: Callable[..., Any], says: str) -> None:
    with pytest.raises(jax.errors.JaxRuntimeError, match=says):
        jax.block_until_ready(failing(value)(jnp.float32(2.0)))


def test_a_lack_of_memory_is_told_as_such() -> None:
    def hungry(x: Any) -> Any:
        raise MemoryError

    with pytest.raises(jax.errors.JaxRuntimeError, match="RESOURCE_EXHAUSTED"):
        jax.block_until_ready(failing(hungry)(jnp.float32(2.0)))


def test_a_program_whose_function_this_process_has_not_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    program = jax.jit(lambda x: host_call(lambda x: (x,), "gone", [()], x)).lower(jnp.float32(0)).compile()
    monkeypatch.delitem(module._functions, "gone")
    with pytest.raises(jax.errors.JaxRuntimeError, match="no host function named gone"):
        jax.block_until_ready(program(jnp.float32(2.0)))


def test_where_xla_refuses_the_handler_the_callback_takes_over(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise jax.errors.JaxRuntimeError("another version")

    module._is_registered.cache_clear()
    monkeypatch.setattr(jax.ffi, "register_ffi_target", refuse)
    try:
        with pytest.warns(UserWarning, match="not cached between processes: another version"):
            lowered = jax.jit(lambda x, y: weighed(x, y)).lower(jnp.zeros(3), jnp.float32(2.0))
        assert module._TARGET not in lowered.as_text()
        assert float(lowered.compile()(jnp.ones(3), jnp.float32(2.0))[1]) == 3.0
    finally:
        module._is_registered.cache_clear()


def test_the_program_holds_the_name_and_no_address() -> None:
    def text(name: str) -> str:
        program = jax.jit(lambda x: host_call(lambda x: (x,), name, [()], x))
        return program.lower(jnp.float32(0)).as_text()

    assert text("same") == text("same") != text("other")
    assert module._TARGET in text("same")
