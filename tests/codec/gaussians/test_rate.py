from pathlib import Path

import numpy as np
import pytest

from explicit import decode_splats, encode_splats
from splatwire.bitstream import PRESETS
from splatwire.io.formats import read_splats
from splatwire.render import iterate_views
from splatwire.render.importance import cameras_around
from splatwire.render.precision import measure_class_offsets
from splatwire.types import SplatScene


@pytest.mark.data
def test_tiger_takes_less_than_half_of_its_spz(data_dir: Path) -> None:
    """SPZ 4 of this file has 154,791 bytes (50.5 dB), SOG 146,493 (56.5 dB)."""
    splats = read_splats(data_dir / "splats/tiger_4d/tiger_4d_model_0.ply")
    stream = encode_splats(splats, PRESETS["datagram"], class_offsets=measure_class_offsets(splats))
    decoded = decode_splats(stream)[0]
    cameras = cameras_around(splats.means, 4, 128)
    errors = [
        float(((ours - theirs) ** 2).mean())
        for ours, theirs in zip(*(iterate_views(SplatScene(s), cameras) for s in (decoded, splats)), strict=True)
    ]
    assert stream.num_bytes < 70_000
    assert float(np.mean(-10 * np.log10(errors))) > 40
    assert bool(np.isfinite(decoded.means).all())
