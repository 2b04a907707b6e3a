"""The prior of a decoder against the float model that training differentiates."""

import numpy as np

from reference.float_prior import evaluate_prior
from scenes import tiny_scene
from splatwire.bitstream import Packetization
from splatwire.codec import decode_stream, encode_scene, scene_in_order
from splatwire.neural.model.tensors import to_tensors
from splatwire.ops.arrays import to_arrays
from splatwire.types import Prior


def test_prior_is_near_the_float_model() -> None:
    scene = scene_in_order(tiny_scene(seed=3, num_anchors=700), "morton")
    ours = decode_stream(encode_scene(scene, Packetization(block_size=100)))
    contexts, positions = (
        (scene.coding.context_model, ours.scene.coding.context_model),
        to_tensors(scene.anchors.positions),
    )
    float_prior, again = (
        to_arrays(evaluate_prior(to_tensors(context), positions, scene.coding.config)) for context in contexts
    )
    for name in ("feature", "scaling", "offset"):
        a, b = getattr(ours[Prior], name), getattr(float_prior, name)
        spread = b.scale + b.step
        assert (np.abs(a.mean - b.mean) / spread).mean() < 0.1
        assert np.allclose(a.step, b.step, rtol=0.1)
        # the dequantised networks of the decoded scene say the same as the integers, up to fixed-point rounding
        assert (np.abs(getattr(again, name).mean - a.mean) / spread).max() < 0.01
