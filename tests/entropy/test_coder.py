import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import ndtr

from reference import range_coder as reference
from splatwire.entropy import coder
from splatwire.entropy.tables import MEAN_BITS, NUM_SCALES


def random_mixtures(rng: np.random.Generator, n: int) -> coder.Mixtures:
    weight = np.where(rng.random(n) < 0.5, 65536, rng.integers(0, 65537, n))
    return coder.Mixtures(
        rng.integers(-(2**20), 2**20, n),
        rng.integers(0, NUM_SCALES, n),
        rng.integers(-(2**20), 2**20, n),
        rng.integers(0, NUM_SCALES, n),
        weight.astype(np.int64),
    )


def as_reference(m: coder.Mixtures) -> list[reference.ReferenceMixture]:
    rows = zip(m.mean0, m.scale0, m.mean1, m.scale1, m.weight, strict=True)
    return [reference.ReferenceMixture(*(int(v) for v in row)) for row in rows]


def likely_symbols(rng: np.random.Generator, m: coder.Mixtures) -> np.ndarray:
    scale = 2.0 ** (m.scale0 / 16 - 6)
    symbols = np.rint(m.mean0 / 2**MEAN_BITS + scale * rng.standard_normal(len(scale)))
    far = rng.random(len(scale)) < 0.05  # some escapes of all lengths
    return np.where(far, rng.integers(-(2**30), 2**30, len(scale)) >> rng.integers(0, 30, len(scale)), symbols).astype(
        np.int64
    )


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32), n=st.integers(0, 40))
def test_coder_bytes_equal_the_reference_and_round_trip(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    mixtures = random_mixtures(rng, n)
    symbols = likely_symbols(rng, mixtures)
    data = coder.encode_symbols(symbols, mixtures)
    assert data == reference.encode([int(s) for s in symbols], as_reference(mixtures))
    assert (coder.decode_symbols(data, mixtures) == symbols).all()


def test_reference_decodes_the_fast_coder() -> None:
    rng = np.random.default_rng(5)
    n = 60
    mixtures = coder.Mixtures.normals(rng.integers(-(2**16), 2**16, n), rng.integers(0, 120, n))
    symbols = likely_symbols(rng, mixtures)
    assert reference.decode(coder.encode_symbols(symbols, mixtures), as_reference(mixtures)) == symbols.tolist()


def test_carries_propagate_into_written_bytes() -> None:
    # repeating the last symbol of a wide window drives `low` towards 0xFF... until a carry propagates
    rng = np.random.default_rng(0)
    n = 20_000
    bits = (rng.random(n) < 0.999).astype(np.uint8)
    contexts = np.zeros(n, dtype=np.int64)
    data = coder.encode_bits(bits, contexts, coder.fresh_models(1))
    assert data == reference.encode_bits(bits.tolist(), contexts.tolist(), coder.fresh_models(1).tolist())
    assert (coder.decode_bits(data, contexts, coder.fresh_models(1)) == bits).all()


@pytest.mark.parametrize("seed", range(5))
def test_adaptive_bits_equal_the_reference(seed: int) -> None:
    rng = np.random.default_rng(seed)
    contexts = rng.integers(0, 7, 3000)
    bits = (rng.random(3000) < (contexts + 0.5) / 8).astype(np.uint8)
    models = coder.fresh_models(7)
    data = coder.encode_bits(bits, contexts, models)
    assert data == reference.encode_bits(bits.tolist(), contexts.tolist(), models.tolist())
    assert (coder.decode_bits(data, contexts, models) == bits).all()
    p = (contexts + 0.5) / 8
    entropy = -(p * np.log2(p) + (1 - p) * np.log2(1 - p)).sum() / 8
    assert len(data) < 1.06 * entropy + 20


def test_coded_size_is_near_the_entropy() -> None:
    rng = np.random.default_rng(1)
    n = 50_000
    scales = rng.integers(80, 160, n)
    sigma = 2.0 ** (scales // 16 - 6) * (1 + (scales % 16 + 0.5) / 16)
    means = rng.integers(-(2**15), 2**15, n)
    symbols = np.rint(means / 2**MEAN_BITS + sigma * rng.standard_normal(n)).astype(np.int64)
    center = symbols - means / 2**MEAN_BITS
    bits = -np.log2(ndtr((center + 0.5) / sigma) - ndtr((center - 0.5) / sigma)).sum()
    data = coder.encode_symbols(symbols, coder.Mixtures.normals(means, scales))
    assert len(data) * 8 == pytest.approx(bits, rel=1e-3)


def test_termination_costs_at_most_two_bytes() -> None:
    rng = np.random.default_rng(2)
    costs = []
    for _ in range(200):
        n = 300
        scales = np.full(n, 96)
        symbols = np.rint(rng.standard_normal(n)).astype(np.int64)
        whole = len(
            coder.encode_symbols(np.tile(symbols, 20), coder.Mixtures.normals(np.zeros(20 * n), np.tile(scales, 20)))
        )
        costs.append(len(coder.encode_symbols(symbols, coder.Mixtures.normals(np.zeros(n), scales))) - whole / 20)
    assert 0 <= np.mean(costs) <= 2


@settings(max_examples=300, deadline=None)
@given(data=st.binary(max_size=64), seed=st.integers(0, 100))
def test_arbitrary_bytes_decode_without_an_error(data: bytes, seed: int) -> None:
    mixtures = random_mixtures(np.random.default_rng(seed), 50)
    assert coder.decode_symbols(data, mixtures).shape == (50,)


def test_coded_bytes_are_pinned() -> None:
    symbols = np.array([0, 1, -1, 5, -300, 7, 100_000, -100_000, 0, 0])
    mixtures = coder.Mixtures(
        np.array([0, 4096, -4096, 20000, -1_228_800, 0, 0, 0, 100, -100]),
        np.array([96, 100, 90, 130, 200, 0, 50, 60, 319, 10]),
        np.array([0, 0, 0, 0, 0, 28_000, 0, 0, 0, 0]),
        np.array([0, 0, 0, 0, 0, 110, 0, 0, 0, 0]),
        np.array([65536, 65536, 65536, 65536, 65536, 30000, 65536, 65536, 65536, 65536]),
    )
    assert coder.encode_symbols(symbols, mixtures).hex() == "8021d0c4dcafc7391b7cdc7bc8c8a46aca09"
