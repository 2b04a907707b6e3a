"""Streams with copies for the concealer `sketch`, and their content as read by Python."""

import numpy as np

from concealment.test_sketch import sketch_of_context
from splatwire.bitstream import SceneStream
from splatwire.codec import decode_stream, with_section
from splatwire.codec.gaussians.copies_encoder import write_copies
from splatwire.codec.gaussians.decoder import open_side_info
from splatwire.concealment.sketch.concealer import buckets_of, expected_scalings, sizes_of, sketched_attributes
from splatwire.concealment.sketch.section import SECTION, SketchSection, read_sketch, write_sketch
from splatwire.types import Copies, Prior, ReceivedScene


def with_copies(stream: SceneStream, growth: tuple[float, float, float] = (0.25, 0.75, 0.5)) -> SceneStream:
    """The Gaussians with copies of every seventh."""
    info, whole = open_side_info(stream.manifest, stream.side_info), decode_stream(stream).scene.splats
    places = np.arange(0, stream.manifest.num_elements, 7)
    return with_section(stream, SECTION, write_copies(whole, places, info, precision_class=7, growth=growth))


def with_sketch(stream: SceneStream, trust: float = 0.75) -> SceneStream:
    """The anchors with copies of a fifth; the values are arbitrary."""
    context = decode_stream(stream)
    sketch = sketch_of_context(3, sizes_of(context), trust=trust)
    return with_section(stream, SECTION, write_sketch(sketch, buckets_of(context)))


def copies_of(received: ReceivedScene) -> tuple[np.ndarray, list[float]]:
    """Positions of the copies, and their values one after another."""
    copies = received.get(Copies)
    if copies is not None:
        splats = copies.splats
        numbers = (splats.means, splats.scales, splats.quats, splats.opacities)
        return copies.indices, np.concatenate([part.flatten() for part in numbers]).astype(np.float64).tolist()
    section, prior = section_of(received), received[Prior]
    places = np.flatnonzero(section.levels)
    found = sketched_attributes(section, expected_scalings(prior)[places])
    features, scalings, offsets, mask = found
    far = offsets * scalings[:, None, :3] * mask[:, :, None]
    numbers = (received.positions[places], features, scalings[:, 3:], far)
    return places, np.concatenate([part.flatten() for part in numbers]).astype(np.float64).tolist()


def section_of(received: ReceivedScene) -> SketchSection:
    """The sketch of a stream of anchors."""
    return read_sketch(received.sections[SECTION], sizes_of(received), buckets_of(received))
