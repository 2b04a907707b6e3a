"""The range coder that reads and writes several bytes at once equals the one that handles single bytes."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from splatwire.entropy import word_kernels as words
from splatwire.entropy.coder import fresh_models
from splatwire.entropy.normal_kernels import decode_escape
from splatwire.entropy.range_kernels import (
    decode_advance,
    decode_below,
    decode_bit,
    decode_bits,
    decode_raw,
    decode_target,
    decoder_start,
    encode_below,
    encode_bit,
    encode_bits,
    encode_interval,
    encoder_finish,
    encoder_start,
)

CONTEXTS = 3
NUMBER = np.int64
SYMBOLS = st.one_of(
    st.tuples(st.just("adaptive"), st.integers(0, CONTEXTS - 1)),
    st.tuples(st.just("flag"), st.just(0)),
    st.tuples(st.just("raw"), st.integers(0, 63)),
    st.tuples(st.just("below"), st.integers(1, 1 << 16)),
    st.tuples(st.just("escape"), st.just(0)),
    st.tuples(st.just("interval"), st.integers(1, 1 << 24)),
)


def test_words_begin_at_each_byte() -> None:
    data = np.arange(1, 10, dtype=np.uint8)
    padded = bytes(data) + bytes(8)
    expected = [int.from_bytes(padded[i : i + 7], "big") for i in range(len(data) + 1)]
    np.testing.assert_array_equal(words.words_of(data), expected)


@settings(max_examples=300, deadline=None)
@given(payload=st.binary(max_size=60), symbols=st.lists(SYMBOLS, max_size=60))
def test_words_and_bytes_give_the_same_symbols(payload: bytes, symbols: list[tuple[str, int]]) -> None:
    data, end = np.frombuffer(payload, dtype=np.uint8).copy(), NUMBER(len(payload))
    slow = np.empty(3, np.int64)
    decoder_start(data, NUMBER(0), end, slow)
    fast, read = slow.copy(), words.words_of(data)
    models, other = fresh_models(CONTEXTS), fresh_models(CONTEXTS)
    for kind, number in symbols:
        if kind == "adaptive":
            a = decode_bit(data, end, slow, models, NUMBER(number))
            b = words.adaptive_bit(read, fast, other, NUMBER(number))
        elif kind == "flag":
            a, b = decode_raw(data, end, slow), words.raw_bit(read, fast)
        elif kind == "raw":
            a, b = decode_bits(data, end, slow, NUMBER(number)), words.raw_bits(read, fast, NUMBER(number))
        elif kind == "below":
            a, b = decode_below(data, end, slow, NUMBER(number)), words.number_below(read, fast, NUMBER(number))
        elif kind == "escape":
            a, b = decode_escape(data, end, slow), words.escaped(read, fast)
        else:
            bits = NUMBER(24)
            a, b = decode_target(slow, bits), NUMBER(0)
            start = NUMBER(max(int(a) - number // 2, 0))
            size = NUMBER(min(number, (1 << 24) - int(start)))
            decode_advance(data, end, slow, start, size, bits)
            words.advance(read, fast, start, size, bits)
            b = a
        assert a == b
        np.testing.assert_array_equal(slow, fast)
        np.testing.assert_array_equal(models, other)


WRITTEN = st.one_of(
    st.tuples(st.just("adaptive"), st.integers(0, CONTEXTS - 1), st.integers(0, 1)),
    st.tuples(st.just("raw"), st.integers(0, 63), st.integers(0, (1 << 63) - 1)),
    st.tuples(st.just("below"), st.integers(1, 1 << 16), st.integers(0, 1 << 16)),
    st.tuples(st.just("interval"), st.integers(1, 1 << 24), st.integers(0, 1 << 24)),
    st.tuples(st.just("last"), st.integers(1, 3), st.just(0)),  # intervals at the end cause carries
)


@settings(max_examples=300, deadline=None)
@given(symbols=st.lists(WRITTEN, max_size=120))
def test_both_encoders_write_the_same_bytes(symbols: list[tuple[str, int, int]]) -> None:
    slow, fast = np.empty(3, np.int64), np.empty(3, np.int64)
    encoder_start(slow)
    encoder_start(fast)
    bytewise, several = np.empty(2048, np.uint8), np.empty(2048, np.uint8)
    models, other = fresh_models(CONTEXTS), fresh_models(CONTEXTS)
    for kind, number, value in symbols:
        a, b = NUMBER(number), NUMBER(value)
        if kind == "adaptive":
            encode_bit(bytewise, slow, models, a, b)
            words.write_bit(several, fast, other, a, b)
        elif kind == "raw":
            encode_bits(bytewise, slow, b, a)
            words.write_raw(several, fast, b, a)
        elif kind == "below":
            encode_below(bytewise, slow, NUMBER(value % number), a)
            words.write_below(several, fast, NUMBER(value % number), a)
        else:
            start = NUMBER(min(value, (1 << 24) - number) if kind == "interval" else (1 << 24) - number)
            encode_interval(bytewise, slow, start, a, NUMBER(24))
            words.write_interval(several, fast, start, a, NUMBER(24))
        np.testing.assert_array_equal(slow, fast)
        np.testing.assert_array_equal(models, other)
    length = encoder_finish(bytewise, slow)
    assert encoder_finish(several, fast) == length
    np.testing.assert_array_equal(bytewise[:length], several[:length])
