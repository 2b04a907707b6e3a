import pytest
import torch

from scenes import tiny_cameras, tiny_scene
from splatwire.errors import UnknownNameError
from splatwire.model import RenderHints
from splatwire.model.compiled_heads import drawn_gaussians
from splatwire.render import create_renderer, iterate_views, render_scene


def test_cpu_and_reference_draw_the_same_scene() -> None:
    scene, cameras = tiny_scene(num_anchors=60), tiny_cameras(2, 48, 32)
    background = torch.tensor([0.1, 0.2, 0.3])
    ours = render_scene(scene, cameras, background=background)
    plain = render_scene(scene, cameras, renderer="reference", background=background)
    assert ours.shape == (2, 32, 48, 3)
    assert (ours - plain).abs().max() < 1e-4
    assert (ours - background).abs().max() > 0.1


def test_views_come_one_by_one_with_progress_and_without_gradients() -> None:
    scene, cameras, done = tiny_scene(num_anchors=60), tiny_cameras(3, 48, 32), []
    images = render_scene(scene, cameras, progress=lambda i, n: done.append((i, n)))
    assert done == [(1, 3), (2, 3), (3, 3)]
    for view, image in enumerate(iterate_views(scene, cameras)):
        assert torch.equal(image, images[view])
        assert torch.is_grad_enabled()
        gaussians = drawn_gaussians(scene, cameras, view)
        alone = create_renderer("cpu")(gaussians, cameras.select([view]), background=torch.zeros(3))
        assert torch.equal(alone[0].clamp(0, 1), image)


def test_hints_reach_the_picture() -> None:
    scene, cameras = tiny_scene(num_anchors=60), tiny_cameras(1, 48, 32)
    plain = render_scene(scene, cameras)
    nothing = RenderHints(torch.ones(60), torch.zeros(60, dtype=torch.bool))
    everything = RenderHints(torch.ones(60), torch.ones(60, dtype=torch.bool))
    larger = RenderHints(torch.full((60,), 1.5), torch.zeros(60, dtype=torch.bool))

    def draw(hints: RenderHints) -> torch.Tensor:
        fields = (scene.anchors, scene.heads, scene.coding)
        return render_scene(type(scene)(*fields, hints), cameras)

    assert torch.equal(draw(nothing), plain)
    assert draw(everything).abs().max() == 0
    assert (draw(larger) - plain).abs().max() > 0.01


def test_an_unknown_renderer_is_refused_before_anything_is_drawn() -> None:
    with pytest.raises(UnknownNameError):
        iterate_views(tiny_scene(num_anchors=5), tiny_cameras(1), renderer="opengl")
