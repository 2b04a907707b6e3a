import numpy as np
import pytest

from splatwire.codec.integer_network import IntegerLinear
from splatwire.codec.weight_bytes import read_mlp, write_mlp
from splatwire.codec.weights import QuantisedMlp, quantise_mlp
from splatwire.entropy.byte_io import ByteReader, ByteWriter
from splatwire.errors import BitstreamError


def network(rng: np.random.Generator, leaky: bool, tolerance: float = 0.01) -> tuple[QuantisedMlp, tuple, np.ndarray]:
    layers = [(rng.normal(size=(20, 12)), rng.normal(size=20)), (rng.normal(size=(7, 20)) * 0.3, rng.normal(size=7))]
    inputs = rng.normal(size=(400, 12)) * 2.0 ** rng.integers(-6, 3, 12)
    return quantise_mlp(*layers, inputs, np.full(7, tolerance), leaky=leaky), tuple(layers), inputs


def evaluate(layers: tuple, inputs: np.ndarray, leaky: bool) -> np.ndarray:
    pre = inputs @ layers[0][0].T + layers[0][1]
    return np.where(pre > 0, pre, 0.01 * pre if leaky else 0) @ layers[1][0].T + layers[1][1]


@pytest.mark.parametrize("leaky", [False, True])
def test_rounding_noise_stays_near_the_tolerance(leaky: bool) -> None:
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


def test_networks_come_back_from_bytes() -> None:
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


def test_wrong_shape_is_named() -> None:
    writer = ByteWriter()
    write_mlp(writer, network(np.random.default_rng(3), False)[0])
    with pytest.raises(BitstreamError, match="color network"):
        read_mlp(ByteReader(writer.bytes(), "networks"), "color", 13, 7)


def test_weights_beyond_exact_arithmetic_are_refused() -> None:
    with pytest.raises(BitstreamError, match="exactly"):
        IntegerLinear(np.full((2, 64), 1 << 23, dtype=np.int64), np.zeros(2, dtype=np.int64))
