"""Fine-tuning makes pictures of views that it did not use better, and depends only on its arguments."""

from dataclasses import replace

import numpy as np
import pytest

from shells import shell
from splatwire.channel import parse_loss, transmit
from splatwire.codec import decode_stream, encode_scene
from splatwire.codec.gaussians.quality import Quality
from splatwire.codec.gaussians.rounding import coding_for
from splatwire.concealment import conceal
from splatwire.errors import InvalidValueError
from splatwire.evaluation.views import held_out_cameras
from splatwire.finetuning import FineTuning, Pictures, fine_tune, fitting_cameras, own_pictures
from splatwire.finetuning.sampled_loss import CHECK_VIEWS
from splatwire.finetuning.tune import MAX_CHECK_INTERVAL, MIN_ERROR, tuned_gaussians
from splatwire.render import render_scene
from splatwire.render.importance import surrounding_cameras
from splatwire.render.pruning import prune
from splatwire.types import SplatScene
from splatwire.types.splats import Splats


def _psnr(ours: SplatScene, source: SplatScene) -> float:
    cameras = held_out_cameras(source).scaled(0.2)
    difference = render_scene(ours, cameras) - render_scene(source, cameras)
    return float(-10 * np.log10(np.square(difference).mean(axis=(1, 2, 3))).mean())


def _darker(source: SplatScene) -> SplatScene:
    """A scene that every fine-tuning to pictures of `source` improves, so that no check undoes all of it."""
    return replace(source, splats=replace(source.splats, sh=source.splats.sh - np.float32(0.3)))


@pytest.mark.slow
@pytest.mark.parametrize("degree", [0, 1])
@pytest.mark.parametrize("antialiased", [False, True])
def test_fine_tuned_scene_is_closer_to_the_source_in_views_not_used(degree: int, antialiased: bool) -> None:
    source = replace(shell(600, degree), antialiased=antialiased)
    left, quality = prune(source, 0.5).scene, Quality(level=6.5)
    assert isinstance(left, SplatScene)
    pictures = own_pictures(source, fitting_cameras(source, 24, 80))
    tuned = fine_tune(left, pictures, FineTuning(quality, iterations=200, rate=0.8))
    before = decode_stream(encode_scene(left, quality=quality)).scene
    after = decode_stream(encode_scene(tuned)).scene
    assert _psnr(after, source) > _psnr(before, source) + 2


@pytest.mark.slow
def test_fine_tuning_with_packet_loss_helps_a_receiver_with_losses() -> None:
    source = shell(2000)
    pictures = own_pictures(source, fitting_cameras(source, 24, 80))
    found = []
    for loss in (None, parse_loss("bernoulli:0.3")):
        tuned = fine_tune(source, pictures, FineTuning(Quality(level=7.0), iterations=240, rate=1.0, packet_loss=loss))
        stream = encode_scene(tuned)
        received = [decode_stream(transmit(stream, "bernoulli:0.3", seed=seed)[0]) for seed in range(3)]
        found.append(np.mean([_psnr(conceal(received_scene, "grow"), source) for received_scene in received]))
    assert found[1] > found[0] + 0.3


@pytest.mark.slow
def test_equal_arguments_give_equal_scenes_and_another_seed_another() -> None:
    scene = shell(200)
    pictures = own_pictures(scene, fitting_cameras(scene, 4, 32))
    options = FineTuning(iterations=12, packet_loss=parse_loss("bernoulli:0.2"), seed=3)
    start = _darker(scene)
    first, again = fine_tune(start, pictures, options), fine_tune(start, pictures, options)
    other = fine_tune(start, pictures, replace(options, seed=4))
    for name, values in vars(first.splats).items():
        assert (values == getattr(again.splats, name)).all()
    assert (first.splats.means != other.splats.means).any()


def _loss(ours: SplatScene, start: SplatScene, pictures: Pictures) -> float:
    """Mean squared error relative to the start, mean over all fitted views."""
    first, now = (
        np.square(render_scene(each, pictures.cameras) - pictures.images / 255).mean(axis=(1, 2, 3))
        for each in (start, ours)
    )
    return float((now / np.maximum(first, MIN_ERROR)).mean())


@pytest.mark.slow
def test_steps_that_are_too_large_are_undone() -> None:
    source = shell(300)
    left = prune(source, 0.7).scene
    assert isinstance(left, SplatScene)
    pictures = own_pictures(source, fitting_cameras(source, CHECK_VIEWS, 32))
    start = fine_tune(left, pictures, FineTuning(iterations=1, rate=1e-9))
    tuned = fine_tune(left, pictures, FineTuning(iterations=2 * MAX_CHECK_INTERVAL, rate=50.0))
    assert _loss(tuned, start, pictures) <= 1.001


def test_gaussians_have_finer_classes_if_fitted_views_see_them() -> None:
    scene = shell(400)
    around = fitting_cameras(scene, 24, 48)
    right, left = (
        tuned_gaussians(scene, own_pictures(scene, around.select(np.flatnonzero(side).tolist())), options).coding
        for options in [FineTuning(iterations=1)]
        for side in (around.centers[:, 0] > 0, around.centers[:, 0] < 0)
    )
    gain, seen = right.precision_classes.astype(np.int64) - left.precision_classes, scene.splats.means[:, 0] > 0
    assert gain[seen].mean() > gain[~seen].mean() + 0.5


