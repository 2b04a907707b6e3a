"""`encode_controlled` and `splatwire.encode` with targets: accuracy, efforts, monotonic quality."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import splatwire
from explicit import ball_of_gaussians
from random_numbers import Numbers
from splatwire.codec import encode_scene
from splatwire.codec.gaussians.quality import Quality, quality_of
from splatwire.errors import InvalidValueError
from splatwire.rate_control import EncodedScene, Target, Tuning, encode_controlled, encoding
from splatwire.rate_control.encoding import _Plan, _Trials
from splatwire.render.importance import cameras_around
from splatwire.types import SplatScene
from splatwire.types.splats import Splats

BUNDLED = Path(splatwire.__file__).parent / "assets" / "snowmiku_gaussians.swz"


def shell(count: int = 1500, degree: int = 0) -> SplatScene:
    """Gaussians near a sphere, many of them small or faint."""
    rng = Numbers(11)
    places = rng.randn(count, 3)
    quats = rng.randn(count, 4)
    return SplatScene(
        Splats(
            places / np.linalg.norm(places, axis=1, keepdims=True),
            quats / np.linalg.norm(quats, axis=1, keepdims=True),
            np.exp(rng.randn(count, 3) * 0.5 - 3.5).astype(np.float32),
            (0.02 + 0.95 * rng.rand(count) ** 2).astype(np.float32),
            0.4 * rng.randn(count, (degree + 1) ** 2, 3),
        ),
        background=(0.2, 0.4, 0.6),
    )


def encode_plainly(some: SplatScene, classes: np.ndarray, quality: object) -> splatwire.SceneStream:
    return encode_scene(some, class_offsets=classes, quality=quality)


def encoded(scene: SplatScene, effort: str = "default", **target: object) -> EncodedScene:
    return encode_controlled(scene, Target(**target), encode_plainly, effort=effort)


@pytest.fixture(scope="module")
def bundled() -> SplatScene:
    """An eighth of the Gaussians of the bundled scene."""
    scene = splatwire.open_scene(BUNDLED)
    return scene.select(np.arange(0, scene.num_elements, 8))


@pytest.mark.slow
def test_fast_chooses_no_views_of_removals(monkeypatch):
    scene, calls = SplatScene(ball_of_gaussians()), []
    of = encoding.RemovalViews.of
    monkeypatch.setattr(encoding.RemovalViews, "of", lambda *given: calls.append(given) or of(*given))
    encoded(scene, "fast", quality=quality_of("small"))
    assert not calls
    encoded(scene, "default", quality=quality_of("small"))
    assert len(calls) == 1


@pytest.mark.slow
@pytest.mark.parametrize("effort", ["fast", "default"])
def test_streams_have_the_requested_size(effort):
    scene = shell()
    whole = encoded(scene, effort, quality=quality_of("default")).stream.num_bytes
    size = 9 * whole // 10
    assert 0.97 * size <= encoded(scene, effort, size=size).stream.num_bytes <= size


@pytest.mark.slow
@pytest.mark.parametrize("degree", [0, 1])
def test_streams_have_the_requested_psnr(degree):
    scene = shell(degree=degree)
    assert abs(encoded(scene, psnr=40.0).psnr - 40.0) <= 0.2


@pytest.mark.extended
@pytest.mark.slow
def test_targets_of_the_bundled_scene_are_reached(bundled):
    assert 24_250 <= encoded(bundled, size=25_000).stream.num_bytes <= 25_000
    assert abs(encoded(bundled, psnr=38.0).psnr - 38.0) <= 0.2


@pytest.mark.slow
def test_pruning_takes_fewer_bytes_at_equal_psnr(bundled):
    fast = encoded(bundled, "fast", quality=quality_of("small"))
    default = encoded(bundled, "default", quality=quality_of("small"))
    assert default.kept < 0.9
    assert fast.kept == 1
    assert default.psnr > fast.psnr
    assert default.stream.num_bytes < 0.9 * fast.stream.num_bytes


@pytest.mark.slow
@pytest.mark.parametrize("effort", ["fast", "default"])
def test_bytes_and_quality_grow_with_the_quality_number(effort):
    scene = shell()
    found = [encoded(scene, effort, quality=quality_of(float(number))) for number in (0, 60, 100)]
    sizes, psnrs = [each.stream.num_bytes for each in found], [each.psnr for each in found]
    assert sizes == sorted(sizes)
    assert psnrs == sorted(psnrs)
    assert psnrs[-1] - psnrs[0] > 25


@pytest.mark.slow
def test_gaussians_that_draw_nothing_do_not_change_the_stream():
    scene = shell()
    faint = Splats(**{name: np.concatenate([v, v[:50]]) for name, v in vars(scene.splats).items()})
    faint.opacities[-50:] = 0
    more = SplatScene(faint, background=scene.background)
    target = {"quality": quality_of("small")}
    assert (
        encoded(more, **target).stream.manifest.symbols_digest
        == encoded(scene, **target).stream.manifest.symbols_digest
    )


@pytest.mark.slow
def test_rotations_of_spheres_take_no_bytes():
    scene = shell()
    scales = scene.splats.scales.copy()
    scales[:1000] = scales[:1000, :1]
    quats = scene.splats.quats.copy()
    quats[:1000] = (1, 0, 0, 0)
    rotated = replace(scene, splats=replace(scene.splats, scales=scales))
    unrotated = replace(rotated, splats=replace(rotated.splats, quats=quats))
    for effort, equal in (("default", True), ("fast", False)):
        one, other = (encoded(each, effort, quality=quality_of("small")).stream for each in (rotated, unrotated))
        assert (one.manifest.symbols_digest == other.manifest.symbols_digest) is equal
        assert (one.num_bytes > other.num_bytes) is not equal


@pytest.mark.slow
def test_errors_of_impossible_targets_state_the_possible_range():
    scene = SplatScene(ball_of_gaussians())
    with pytest.raises(InvalidValueError, match=r"cannot be encoded to 100 bytes: the smallest stream has \d"):
        encoded(scene, size=100)
    with pytest.raises(InvalidValueError, match=r"cannot be encoded to 150 dB: the finest stream has \d\d\.\d dB"):
        encoded(scene, psnr=150.0)
    nothing = SplatScene(scene.splats.select(np.zeros(0, np.int64)))
    with pytest.raises(InvalidValueError, match="nothing to encode"):
        encoded(nothing, size=1000)


class PretendedScene(EncodedScene):
    """An encoded scene with only these attributes."""

    psnr = 0.0
    value = 0.0

    def __init__(self, quality: Quality, kept: float, value: float, psnr: float) -> None:
        for name, content in (("quality", quality), ("kept", kept), ("value", value), ("psnr", psnr)):
            object.__setattr__(self, name, content)


class PretendedPlan(_Plan):
    """Pretended plan: PSNR is `value(level, kept)` in the search views, and higher by `offset` in the other views."""

    values: tuple[Callable[[float, float], float], float]

    def __init__(self, value: Callable[[float, float], float], offset: float, *, prunes: bool) -> None:
        object.__setattr__(self, "curve", "a curve" if prunes else None)
        object.__setattr__(self, "values", (value, offset))
        object.__setattr__(self, "precision", Quality().precision)

    def encoded(self, quality: Quality, encode: object, share: float | None = None) -> PretendedScene:
        kept = 0.5 if share is None else share
        function, offset = self.values
        value = function(quality.level, kept)
        return PretendedScene(quality, kept, value, value + offset)

    def search_psnr(self, encoded: EncodedScene) -> float:
        return vars(encoded)["value"]


def trials_of(plan: PretendedPlan, tuned_level: float | None = None) -> _Trials:
    return _Trials(plan, encode_plainly, lambda task, share: None, tuned_level)


@pytest.mark.parametrize(("offset", "tuned_level"), [(0.6, 8.0), (0.6, None), (-0.6, None)])
def test_search_for_a_psnr_corrects_the_difference_of_the_held_out_views(offset, tuned_level):
    plan = PretendedPlan(lambda level, kept: 5 * level, offset, prunes=False)
    assert abs(trials_of(plan, tuned_level).of_psnr(40.0).psnr - 40.0) <= 0.1


@pytest.mark.parametrize("offset", [0.0, 0.3, -0.3])
def test_search_for_a_psnr_that_levels_jump_over_changes_the_share_of_gaussians(offset):
    plan = PretendedPlan(lambda level, kept: (42.0 if level >= 8 else 38.0) + 30 * (kept - 0.5), offset, prunes=True)
    found = trials_of(plan).of_psnr(40.0)
    assert abs(found.psnr - 40.0) <= 0.1
    assert found.quality.level >= 8
    assert found.kept < 0.5


@pytest.mark.parametrize("effort", ["fast", "default"])
def test_psnr_in_cameras_that_do_not_see_the_scene_is_an_error(effort):
    scene = SplatScene(ball_of_gaussians())
    cameras = cameras_around(scene.splats.means, 9, 64)
    poses = cameras.viewmats.copy()
    poses[:, 2, 3] = -100  # the scene is behind all cameras
    with pytest.raises(InvalidValueError, match="do they see the scene"):
        encode_controlled(
            scene, Target(psnr=40.0), encode_plainly, effort=effort, cameras=replace(cameras, viewmats=poses)
        )


@pytest.mark.slow
def test_size_above_that_of_the_finest_setting_gives_the_finest_stream():
    scene = SplatScene(ball_of_gaussians())
    found = encoded(scene, size=10_000_000)
    assert found.stream.num_bytes < 100_000
    assert found.psnr > 60


@pytest.mark.slow
def test_splatwire_encode_takes_targets():
    scene = shell()
    plain = splatwire.encode(scene)
    assert plain.manifest.num_elements == scene.num_elements
    size = plain.num_bytes // 3
    assert 0.95 * size <= splatwire.encode(scene, size=size).num_bytes <= size
    assert splatwire.encode(scene, size=f"{size}B").num_bytes <= size
    assert splatwire.encode(scene, effort="default").manifest.num_elements < scene.num_elements
    assert splatwire.encode(scene, effort="fast").manifest.num_elements == scene.num_elements
    named = splatwire.encode(scene, quality=40)
    assert splatwire.encode(scene, splatwire.GaussianOptions(quality="small")).packets == named.packets


@pytest.mark.parametrize(
    "arguments",
    [
        {"size": 1000, "psnr": 40.0},
        {"size": 1000, "quality": 50},
        {"size": "many"},
        {"effort": "most"},
        {"tuning": Tuning(), "effort": "default"},
        {"tuning": Tuning(), "quality": 40},
        {"quality": 101},
        {"options": splatwire.GaussianOptions(quality="small"), "quality": 40},
        {"options": splatwire.GaussianOptions(class_offsets=np.zeros(1500, np.int8)), "size": 1000},
        {"options": splatwire.SequenceOptions(), "size": 1000},
    ],
)
def test_contradictory_targets_are_refused(arguments):
    with pytest.raises(InvalidValueError):
        splatwire.encode(shell(), **arguments)


def test_a_stream_fine_tuned_for_losses_needs_only_reach_the_target():
    def stream(psnr: float, num_bytes: int) -> EncodedScene:
        made = object.__new__(EncodedScene)
        vars(made).update(psnr=psnr, stream=SimpleNamespace(num_bytes=num_bytes))
        return made

    tuned, untuned = stream(40.1, 900), stream(40.0, 800)
    assert _Plan.better_of(tuned, untuned, Target(psnr=40.0), for_loss=True) is tuned
    assert _Plan.better_of(tuned, untuned, Target(psnr=40.0), for_loss=False) is untuned
    assert _Plan.better_of(stream(38, 900), untuned, Target(psnr=40.0), for_loss=True) is untuned
    assert _Plan.better_of(stream(40.4, 500), untuned, Target(psnr=40.0), for_loss=False) is not untuned
    assert _Plan.better_of(stream(40.4, 900), untuned, Target(psnr=40.0), for_loss=True) is untuned
    tuned, untuned = stream(38.0, 1000), stream(40.0, 1000)
    assert _Plan.better_of(tuned, untuned, Target(size=1000), for_loss=True) is tuned
    assert _Plan.better_of(tuned, untuned, Target(size=1000), for_loss=False) is untuned
    assert _Plan.better_of(None, untuned, Target(size=1000), for_loss=True) is untuned


@pytest.mark.slow
def test_best_writes_the_stream_of_default_if_fine_tuning_gains_nothing(monkeypatch, caplog):
    def darkened(scene: SplatScene, *others: object) -> SplatScene:
        return replace(scene, splats=replace(scene.splats, sh=scene.splats.sh - 1))

    monkeypatch.setattr(encoding, "tuned_to_pictures", darkened)
    scene, target = shell(), Target(psnr=40.0)
    best = encode_controlled(scene, target, encode_plainly, effort="best", tuning=Tuning(1, 12))
    assert "gains nothing" in caplog.text
    assert best.stream.packets == encode_controlled(scene, target, encode_plainly).stream.packets


@pytest.mark.slow
@pytest.mark.parametrize("effort", ["fast", "default"])
def test_lengths_of_quaternions_do_not_change_the_stream(effort):
    """Trainers store quaternions that are not normalised; precision and pruning are measured in pictures."""
    splats = ball_of_gaussians()
    longer = replace(splats, quats=splats.quats * np.float32(3))
    streams = [splatwire.encode(scene, effort=effort) for scene in (splats, longer, SplatScene(longer))]
    assert len({stream.manifest.symbols_digest for stream in streams}) == 1
    clips = [splatwire.encode([scene] * 3, splatwire.SequenceOptions()) for scene in (splats, longer)]
    assert clips[0].manifest.symbols_digest == clips[1].manifest.symbols_digest
