import pytest

from scenes import tiny_scene
from splatwire.codec import encode_scene
from splatwire.evaluate.study.definition import Row
from splatwire.evaluate.study.inputs import _repacked
from splatwire.evaluate.study.parts import sections_of
from splatwire.packets import PRESETS
from splatwire.packets.sections import add_concealment


@pytest.mark.parametrize("preset", ["paper", "datagram"])
def test_a_row_gets_the_calibrated_stream_with_its_own_sections_only(preset: str) -> None:
    """Sections are coded against the networks of their stream: these stay in other packets, too."""
    plain = encode_scene(tiny_scene(), PRESETS["paper"])
    calibrated = add_concealment(add_concealment(plain, "one", b"1"), "two", b"22")
    stream = _repacked(calibrated, Row("a", "a", PRESETS[preset], sections=("two",)), lambda share: None)
    assert dict(sections_of(stream)) == {"two": b"22"}
    assert stream.side_info == add_concealment(plain, "two", b"22").side_info
    payloads = [[packet.payload for packet in some.packets] for some in (stream, calibrated)]
    assert (payloads[0] == payloads[1]) == (preset == "paper")
