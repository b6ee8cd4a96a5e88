"""What a gradient step needs at the least."""

import pytest

from bench.measure.limits import Need, card_of, forward_flops, gradient_flops, gradient_step, num_parameters


def test_a_forward_pass_is_two_operations_for_each_weight_and_sample() -> None:
    # 3·4 + 4·2 = 20 weights, 10 samples.
    assert forward_flops([3, 4, 2], 10) == 2 * 20 * 10


def test_a_gradient_is_three_forward_passes_without_that_of_the_inputs() -> None:
    # 3·400, less 2·10·3·4 for the gradient by the inputs.
    assert gradient_flops([3, 4, 2], 10) == 1200 - 240


def test_parameters_are_weights_and_biases() -> None:
    assert num_parameters([3, 4, 2]) == (3 + 1) * 4 + (4 + 1) * 2


def test_a_gradient_step_reads_its_batch_and_moves_adams_state() -> None:
    need = gradient_step([3, 2], [3, 1], unrolls=5, unroll_length=4, sample_floats=7)
    # One layer each, 20 samples: 3·2·20·6 − 2·20·6 = 480 and 3·2·20·3 − 2·20·3 = 240; the value once more
    # on 5 ends: 2·5·3 = 30.
    assert need.flops == 480 + 240 + 30
    # 20 samples of 7 numbers; 8 + 4 parameters six times; 4 bytes each.
    assert need.bytes == 4 * (140 + 6 * 12)


def test_the_least_time_is_the_longer_of_both() -> None:
    assert Need(flops=100, bytes=10).least_s(flops=10, memory=10) == pytest.approx(10)
    assert Need(flops=100, bytes=1000).least_s(flops=10, memory=10) == pytest.approx(100)


def test_a_card_is_known_by_its_drivers_name() -> None:
    card = card_of("1 × NVIDIA H200")
    assert card is not None
    assert card.memory == 4.8e12
    assert card_of("1 × another") is None
    assert card_of(None) is None
