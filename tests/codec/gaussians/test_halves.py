"""Gaussians in float16 are coded like the same Gaussians in float32."""

from dataclasses import fields, replace

import numpy as np
import pytest

from explicit import ball_of_gaussians
from splatwire import encode
from splatwire.bitstream import stream_to_bytes
from splatwire.codec.gaussians.attributes import to_sources
from splatwire.codec.gaussians.blocks import gaussian_order
from splatwire.sequence.encoding import SequenceEncoder
from splatwire.types.splats import Splats

FIELDS = [field.name for field in fields(Splats)]


def converted(splats: Splats, names: list[str], kind: type) -> Splats:
    halves = {name: getattr(splats, name).astype(np.float16) for name in names}
    return replace(splats, **{name: values.astype(kind) for name, values in halves.items()})


@pytest.mark.parametrize("names", [*([name] for name in FIELDS), FIELDS], ids=lambda names: names[-1] + str(len(names)))
def test_halves_are_encoded_like_single_precision(names: list[str]) -> None:
    splats = ball_of_gaussians()
    halves, singles = (converted(splats, names, kind) for kind in (np.float16, np.float32))
    streams = [stream_to_bytes(encode(scene, effort="fast")) for scene in (halves, singles)]
    assert streams[0] == streams[1]
    logs = [to_sources(scene, 0).logs for scene in (halves, singles)]
    assert np.array_equal(*logs)


def test_clips_in_halves_are_encoded_like_single_precision() -> None:
    def stream(kind: type) -> bytes:
        encoder = SequenceEncoder(choose_class_offsets=lambda splats: np.zeros(splats.num_gaussians, np.uint8))
        encoder.push(converted(ball_of_gaussians(), FIELDS, kind))
        return stream_to_bytes(encoder.finish())

    assert stream(np.float16) == stream(np.float32)


@pytest.mark.filterwarnings("ignore:invalid value")
def test_positions_that_are_not_finite_have_no_order() -> None:
    means = ball_of_gaussians().means.copy()
    means[3] = np.nan
    with pytest.raises(ValueError, match="positions must be finite"):
        gaussian_order(means, None)
