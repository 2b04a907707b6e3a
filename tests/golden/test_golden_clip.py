"""A clip of format 3 as the first release that wrote clips wrote it: it decodes to the same integers for ever."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.distance import cdist

from moving_clips import drawn, moving_frames
from splatwire.clips.decoding import decode_frames
from splatwire.codec import decode_stream
from splatwire.packets import read_stream

CLIP = Path(__file__).with_name("tiny_clip.swz")
DIGEST = "0fc1553877db00d774f6982676ede15b798e33ae1c311dd0a6631e08002a4fc0"


def test_it_decodes_to_the_same_integers():
    stream, report = read_stream(CLIP)
    assert report.num_missing == 0
    assert stream.manifest.symbols_digest == DIGEST
    decode_stream(stream)  # compares what it decodes with that


@pytest.mark.parametrize("number", [0, 5])
def test_it_shows_the_same_frames(number):
    frame = list(decode_frames(decode_stream(read_stream(CLIP)[0]).scene))[number]
    wanted = drawn(moving_frames(300, 8)[number])
    apart = cdist(frame.scene.splats.means, wanted.means)
    distance, index = apart.min(axis=1), apart.argmin(axis=1)
    assert len(np.unique(index)) == frame.scene.num_elements == wanted.num_gaussians
    assert float(distance.max()) < 0.03
