import numpy as np
import pytest

from splatwire.codec.integer_network import IntegerLinear
from splatwire.codec.weight_bytes import read_mlp, write_mlp
from splatwire.codec.weights import QuantisedMlp, exact_linear, exact_mlp, quantise_linear, quantise_mlp
from splatwire.entropy.coder import encode_symbols
from splatwire.entropy.integers import scale_index, write_integers, zero_mean_rows
from splatwire.errors import BitstreamError
from splatwire.files.byte_io import ByteReader, ByteWriter


def network(rng: np.random.Generator, leaky: bool, tolerance: float = 0.01) -> tuple[QuantisedMlp, tuple, np.ndarray]:
    layers = [(rng.normal(size=(20, 12)), rng.normal(size=20)), (rng.normal(size=(7, 20)) * 0.3, rng.normal(size=7))]
    inputs = rng.normal(size=(400, 12)) * 2.0 ** rng.integers(-6, 3, 12)
    return quantise_mlp(*layers, inputs, np.full(7, tolerance), leaky=leaky), tuple(layers), inputs


def evaluate(layers: tuple, inputs: np.ndarray, leaky: bool) -> np.ndarray:
    pre = inputs @ layers[0][0].T + layers[0][1]
    return np.where(pre > 0, pre, 0.01 * pre if leaky else 0) @ layers[1][0].T + layers[1][1]


@pytest.mark.parametrize("leaky", [False, True])
def test_rounding_noise_is_near_the_tolerance(leaky: bool) -> None:
    rng = np.random.default_rng(0)
    for tolerance in (0.1, 0.01):
        mlp, layers, inputs = network(rng, leaky, tolerance)
        integer = mlp.integer()(np.rint(inputs * 2**14)) / 2**16
        error = integer - evaluate(layers, inputs, leaky)
        assert 0.3 * tolerance < error.std() < 3 * tolerance


def test_integer_and_dequantised_network_agree() -> None:
    mlp, _, inputs = network(np.random.default_rng(1), True)
    layers = (mlp.hidden.dequantised(), mlp.output.dequantised())
    integer = mlp.integer()(np.rint(inputs * 2**14)) / 2**16
    assert np.abs(integer - evaluate(layers, inputs, True)).max() < 2e-3


def num_bytes(mlp: QuantisedMlp) -> int:
    writer = ByteWriter()
    write_mlp(writer, mlp)
    return len(writer.bytes())


def test_correlated_inputs_save_bits_at_equal_error() -> None:
    rng = np.random.default_rng(4)
    layers = [(rng.normal(size=(20, 48)), rng.normal(size=20)), (rng.normal(size=(7, 20)) * 0.3, rng.normal(size=7))]
    alone = rng.normal(size=(4000, 48))
    follow = alone[:, :12] @ rng.normal(size=(12, 48)) / 12**0.5 + 0.05 * alone
    sizes, errors = [], []
    for inputs in (alone, follow):
        mlp = quantise_mlp(*layers, inputs[:2000], np.full(7, 0.02), leaky=True)
        others = mlp.integer()(np.rint(inputs[2000:] * 2**14)) / 2**16  # anchors that were not used for the rounding
        sizes.append(num_bytes(mlp))
        errors.append((others - evaluate(layers, inputs[2000:], True)).std())
    assert sizes[1] < 0.8 * sizes[0]
    assert max(errors) < 0.03


def test_rounding_errors_of_equal_inputs_compensate() -> None:
    # two equal inputs: only the sum of their weights counts, and it is rounded as finely as one weight
    inputs = np.repeat(np.linspace(-1, 1, 201)[:, None], 2, axis=1)
    layer = quantise_linear(np.array([[0.3, 0.45]]), np.zeros(1), inputs, np.array([0.05]))
    weight, _ = layer.dequantised()
    step = 2.0**-16 * (layer.row_steps[0] << layer.column_shifts.min())
    assert abs(weight.sum() - 0.75) <= step / 2 + 1e-3
    assert np.abs(layer.symbols).max() < 12