def test_given_precision_classes_stay() -> None:
    scene, options = shell(100), FineTuning(iterations=3)
    classes = (-np.arange(100) % 6).astype(np.int8)
    found = tuned_gaussians(scene, own_pictures(scene, fitting_cameras(scene, 2, 16)), options, class_offsets=classes)
    assert (
        found.coding.precision_classes == coding_for(scene.splats, options.quality, classes).precision_classes
    ).all()


def test_steps_are_proportional_to_quantisation_steps() -> None:
    source = shell(100)
    start = _darker(source)
    classes, pictures = (-np.arange(100) % 6).astype(np.int8), own_pictures(source, fitting_cameras(source, 2, 48))
    found = tuned_gaussians(start, pictures, FineTuning(iterations=1, rate=0.1), class_offsets=classes)
    moved = np.abs(found.scene.splats.sh - start.splats.sh)[:, 0, 0]
    changed = moved > 0  # the others are hidden
    assert changed.sum() > 50
    assert np.ptp(np.log2(moved[changed]) + found.coding.precision_classes[changed]) < 0.01


def test_memory_layout_of_the_scene_has_no_influence() -> None:
    scene = shell(60, 1)
    start, pictures = _darker(scene), own_pictures(scene, fitting_cameras(scene, 2, 16))
    columns = Splats(**{name: np.asfortranarray(values) for name, values in vars(start.splats).items()})
    first, second = (
        tuned_gaussians(replace(scene, splats=splats), pictures, FineTuning(iterations=4)).scene
        for splats in (start.splats, columns)
    )
    assert (first.splats.sh != start.splats.sh).any()
    for name, values in vars(first.splats).items():
        assert (values == getattr(second.splats, name)).all()


def test_source_scene_stays_unchanged() -> None:
    scene = shell(60)
    before = {name: values.copy() for name, values in vars(scene.splats).items()}
    fine_tune(scene, own_pictures(scene, fitting_cameras(scene, 2, 16)), FineTuning(iterations=3))
    assert all((values == before[name]).all() for name, values in vars(scene.splats).items())


def test_pixels_outside_of_masks_have_no_influence() -> None:
    scene = shell(60)
    start, pictures = _darker(scene), own_pictures(scene, fitting_cameras(scene, 2, 16))
    masks = np.zeros(pictures.images.shape[:3], np.bool_)
    masks[:, 4:] = True
    other = np.where(masks[..., None], pictures.images, np.uint8(200))
    first, second, unmasked = (
        tuned_gaussians(start, Pictures(pictures.cameras, images, chosen), FineTuning(iterations=4)).scene.splats.means
        for images, chosen in ((pictures.images, masks), (other, masks), (other, None))
    )
    assert (first == second).all()
    assert (first != unmasked).any()


def test_progress_reaches_all_iterations() -> None:
    scene, seen = shell(50), []
    fine_tune(scene, own_pictures(scene, fitting_cameras(scene, 2, 16)), FineTuning(iterations=5), seen.append)
    assert [(report.iteration, report.iterations) for report in seen] == [(k + 1, 5) for k in range(5)]


@pytest.mark.parametrize("num_views", [16, 17, 18, 19, 90, 95, 240])
@pytest.mark.parametrize("enclosing", [False, True])
def test_fitting_cameras_differ_from_held_out_cameras(
    num_views: int, enclosing: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    if enclosing:  # as `framing_cameras` does for rooms
        monkeypatch.setattr("splatwire.finetuning.pictures.framing_cameras", surrounding_cameras)
    scene = shell(100)
    fitted, held_out = fitting_cameras(scene, num_views, 32), held_out_cameras(scene)
    assert fitted.num_views == num_views
    assert np.linalg.norm(fitted.centers[:, None] - held_out.centers[None], axis=2).min() > 1e-3


def test_pictures_of_another_size_are_refused() -> None:
    cameras = fitting_cameras(shell(20), 4, 16)
    with pytest.raises(InvalidValueError, match="4 cameras of 16 x 16 pixels, but pictures of shape"):
        Pictures(cameras, np.zeros((3, 16, 16, 3), np.uint8))


def test_cameras_with_another_origin_are_refused() -> None:
    scene = shell(20)
    pictures = own_pictures(scene, fitting_cameras(scene, 2, 16))
    with pytest.raises(InvalidValueError, match="another origin"):
        fine_tune(replace(scene, origin=(1.0, 0.0, 0.0)), pictures)


def test_scene_without_gaussians_is_refused() -> None:
    scene = shell(20)
    pictures = own_pictures(scene, fitting_cameras(scene, 2, 16))
    with pytest.raises(InvalidValueError, match="no Gaussians"):
        fine_tune(scene.select(np.zeros(0, np.int64)), pictures)


@pytest.mark.parametrize(
    "options", [{"iterations": 0}, {"rounding_interval": 0}, {"seed": -1}, {"rate": 0.0}, {"rate": 100.0}]
)
def test_options_out_of_range_are_refused(options: dict[str, float]) -> None:
    with pytest.raises(InvalidValueError, match="fine-tuning"):
        FineTuning(**options)
