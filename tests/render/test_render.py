from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from explicit import ball_of_gaussians
from scenes import tiny_cameras, tiny_scene
from splatwire.anchors.compiled_heads import drawn_gaussians
from splatwire.errors import InvalidValueError, UnknownNameError
from splatwire.render import create_renderer, iterate_views, render, render_scene
from splatwire.types import RenderHints, SplatScene


@pytest.mark.needs_torch
def test_cpu_and_reference_render_the_same_scene() -> None:
    scene, cameras = tiny_scene(num_anchors=60), tiny_cameras(2, 48, 32)
    background = np.array([0.1, 0.2, 0.3], np.float32)
    ours = render_scene(scene, cameras, background=background)
    plain = render_scene(scene, cameras, renderer="reference", background=background)
    assert ours.shape == (2, 32, 48, 3)
    assert np.abs(ours - plain).max() < 1e-4
    assert np.abs(ours - background).max() > 0.1


def test_views_are_yielded_singly_with_progress_and_without_gradients() -> None:
    scene, cameras, done = tiny_scene(num_anchors=60), tiny_cameras(3, 48, 32), []
    images = render_scene(scene, cameras, progress=lambda i, n: done.append((i, n)))
    assert done == [(1, 3), (2, 3), (3, 3)]
    for view, image in enumerate(iterate_views(scene, cameras)):
        assert np.array_equal(image, images[view])
        gaussians = drawn_gaussians(scene, cameras, view)
        alone = create_renderer("cpu")(gaussians, cameras.select([view]), background=np.zeros(3, np.float32))
        assert np.array_equal(alone[0].clip(0, 1), image)


def test_render_hints_change_the_picture() -> None:
    scene, cameras = tiny_scene(num_anchors=60), tiny_cameras(1, 48, 32)
    plain = render_scene(scene, cameras)
    nothing = RenderHints(np.ones(60, np.float32), np.zeros(60, np.bool_))
    everything = RenderHints(np.ones(60, np.float32), np.ones(60, np.bool_))
    larger = RenderHints(np.full((60,), 1.5, np.float32), np.zeros(60, np.bool_))

    def draw(hints: RenderHints) -> np.ndarray:
        fields = (scene.anchors, scene.heads, scene.coding)
        return render_scene(type(scene)(*fields, hints), cameras)

    assert np.array_equal(draw(nothing), plain)
    assert np.abs(draw(everything)).max() == 0
    assert np.abs(draw(larger) - plain).max() > 0.01


def test_an_unknown_renderer_is_refused_before_anything_is_drawn() -> None:
    with pytest.raises(UnknownNameError):
        iterate_views(tiny_scene(num_anchors=5), tiny_cameras(1), renderer="opengl")


@pytest.mark.parametrize(
    ("result", "message"),
    [
        (None, "expected an array"),
        (np.zeros((1, 3, 3, 3), np.float32), r"not float32 \(1, 3, 3, 3\)"),
        (np.zeros((1, 32, 48, 3), np.uint8), "expected RGB from 0 to 1, not uint8"),
    ],
)
def test_results_of_renderers_that_are_no_pictures_are_refused(result: Any, message: str) -> None:
    views = iterate_views(ball_of_gaussians(), tiny_cameras(1, 48, 32), renderer=lambda *given, **named: result)
    with pytest.raises(InvalidValueError, match=f"the result of the renderer: .*{message}"):
        next(views)


def test_a_renderer_may_return_an_array_that_cannot_be_changed() -> None:
    grey = np.broadcast_to(np.float64(0.5), (1, 32, 48, 3))
    (image,) = iterate_views(ball_of_gaussians(), tiny_cameras(1, 48, 32), renderer=lambda *given, **named: grey)
    assert np.array_equal(image, np.full((32, 48, 3), 0.5, np.float32))


def test_gaussians_that_cannot_be_drawn_are_left_out_with_a_warning(caplog: pytest.LogCaptureFixture) -> None:
    """They are the same Gaussians as in `encode`; one colour that is not finite would blank all pixels it touches."""
    splats, cameras = ball_of_gaussians(), tiny_cameras(1, 48, 32)
    for name, value in (("sh", np.nan), ("opacities", 3.0), ("quats", 0.0), ("scales", -1.0), ("means", np.inf)):
        values = getattr(splats, name).copy()
        values[:50] = value
        image = render_scene(replace(splats, **{name: values}), cameras)
        assert np.array_equal(image, render_scene(splats.select(np.arange(50, 200)), cameras)), name
    assert [record.message for record in caplog.records] == [
        "rendering: 50 of 200 Gaussians cannot be drawn and are left out (the first is row 0)"
    ] * 5


@pytest.mark.parametrize("factor", [0.1, 3.0, -1e-10, 1e20])
def test_rotations_of_any_length_give_the_same_picture(factor: float) -> None:
    """Trainers store quaternions that are not normalised."""
    splats, cameras = ball_of_gaussians(), tiny_cameras(1, 48, 32)
    longer = replace(splats, quats=splats.quats * np.float32(factor))
    expected = render_scene(splats, cameras)
    for scene in (longer, SplatScene(longer)):
        assert np.abs(render_scene(scene, cameras) - expected).max() < 1e-5


def test_quaternions_of_length_one_are_not_copied() -> None:
    splats = ball_of_gaussians()
    assert splats.with_unit_quats() is splats
    halves = splats.quats.astype(np.float16)
    assert np.array_equal(replace(splats, quats=halves).with_unit_quats().quats, halves)


def test_all_views_of_a_scene_are_checked_once(monkeypatch: pytest.MonkeyPatch) -> None:
    checked, check = [], render.without_invalid
    monkeypatch.setattr(render, "without_invalid", lambda scene: checked.append(scene) or check(scene))
    render_scene(ball_of_gaussians(), tiny_cameras(3, 8, 8))
    assert len(checked) == 1
