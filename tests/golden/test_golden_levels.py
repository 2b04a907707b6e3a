"""A scene with levels (format 4), written by the first release of levels, decodes to the same integers."""

from pathlib import Path

from splatwire.bitstream import read_stream
from splatwire.codec import decode_stream
from splatwire.lod import tiles_of

STREAM = Path(__file__).with_name("tiny_levels.swz")
DIGEST = "6bb7ddc5c27c2426db3b2e69e6c1f45185e72cf8b743d3969867a496f7425061"


def test_golden_levels_decode_to_the_same_integers():
    stream, report = read_stream(STREAM)
    assert report.num_missing == 0
    assert stream.manifest.symbols_digest == DIGEST
    decode_stream(stream)  # decoding compares the digest


def test_golden_levels_have_the_same_tiles():
    tiles = tiles_of(read_stream(STREAM)[0])
    assert tiles.levels.tolist() == [2] + [1] * 3 + [0] * 23
    assert tiles.parents[4:].tolist() == [1] * 8 + [2] * 7 + [3] * 8
    assert int(tiles.counts[tiles.levels == 0].sum()) == 900
    assert int(tiles.sizes.sum()) == STREAM.stat().st_size - int(_head_bytes(STREAM.read_bytes()))


def _head_bytes(data: bytes) -> int:
    """Start of the file: magic and sizes, manifest, side information."""
    stream, _ = read_stream(STREAM)
    return 9 + int.from_bytes(data[5:9], "little") + len(stream.side_info)
