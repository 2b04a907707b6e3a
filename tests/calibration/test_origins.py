"""Functions that take a scene and cameras give the same result for cameras relative to any origin."""

from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass, replace
from typing import Any

import numpy as np
import pytest

from scenes import tiny_cameras, tiny_scene
from splat_io.formats.handmade import some_splats
from splatwire.anchors.export.neural import possible_gaussians
from splatwire.anchors.export.visibility import visible_areas
from splatwire.bitstream import Packetization
from splatwire.calibration.preview import PreviewConfig, preview_for_scene
from splatwire.calibration.pseudo_loss import calibration_data
from splatwire.calibration.sketch import sketch_of
from splatwire.calibration.sketch_config import SketchConfig
from splatwire.calibration.views import CalibrationViews, References
from splatwire.codec import decode_stream, encode_scene
from splatwire.finetuning.tune import picture_gradients
from splatwire.render import render_scene
from splatwire.render.cpu import each_gradient_cpu
from splatwire.render.importance import footprint_importance
from splatwire.render.precision import measure_further_removal, measure_gaussians, scene_class_offsets
from splatwire.render.pruning import removal_errors
from splatwire.render.quick_sensitivity import quick_sensitivity
from splatwire.render.sensitivity import render_sensitivity
from splatwire.types import AnchorScene, Cameras, SplatScene
from splatwire.types.origin import NO_ORIGIN

pytestmark = pytest.mark.slow

ORIGIN = (4096.0, -1024.0, 512.0)
ANCHORS = replace(tiny_scene(seed=2, num_anchors=300), origin=ORIGIN)
GAUSSIANS = SplatScene(some_splats(300, 1), origin=ORIGIN)
WORLD = replace(tiny_cameras(num_views=4, width=48, height=32), origin=ORIGIN).relative_to(NO_ORIGIN)
SKETCH = SketchConfig(share=0.1, views=3, scored_views=2, num_losses=1, num_held_out_losses=1)
PREVIEW = PreviewConfig(num_bytes=400, steps=20, num_relocations=1, width=48, views=4)
BLACK = np.zeros((32, 48, 3), np.float32)


def sketch_with(scene: AnchorScene | SplatScene, config: SketchConfig) -> Callable[[Cameras], Any]:
    def sketch(cameras: Cameras) -> bytes:
        stream = encode_scene(scene, Packetization(block_size=60))
        return sketch_of(stream, decode_stream(stream), CalibrationViews(cameras), config).section

    return sketch


def calibration_cameras(cameras: Cameras) -> np.ndarray:
    stream = encode_scene(ANCHORS, Packetization(block_size=60))
    found = calibration_data(stream, decode_stream(stream), cameras).cameras
    assert found is not None
    return np.asarray(found.viewmats)


FUNCTIONS: dict[str, Callable[[Cameras], Any]] = {
    "render_sensitivity": lambda cameras: render_sensitivity(ANCHORS, cameras),
    "quick_sensitivity": lambda cameras: quick_sensitivity(ANCHORS, cameras, chosen=50),
    "visible_areas": lambda cameras: visible_areas(ANCHORS, possible_gaussians(ANCHORS), cameras, each_gradient_cpu),
    "removal_errors": lambda cameras: removal_errors(GAUSSIANS, cameras),
    "footprint_importance": lambda cameras: footprint_importance(GAUSSIANS, cameras),
    "measure_gaussians": lambda cameras: measure_gaussians(GAUSSIANS, cameras, framing=cameras, closeups=cameras),
    "measure_further_removal": lambda cameras: measure_further_removal(GAUSSIANS, cameras, np.stack([BLACK] * 4)),
    "scene_class_offsets": lambda cameras: scene_class_offsets(GAUSSIANS, cameras),
    "picture_gradients": lambda cameras: picture_gradients(GAUSSIANS, cameras, 1, BLACK),
    "render_scene": lambda cameras: render_scene(GAUSSIANS, cameras),
    "references": lambda cameras: References.of(ANCHORS, CalibrationViews(cameras)).cameras.viewmats,
    "sketch_of anchors": sketch_with(ANCHORS, SKETCH),
    "sketch_of anchors, quick": sketch_with(ANCHORS, replace(SKETCH, quick=True)),
    "sketch_of Gaussians": sketch_with(GAUSSIANS, SKETCH),
    "preview_for_scene": lambda cameras: preview_for_scene(GAUSSIANS, CalibrationViews(cameras), PREVIEW).section,
    "calibration_data": calibration_cameras,
}


def arrays_in(value: Any) -> Iterator[np.ndarray]:
    if is_dataclass(value):
        for field in fields(value):
            yield from arrays_in(getattr(value, field.name))
    elif isinstance(value, tuple | list):
        for part in value:
            yield from arrays_in(part)
    elif hasattr(value, "_halves"):
        yield value._halves
    else:
        yield np.frombuffer(value, np.uint8) if isinstance(value, bytes) else np.asarray(value)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_cameras_in_world_coordinates_give_the_result_of_cameras_near_the_scene(name: str) -> None:
    found, expected = (list(arrays_in(FUNCTIONS[name](one))) for one in (WORLD, WORLD.relative_to(ORIGIN)))
    assert len(found) == len(expected)
    for one, other in zip(found, expected, strict=True):
        assert np.array_equal(one, other)
    assert any(np.any(one) for one in found)
