import builtins
import random

import pytest

from splatwire.errors import BackendUnavailableError, InvalidValueError
from splatwire.transport import fec


@pytest.mark.parametrize("num_bytes", [1, 64, 65, 1000, 5000, 64 * 700])
def test_slightly_more_than_k_symbols_decode(num_bytes):
    pytest.importorskip("raptorq", reason="the package raptorq is not installed")
    rng = random.Random(num_bytes)
    data = rng.randbytes(num_bytes)
    total = fec.num_symbols(num_bytes, 64)
    symbols = fec.source_symbols(data, 64) + fec.repair_symbols(data, 64, total + 10)
    for _ in range(5):
        numbers = rng.sample(range(len(symbols)), total + 6)
        found = fec.recover({n: symbols[n] for n in numbers}, total, 64)
        assert found is not None
        assert b"".join(found)[:num_bytes] == data
    assert fec.recover({n: symbols[n] for n in numbers[: total - 1]}, total, 64) is None


def test_lossless_blocks_need_no_raptorq_package(monkeypatch):
    data = bytes(range(200))
    symbols = dict(enumerate(fec.source_symbols(data, 64)))
    without_package(monkeypatch)
    assert b"".join(fec.recover(symbols, 4, 64) or [])[:200] == data
    del symbols[2]
    assert fec.recover(symbols, 4, 64) is None
    symbols[5] = bytes(64)
    with pytest.raises(BackendUnavailableError, match=r"splatwire\[relay\]"):
        fec.recover(symbols, 4, 64)


def without_package(monkeypatch):
    real = builtins.__import__
    fec._raptorq.cache_clear()

    def refuse(name, *rest, **more):
        if name == "raptorq":
            raise ImportError(name)
        return real(name, *rest, **more)

    monkeypatch.setattr(builtins, "__import__", refuse)


def test_impossible_blocks_are_refused():
    for arguments in ((b"", 64, 1), (bytes(64 * 2049), 64, 1), (b"x", 64, 5000), (b"x", 60, 1), (b"x", 8192, 1)):
        with pytest.raises(InvalidValueError):
            fec.repair_symbols(*arguments)


def test_framing_preserves_sizes():
    packets = [b"a", b"bc" * 50, b""]
    size = fec.symbol_bytes_for(100)
    framed = fec.framed(packets, size)
    assert [fec.unframed(framed[i : i + size]) for i in range(0, len(framed), size)] == packets
    assert fec.unframed(b"\xff\xff123") == b"123"
