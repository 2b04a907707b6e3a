"""A scene with levels (format 4) as the first release that wrote them wrote it: it decodes to the same for ever."""

from pathlib import Path

from splatwire.codec import decode_stream
from splatwire.levels import tiles_of
from splatwire.packets import read_stream

STREAM = Path(__file__).with_name("tiny_levels.swz")
DIGEST = "6bb7ddc5c27c2426db3b2e69e6c1f45185e72cf8b743d3969867a496f7425061"


def test_it_decodes_to_the_same_integers():
    stream, report = read_stream(STREAM)
    assert report.num_missing == 0
    assert stream.manifest.symbols_digest == DIGEST
    decode_stream(stream)  # compares what it decodes with that


def test_it_has_the_same_tiles():
    tiles = tiles_of(read_stream(STREAM)[0])
    assert tiles.levels.tolist() == [2] + [1] * 3 + [0] * 23
    assert tiles.parents[4:].tolist() == [1] * 8 + [2] * 7 + [3] * 8
    assert int(tiles.counts[tiles.levels == 0].sum()) == 900
    assert int(tiles.sizes.sum()) == STREAM.stat().st_size - int(_head_bytes(STREAM.read_bytes()))


def _head_bytes(data: bytes) -> int:
    """Magic and sizes, manifest, side information."""
    stream, _ = read_stream(STREAM)
    return 9 + int.from_bytes(data[5:9], "little") + len(stream.side_info)
