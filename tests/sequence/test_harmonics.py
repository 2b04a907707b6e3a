"""Harmonics above degree 0 keep their first values, and a warning reports visible changes."""

from dataclasses import replace

import numpy as np
import pytest

from moving_sequences import moving_frames
from splatwire.sequence import SequenceEncoder
from splatwire.sequence.options import SequenceOptions
from splatwire.types.splats import Splats


def with_harmonics(frames: list[Splats], step: float) -> list[Splats]:
    """Frames of degree 1 with higher coefficients that grow over time."""
    return [
        replace(
            splats,
            sh=np.concatenate(
                [splats.sh[:, :1], np.full((splats.num_gaussians, 3, 3), step * number, np.float32)], axis=1
            ),
        )
        for number, splats in enumerate(frames)
    ]


@pytest.mark.parametrize(("step", "warnings"), [(0.0, 0), (0.05, 1)])
def test_changing_harmonics_are_warned_about_once(caplog: pytest.LogCaptureFixture, step: float, warnings: int) -> None:
    encoder = SequenceEncoder(SequenceOptions(group_frames=3))
    for splats in with_harmonics(moving_frames(60, 6), step):
        encoder.push(splats)
    encoder.finish()
    warned = [record for record in caplog.records if "harmonics above degree 0" in record.getMessage()]
    assert len(warned) == warnings
