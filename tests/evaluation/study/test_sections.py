import pytest

from scenes import tiny_scene
from splatwire.bitstream import PRESETS
from splatwire.bitstream.sections import with_section
from splatwire.codec import encode_scene
from splatwire.evaluation.study.definition import Row
from splatwire.evaluation.study.inputs import _repacked
from splatwire.evaluation.study.parts import sections_of


@pytest.mark.parametrize("preset", ["paper", "datagram"])
def test_row_uses_the_calibrated_stream_with_its_own_sections_only(preset: str) -> None:
    """Weights in a section depend on the networks of their stream, so these stay in other packets."""
    plain = encode_scene(tiny_scene(), PRESETS["paper"])
    calibrated = with_section(with_section(plain, "one", b"1"), "two", b"22")
    stream = _repacked(calibrated, Row("a", "a", PRESETS[preset], sections=("two",)), lambda share: None)
    assert dict(sections_of(stream)) == {"two": b"22"}
    assert stream.side_info == with_section(plain, "two", b"22").side_info
    payloads = [[packet.payload for packet in some.packets] for some in (stream, calibrated)]
    assert (payloads[0] == payloads[1]) == (preset == "paper")
