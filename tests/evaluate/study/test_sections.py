import pytest

from scenes import tiny_scene
from splatwire.codec import encode_scene
from splatwire.errors import InvalidValueError
from splatwire.evaluate.study.definition import Row
from splatwire.evaluate.study.inputs import _with_sections
from splatwire.evaluate.study.parts import sections_of
from splatwire.packets import PRESETS
from splatwire.packets.sections import add_concealment


def test_a_row_gets_the_calibrated_stream_with_its_own_sections_only() -> None:
    """Sections are coded against the networks of their stream: they must not move into another encoding."""
    plain = encode_scene(tiny_scene(), PRESETS["paper"])
    calibrated = add_concealment(add_concealment(plain, "one", b"1"), "two", b"22")
    row = Row("a", "a", PRESETS["paper"], sections=("two",))
    stream = _with_sections(calibrated, row)
    assert dict(sections_of(stream)) == {"two": b"22"}
    assert stream == add_concealment(plain, "two", b"22")
    assert stream.packets == calibrated.packets


def test_other_packets_or_no_stream_are_refused() -> None:
    row = Row("a", "a", PRESETS["paper"], sections=("two",))
    other = add_concealment(encode_scene(tiny_scene(), PRESETS["datagram"]), "two", b"22")
    for stream in (other, None):
        with pytest.raises(InvalidValueError, match=r"row 'a' needs sections made for its own packets \(paper\+two\)"):
            _with_sections(stream, row)
