import numpy as np
import pytest

from scenes import tiny_cameras, tiny_scene
from splatwire.bitstream import PRESETS
from splatwire.codec import decode_stream, encode_scene, with_section
from splatwire.codec.preview import Preview, PreviewQuantisation, preview_gaussians, write_preview
from splatwire.concealment import conceal
from splatwire.errors import InvalidValueError
from splatwire.planning.distortion import BLANK_PSNR
from splatwire.planning.measure import (
    ASSUMED_BASE_MSE,
    LossyPictures,
    measure_distortion,
    packet_members,
    received_elements,
    variant_of_stream,
)
from splatwire.render import iterate_views
from splatwire.render.cpu import render_cpu
from splatwire.render.importance import footprint_importance
from splatwire.types import ReceivedScene


@pytest.fixture(scope="module")
def complete() -> ReceivedScene:
    return decode_stream(encode_scene(tiny_scene()))


@pytest.mark.slow
def test_distortion_grows_with_loss_rate_and_importance(complete: ReceivedScene) -> None:
    cameras = tiny_cameras()
    tiers = footprint_importance(complete.scene, cameras).tiers((0.3,))
    damage = measure_distortion(LossyPictures(complete, cameras, "drop"), tiers, seed=1)
    assert damage.mse.shape == (2, 6)
    assert damage.base_mse == pytest.approx(ASSUMED_BASE_MSE)
    assert (damage.mse[:, 0] == 0).all()
    assert (np.diff(damage.mse, axis=1) >= 0).all()
    assert damage.mse[0, -1] > damage.mse[1, -1] > 0


def test_simulated_loss_clears_lost_anchors_and_keeps_the_others(complete: ReceivedScene) -> None:
    num = complete.scene.anchors.num_anchors
    known = np.arange(num) % 3 > 0
    received = complete.masked(known)
    assert np.array_equal(received.loss_mask.fully_received, known)
    before, after = complete.scene.anchors, received.scene.anchors
    for name in ("features", "scalings", "offsets", "mask"):
        assert np.array_equal(getattr(after, name)[known], getattr(before, name)[known])
        assert not bool(getattr(after, name)[~known].any())
    assert np.array_equal(after.positions, before.positions)


def test_distortion_measurement_requires_a_complete_stream(complete: ReceivedScene) -> None:
    num = complete.scene.anchors.num_anchors
    received = complete.masked(np.arange(num) > 0)
    with pytest.raises(InvalidValueError, match="1 anchors are lost"):
        LossyPictures(received, tiny_cameras(), "drop")


@pytest.mark.parametrize("concealer", ["drop", "grow", "scene_free"])
def test_incremental_pictures_equal_concealing_from_scratch(complete: ReceivedScene, concealer: str) -> None:
    cameras, num = tiny_cameras(), complete.scene.anchors.num_anchors
    photos = [image + 0.1 for image in iterate_views(complete.scene, cameras)]
    pictures = LossyPictures(complete, cameras, concealer, photos=photos)
    for step in (2, 3, 5):  # each starts from an empty state, independent of earlier calls
        known = np.arange(num) % step > 0
        images = iterate_views(conceal(complete.masked(known), concealer), cameras)
        errors = [
            float(((image - photo).astype(np.float64) ** 2).mean()) for image, photo in zip(images, photos, strict=True)
        ]
        assert pictures.errors(known) == pytest.approx(errors, rel=1e-4)
    assert pictures.psnr(np.ones(num, np.bool_)) == pytest.approx(20.0, abs=1e-3)
    with pytest.raises(InvalidValueError, match="1 photos of"):
        LossyPictures(complete, cameras, concealer, photos=photos[:1])


def test_stream_variant_with_a_preview_has_its_quality_as_worst_case() -> None:
    scene, cameras = tiny_scene(), tiny_cameras()
    frame = PreviewQuantisation.fitting((0.0,) * 3, 1.0, (-0.5, -0.5, -0.5, -2.0), (0.5, 0.5, 0.5, -1.0))
    section = write_preview(Preview(frame, (0, 51, 102), np.random.default_rng(0).integers(0, 16, (20, 10))))
    stream = with_section(encode_scene(scene, PRESETS["datagram"]), "preview", section)
    shown, background = preview_gaussians(section)
    photos = render_cpu(shown, cameras, background=np.array(background)).clip(0, 1)
    pictures = LossyPictures(decode_stream(stream), cameras, "drop", photos=[photo + 0.1 for photo in photos])
    offer = variant_of_stream(stream, pictures, concealment_bytes=7)
    assert offer.blank_psnr == pytest.approx(20.0, abs=0.01)
    assert offer.preview_bytes == len(section)
    assert offer.concealment_bytes == 7 + len(section)
    assert offer.budget_after_preview(1000) == 1000 - len(section)


@pytest.mark.slow
def test_stream_variant_has_size_and_distortion_of_its_stream() -> None:
    scene, cameras = tiny_scene(), tiny_cameras()
    stream = encode_scene(scene, PRESETS["datagram"], tiers=footprint_importance(scene, cameras).tiers((0.3,)))
    decoded = decode_stream(stream)
    offer = variant_of_stream(stream, LossyPictures(decoded, cameras, "drop"), concealment_bytes=7)
    assert offer.load.num_tiers == len(offer.distortion.mse) == 2
    assert offer.concealment_bytes == 7
    assert (offer.preview_bytes, offer.blank_psnr) == (0, BLANK_PSNR)
    members = packet_members(stream)
    assert [len(anchors) for anchors in members] == offer.load.elements.tolist()
    everything = np.ones(len(members), dtype=np.bool_)
    assert bool(received_elements(members, everything, decoded.scene.anchors.num_anchors).all())
    assert offer.picture is not None
    less = everything.copy()
    less[0] = False
    assert offer.picture(everything) == pytest.approx(30.0, abs=1e-6)
    assert offer.picture(less) < 30.0
