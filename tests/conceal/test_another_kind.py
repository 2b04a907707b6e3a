"""A kind of scene that the package does not know, points with a colour: concealed and drawn without changing a file."""

from dataclasses import dataclass, replace
from typing import ClassVar

import pytest
import torch
from torch import Tensor

from scenes import tiny_cameras
from splatwire.conceal import conceal, concealer_names
from splatwire.errors import InvalidValueError
from splatwire.model import Coverage, Partial, RenderHints
from splatwire.model.appearance import gaussians_of_view
from splatwire.render import render_scene
from splatwire.scene import Cameras, Erasures, Gaussians
from splatwire.scene.background import BLACK, Background
from splatwire.scene.rows import Rows


@dataclass(frozen=True, eq=False)
class Points:
    positions: Tensor
    colors: Tensor

    @property
    def log_sizes(self) -> Tensor:
        return torch.full_like(self.positions[:, 0], 0.05).log()

    def select(self, index: Tensor) -> "Points":
        return Points(self.positions[index], self.colors[index])

    def arrived(self, known: Tensor, places: Tensor) -> "Points":
        return Points(torch.where(known[:, None], self.positions, places), self.colors * known[:, None])

    def kept(self, erasures: Erasures, proposed: "Points") -> "Points":
        return replace(self, colors=torch.where(erasures.known[:, None], self.colors, proposed.colors))


@dataclass(frozen=True, eq=False)
class PointScene:
    ELEMENTS: ClassVar[str] = "points"
    COVERAGE: ClassVar[Coverage] = Coverage(size=1.0, opacity=0.0)
    points: Points
    hints: RenderHints | None = None
    background: Background = BLACK

    @property
    def elements(self) -> Points:
        return self.points

    @property
    def positions(self) -> Tensor:
        return self.points.positions

    @property
    def num_elements(self) -> int:
        return len(self.positions)

    num_gaussians = num_elements

    @property
    def drawable(self) -> Tensor:
        return self.rows().kept

    @property
    def facts(self) -> dict[str, int | float]:
        return {"num_points": self.num_elements}

    def rows(self) -> Rows:
        return Rows(torch.ones(self.num_elements, dtype=torch.bool), 0, 0, None)

    def select(self, index: Tensor) -> "PointScene":
        return replace(self, points=self.points.select(index), hints=None)

    def with_elements(self, elements: Points, hints: RenderHints | None = None) -> "PointScene":
        return replace(self, points=elements, hints=hints)


@gaussians_of_view.register
def _(scene: PointScene, cameras: Cameras, view: int) -> Gaussians:
    points, sizes, there = scene.points, scene.points.log_sizes.exp(), torch.ones(scene.num_elements, dtype=torch.bool)
    if scene.hints is not None:
        sizes, there = sizes * scene.hints.size_gain, ~scene.hints.left_out
    count = int(there.sum())
    turns = torch.tensor([1.0, 0.0, 0.0, 0.0]).expand(count, -1).clone()
    scales = sizes[there, None].expand(-1, 3).clone()
    return Gaussians(points.positions[there], turns, scales, torch.full((count,), 0.9), points.colors[there])


@pytest.fixture
def complete() -> Partial:
    rng = torch.Generator().manual_seed(2)
    points = Points(torch.rand(400, 3, generator=rng) - 0.5, torch.rand(400, 3, generator=rng))
    return Partial(PointScene(points), Erasures.nothing_lost(400))


@pytest.mark.parametrize("name", ["drop", "grow"])
def test_its_losses_are_concealed_and_drawn(complete: Partial, name: str) -> None:
    known = torch.rand(400, generator=torch.Generator().manual_seed(3)) > 0.4
    partial = complete.without(known)
    scene = conceal(partial, name)
    assert torch.equal(scene.hints.left_out, ~known)
    assert torch.equal(scene.points.colors[known], complete.scene.points.colors[known])
    assert bool((scene.hints.size_gain[known] > 1).any()) == (name == "grow")
    picture, whole = (render_scene(drawn, tiny_cameras(1, 48, 32)) for drawn in (scene, complete.scene))
    assert picture.shape == whole.shape == (1, 32, 48, 3)
    assert 0 < float((picture - whole).abs().mean()) < float(whole.mean())


def test_who_needs_more_is_not_offered_and_says_so(complete: Partial) -> None:
    partial = complete.without(torch.arange(400) > 100)
    assert set(concealer_names((), partial.offers)) == {"drop", "grow"}
    for name in ("cari", "scene_free"):
        with pytest.raises(InvalidValueError, match=f"concealer '{name}' needs .* this stream of points has not: drop"):
            conceal(partial, name)
