"""A clip of format 3, written by the first release of clips, decodes to the same integers."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.distance import cdist

from moving_sequences import drawn, errors, lasting_frames, moving_frames
from splatwire.bitstream import read_stream
from splatwire.codec import decode_stream
from splatwire.sequence.decoding import decode_frames

CLIP = Path(__file__).with_name("tiny_clip.swz")
SHOTS = Path(__file__).with_name("tiny_shots.swz")
UNITS = Path(__file__).with_name("tiny_units.swz")
UNITS_DIGEST = "e6decd133f32fba11daa5e1f824c4cfcc8df02e30e2229f7e8d7f6e638ba3f31"
SHOTS_DIGEST = "7058906a1f52133834f4f6cf2e773466253f30bd62f1dd3f22723c845315c2b5"
DIGEST = "0fc1553877db00d774f6982676ede15b798e33ae1c311dd0a6631e08002a4fc0"


def test_golden_clip_decodes_to_the_same_integers():
    stream, report = read_stream(CLIP)
    assert report.num_missing == 0
    assert stream.manifest.symbols_digest == DIGEST
    decode_stream(stream)  # decoding compares the digest


def test_golden_shots_decode_to_the_same_integers():
    stream, report = read_stream(SHOTS)
    assert report.num_missing == 0
    assert stream.manifest.symbols_digest == SHOTS_DIGEST
    decode_stream(stream)  # decoding compares the digest


def test_golden_units_of_motion_show_the_same_frames():
    """The digest covers coded integers; frames also depend on the conversion between the units of shots."""
    stream, report = read_stream(UNITS)
    assert report.num_missing == 0
    assert stream.manifest.symbols_digest == UNITS_DIGEST
    assert stream.side_info[1] == 3, "version of the side information of sequences"
    frames = lasting_frames(4, [1.0, 1 / 5000, 1.0], lasting=20)
    for frame, shown in zip(frames, decode_frames(decode_stream(stream).scene), strict=True):
        assert np.quantile(errors(drawn(frame), shown.scene.splats), 0.9) < 0.3


@pytest.mark.parametrize("number", [0, 5])
def test_golden_clip_shows_the_same_frames(number):
    frame = list(decode_frames(decode_stream(read_stream(CLIP)[0]).scene))[number]
    wanted = drawn(moving_frames(300, 8)[number])
    apart = cdist(frame.scene.splats.means, wanted.means)
    distance, index = apart.min(axis=1), apart.argmin(axis=1)
    assert len(np.unique(index)) == frame.scene.num_elements == wanted.num_gaussians
    assert float(distance.max()) < 0.03