def test_bias_compensates_the_mean_rounding_error() -> None:
    rng = np.random.default_rng(5)
    inputs = 100 + rng.normal(size=(500, 3))
    weight, bias = rng.normal(size=(4, 3)), rng.normal(size=4)
    layer = quantise_linear(weight, bias, inputs, np.full(4, 0.1))
    rounded, new_bias = layer.dequantised()
    error = inputs @ (rounded - weight).T + new_bias - bias
    assert np.abs(rounded - weight).max() > 0.01  # separate rounding would give a hundred times the error
    assert np.abs(error.mean(axis=0)).max() < 0.002
    assert error.std() < 0.15


def test_networks_without_column_scales_are_read() -> None:
    mlp, _, _ = network(np.random.default_rng(6), False)
    writer = ByteWriter()
    for size in (12, 20, 7):
        writer.unsigned(size)
    writer.u8(0)
    for layer in (mlp.hidden, mlp.output):
        scales = scale_index(layer.symbols.std(axis=1))
        for values in (layer.row_steps, layer.column_shifts, layer.bias, scales):
            write_integers(writer, values)
        writer.blob(
            encode_symbols(layer.symbols.ravel().astype(np.int64), zero_mean_rows(scales, len(layer.symbols[0])))
        )
    again = read_mlp(ByteReader(writer.bytes(), "network"), "test", 12, 7)
    assert (again.hidden.symbols == mlp.hidden.symbols).all()
    assert (again.output.symbols == mlp.output.symbols).all()


def test_unknown_flags_are_refused() -> None:
    writer = ByteWriter()
    for value in (12, 20, 7):
        writer.unsigned(value)
    writer.u8(4)
    with pytest.raises(BitstreamError, match="flags 4"):
        read_mlp(ByteReader(writer.bytes(), "network"), "test", 12, 7)


def test_networks_round_trip_through_bytes() -> None:
    mlp, _, _ = network(np.random.default_rng(2), True)
    writer = ByteWriter()
    write_mlp(writer, mlp)
    reader = ByteReader(writer.bytes(), "network")
    again = read_mlp(reader, "test", 12, 7)
    reader.finish()
    for a, b in ((mlp.hidden, again.hidden), (mlp.output, again.output)):
        for name in ("symbols", "row_steps", "column_shifts", "bias"):
            assert (getattr(a, name) == getattr(b, name)).all(), name
    assert again.leaky


def test_wrong_weight_shape_is_named() -> None:
    writer = ByteWriter()
    write_mlp(writer, network(np.random.default_rng(3), False)[0])
    with pytest.raises(BitstreamError, match="color network"):
        read_mlp(ByteReader(writer.bytes(), "networks"), "color", 13, 7)


def test_weights_beyond_exact_arithmetic_are_refused() -> None:
    with pytest.raises(BitstreamError, match="exactly"):
        IntegerLinear(np.full((2, 64), 1 << 23, dtype=np.int64), np.zeros(2, dtype=np.int64))


@pytest.mark.parametrize("seed", range(5))
def test_quantised_network_is_recognised(seed: int) -> None:
    mlp, layers, _ = network(np.random.default_rng(seed), True)
    numbers = [tuple(part.astype(np.float64) for part in layer.dequantised()) for layer in (mlp.hidden, mlp.output)]
    found = exact_mlp(*numbers, leaky=True)
    assert found is not None
    for one, other in ((found.hidden, mlp.hidden), (found.output, mlp.output)):
        assert np.array_equal(one.integer().weight, other.integer().weight)
        assert np.array_equal(one.bias, other.bias)
    assert num_bytes(found) <= 1.02 * num_bytes(mlp)
    assert exact_mlp(*layers, leaky=True) is None


@pytest.mark.parametrize("scale", [1.0, 100.0, 300.0])
def test_integer_weights_are_exact_in_float32(scale: float) -> None:
    rng = np.random.default_rng(0)
    weight = rng.normal(size=(6, 8)) * scale
    layer = quantise_linear(weight, np.zeros(6), rng.normal(size=(100, 8)), np.full(6, 1e-4))
    found = exact_linear(*(part.astype(np.float64) for part in layer.dequantised()))
    assert found is not None
    assert np.array_equal(found.integer().weight, layer.integer().weight)


def test_rows_and_columns_of_zeros_are_exact() -> None:
    weight = np.array([[0.0, 0.0, 0.0], [0.0, 65535.5 / 65536, 0.0]]) * 2
    found = exact_linear(weight, np.zeros(2))
    assert found is not None
    assert np.array_equal(found.dequantised()[0], weight)
