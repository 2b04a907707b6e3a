"""The effort `best`: accuracy, dependence on the seed only, gain over `default`, views that are not fitted."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import splatwire
from shells import shell
from splatwire.bitstream import PRESETS, Packetization
from splatwire.channel import parse_loss
from splatwire.codec import encode_scene
from splatwire.codec.gaussians.packets import PacketDivision, divide_into_packets
from splatwire.codec.gaussians.quality import quality_of
from splatwire.errors import InvalidValueError
from splatwire.evaluation.views import HELD_OUT_SIZE
from splatwire.finetuning import fitting_cameras
from splatwire.rate_control import EncodedScene, Target, Tuning, encode_controlled
from splatwire.rate_control.tuning import MAX_GAUSSIANS, fitted_cameras
from splatwire.rate_control.views import MIN_CAMERAS, ViewSets
from splatwire.render import iterate_views
from splatwire.render.importance import surrounding_cameras
from splatwire.types import Cameras, SplatScene

BUNDLED = Path(splatwire.__file__).parent / "assets" / "snowmiku_gaussians.swz"
FEW = Tuning(iterations=8, num_views=4, size=32)
ENOUGH = Tuning(iterations=150, num_views=24, size=96)
"""Options with which fine-tuning a shell of 1,000 Gaussians is better than not fine-tuning."""
GAIN = 0.95
"""Ratio of the bytes of a shell with and without fine-tuning at equal PSNR, which fine-tuning must stay below."""


def encoded(
    scene: SplatScene,
    effort: str = "best",
    tuning: Tuning = FEW,
    packetization: Packetization | None = None,
    **target: object,
) -> EncodedScene:
    def encode(some: SplatScene, classes: np.ndarray, quality: object) -> splatwire.SceneStream:
        return encode_scene(some, packetization, class_offsets=classes, quality=quality)

    return encode_controlled(scene, Target(**target), encode, effort=effort, tuning=tuning)


@pytest.mark.slow
def test_streams_have_the_size_that_was_requested():
    scene = shell(1000)
    size = 2 * encoded(scene, "fast", quality=quality_of("small")).stream.num_bytes // 3
    found = encoded(scene, tuning=ENOUGH, size=size)
    assert 0.97 * size <= found.stream.num_bytes <= size
    assert found.kept < 1
    assert found.fine_tuned


@pytest.mark.slow
def test_streams_have_the_psnr_that_was_requested():
    scene = shell(1000, degree=1)
    found = encoded(scene, tuning=ENOUGH, psnr=36.0)
    assert abs(found.psnr - 36.0) <= 0.2
    assert found.fine_tuned
    assert found.stream.num_bytes < GAIN * encoded(scene, "default", psnr=36.0).stream.num_bytes


@pytest.mark.extended
@pytest.mark.slow
def test_best_is_closer_to_the_source_than_default_at_equal_bytes():
    scene = splatwire.open_scene(BUNDLED)
    scene = scene.select(np.arange(0, scene.num_elements, 8))
    default, best = (
        encoded(scene, effort, Tuning(iterations=300, num_views=60, size=160), size=25_000)
        for effort in ("default", "best")
    )
    assert best.stream.num_bytes <= 25_000
    assert best.fine_tuned
    assert best.psnr > default.psnr


@pytest.mark.extended
@pytest.mark.slow
def test_equal_seeds_give_equal_streams_and_another_seed_or_loss_another():
    scene, target = shell(200), {"quality": quality_of("small")}
    many, none = (replace(FEW, packet_loss=parse_loss(f"bernoulli:{rate}")) for rate in ("0.5", "0.000001"))
    options = FEW, FEW, replace(FEW, seed=1), many, none  # drawing a loss changes the order of views, even without one
    first, again, other, lossy, lossless = (
        encoded(scene, tuning=tuning, packetization=PRESETS["datagram"], **target).stream.packets for tuning in options
    )
    assert first == again
    assert first != other
    assert lossy != lossless


@pytest.mark.slow
def test_gaussians_are_not_fine_tuned_again_if_the_aim_is_out_of_reach(monkeypatch):
    tuned = []

    def tuned_to_pictures(pruned: SplatScene, *rest: object) -> SplatScene:
        tuned.append(pruned.num_elements)
        return pruned

    monkeypatch.setattr("splatwire.rate_control.encoding.tuned_to_pictures", tuned_to_pictures)
    encoded(shell(200), size=10_000_000)  # above the finest stream
    assert len(tuned) == 1


@pytest.mark.slow
def test_fine_tuning_keeps_precision_classes():
    calls = []

    def encode(some: SplatScene, classes: np.ndarray, quality: object) -> splatwire.SceneStream:
        calls.append((some, classes))
        return encode_scene(some, class_offsets=classes, quality=quality)

    found = encode_controlled(
        shell(200), Target(quality=quality_of("small")), encode, effort="best", tuning=replace(FEW, iterations=30)
    )
    assert found.fine_tuned
    *_, (pruned, classes), _, (tuned, kept) = calls  # after the calls that measure precision
    assert (pruned.splats.means != tuned.splats.means).any()
    assert (classes == kept).all()


@pytest.mark.slow
def test_losses_apply_to_the_packets_of_the_stream(monkeypatch):
    seen = []

    def divided(scene: SplatScene, packetization: Packetization) -> PacketDivision:
        seen.append(packetization)
        return divide_into_packets(scene, packetization)

    monkeypatch.setattr("splatwire.finetuning.tune.divide_into_packets", divided)
    options, packets = (
        replace(FEW, packet_loss=parse_loss("bernoulli:0.5")),
        replace(PRESETS["datagram"], block_size=50),
    )
    found = encoded(shell(200), tuning=options, packetization=packets, quality=quality_of("small"))
    assert set(seen) == {found.stream.manifest.packetization}
    assert found.stream.manifest.packetization.block_size == 50


@pytest.mark.slow
def test_held_out_views_are_those_of_other_efforts():
    scene = shell(200)
    best, fast = (encoded(scene, effort, quality=quality_of("small")) for effort in ("best", "fast"))
    assert (best.held_out.cameras.viewmats == fast.held_out.cameras.viewmats).all()
    assert best.held_out.scene is fast.held_out.scene is scene


def test_given_cameras_are_fitted_unless_they_are_held_out():
    scene = shell(100)
    cameras = surrounding_cameras(scene, 30, 64)
    held_out = ViewSets.of(scene, cameras).held_out.viewmats
    fitted = fitted_cameras(scene, cameras, Tuning(num_views=50, size=32))
    assert (fitted.num_views, fitted.width) == (50, 32)
    assert (fitted.viewmats[:20] == cameras.viewmats[[view for view in range(30) if view % 3 != 2]]).all()
    away = np.abs(fitted.viewmats[:, None] - held_out[None]).max(axis=(2, 3))
    assert away.min() > 1e-3
    assert (fitted.viewmats[20:, :3, :3] == fitted.viewmats[:30, :3, :3]).all()


@pytest.mark.slow
def test_pictures_of_the_source_are_drawn_once(monkeypatch):
    drawn: list[SplatScene] = []

    def iterate(scene: SplatScene, cameras: Cameras) -> Iterator[np.ndarray]:
        if cameras.width == HELD_OUT_SIZE:
            drawn.append(scene)
        return iterate_views(scene, cameras)

    monkeypatch.setattr("splatwire.rate_control.views.iterate_views", iterate)
    scene = shell(300)
    found = encoded(scene, psnr=36.0)
    assert found.psnr > 30
    assert sum(each is scene for each in drawn) == 1
    assert len(drawn) > 2


def test_views_around_the_scene_are_fitted_without_enough_cameras():
    scene = shell(100)
    expected = fitting_cameras(scene, 8, 32).viewmats
    for cameras in (None, surrounding_cameras(scene, MIN_CAMERAS - 1, 64)):
        assert (fitted_cameras(scene, cameras, Tuning(num_views=8, size=32)).viewmats == expected).all()


def test_scenes_that_are_too_large_are_refused_before_any_work():
    scene = shell(10)
    large = scene.select(np.arange(MAX_GAUSSIANS + 1) % 10)
    with pytest.raises(InvalidValueError, match=r"at most 1,000,000 Gaussians, and this scene has 1,000,001"):
        encoded(large, size=1)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"iterations": 0}, "iterations is 1 to 100,000, not 0"),
        ({"iterations": 100_001}, "iterations is 1 to 100,000, not 100,001"),
        ({"num_views": 1}, "num_views is 2 to 10,000, not 1"),
        ({"num_views": 10_001}, "num_views is 2 to 10,000, not 10,001"),
        ({"size": 15}, "size is 16 to 4,096, not 15"),
        ({"size": 4097}, "size is 16 to 4,096, not 4,097"),
        ({"seed": -1}, "seed is 0 to"),
        ({"seed": 1 << 63}, "seed is 0 to"),
        ({"num_views": 1025, "size": 1024}, "1,025 views of 1,024 x 1,024 pixels are more than 1,073,741,824 pixels"),
    ],
)
def test_options_out_of_range_are_refused(options, message):
    with pytest.raises(InvalidValueError, match=f"fine-tuning: {message}"):
        Tuning(**options)


@pytest.mark.slow
def test_progress_of_splatwire_encode_grows_to_the_end():
    shares: list[float] = []
    splatwire.encode(shell(100), effort="best", tuning=FEW, size=2500, progress=shares.append)
    assert shares == sorted(shares)
    assert shares[-1] == 1
    assert len(set(shares)) > 8
