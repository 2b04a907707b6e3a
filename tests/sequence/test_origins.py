"""Origin and initial view of a sequence: those of the first frame that is visible, also after a restart."""

from dataclasses import replace

import numpy as np
import pytest

from moving_sequences import moving_frames
from splatwire.bitstream.origin import ORIGIN_SECTION
from splatwire.bitstream.sections import sections_of
from splatwire.codec.initial_view import EXTENT_SECTION, read_extent
from splatwire.codec.initial_view import SECTION as INITIAL_VIEW
from splatwire.codec.metadata import read_metadata
from splatwire.sequence import SequenceEncoder, SequenceOptions
from splatwire.sequence.frames import Frame
from splatwire.types.metadata import SceneMetadata, StartView

MAP = (448_262.0, 5_411_932.0, 112.0)
NEAR_MAP = (448_264.0, 5_411_930.0, 112.0)
VIEW = SceneMetadata(view=StartView((1.0, 2.0, 3.0), (0.0, 0.0, 0.0), (0.0, -1.0, 0.0)))


def visible(**properties):
    splats = moving_frames(60, 1)[0]
    return Frame.of(replace(splats, opacities=splats.opacities.clip(0.5)), **properties)


def empty(**properties):
    splats = moving_frames(1, 1)[0]
    clear = replace(splats, means=np.zeros_like(splats.means), opacities=np.zeros_like(splats.opacities))
    return Frame.of(clear, **properties)


def test_an_empty_first_frame_does_not_choose_the_origin(caplog):
    encoder = SequenceEncoder(SequenceOptions(group_frames=2))
    view = VIEW.moved_origin(MAP, (0.0, 0.0, 0.0))
    for frame in (empty(metadata=view), visible(origin=MAP), visible(origin=MAP), empty(), visible(origin=MAP)):
        encoder.push(frame)
    sections = sections_of(encoder.finish())
    assert ORIGIN_SECTION.read(sections) == MAP
    assert read_metadata(sections).view == VIEW.view
    assert EXTENT_SECTION in sections
    middle, radius = read_extent(sections)
    assert max(map(abs, middle)) < 100
    assert radius < 100
    assert "from the origin" not in caplog.text


@pytest.mark.parametrize(
    ("origin", "offset"), [(MAP, (0, 0, 0)), (NEAR_MAP, (-2, 2, 0)), ((0.0, 0.0, 0.0), None)], ids=str
)
def test_an_initial_view_follows_the_origin_of_a_restarted_sequence(origin, offset):
    """The view of a distant place is left out."""
    encoder = SequenceEncoder(SequenceOptions(group_frames=1), live=True)
    encoder.push(visible(origin=MAP, metadata=VIEW))
    after = encoder.restarted(1)
    after.push(visible(origin=origin))
    sections = sections_of(after.finish())
    assert ORIGIN_SECTION.read(sections) == origin
    if offset is None:
        assert INITIAL_VIEW not in sections
    else:
        eye = read_metadata(sections).view.eye
        np.testing.assert_allclose(eye, np.array(VIEW.view.eye) + offset)
