"""Trains the scene-free concealer on the pictures of some scenes, for use on all others."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from splatwire.calibrate.checks import check_settings
from splatwire.calibrate.pseudo_loss import CalibrationData
from splatwire.conceal.scene_free import GainNetwork
from splatwire.conceal.scene_free.elements import ElementInputs, ElementNetwork
from splatwire.conceal.scene_free.network import HIDDEN, GainInputs, gain_inputs
from splatwire.conceal.scene_free.surroundings import surroundings_of
from splatwire.errors import DivergedError, InvalidValueError
from splatwire.model.appearance import Scene, spawned_gaussians
from splatwire.model.gaussian_heads import SpawnedGaussians
from splatwire.render.backends import create_renderer
from splatwire.scene import Cameras, Gaussians
from splatwire.train.schedule import half_cosine

Network = TypeVar("Network", GainNetwork, ElementNetwork)


@dataclass(frozen=True)
class SceneFreeConfig:
    """A training run.

    Attributes:
        steps: Steps of Adam; one picture of one loss of one scene each, the scenes in turn.
        learning_rate: At the start; falls to 0 along a cosine.
        drop_rates: Share of the packets that each pseudo-loss drops; as many losses per scene.
        hidden: Width of the networks.
        floor: Added to the squared error of a picture before the logarithm: about the error of a lossless render
            against a photo, below which an error does not show.
        seed: Seed of everything random.
    """

    steps: int = 240
    learning_rate: float = 3e-3
    drop_rates: tuple[float, ...] = (0.2, 0.2, 0.2, 0.1, 0.4)
    hidden: int = HIDDEN
    floor: float = 1e-3
    seed: int = 0

    def __post_init__(self) -> None:
        rates = bool(self.drop_rates) and all(0 < rate < 1 for rate in self.drop_rates)
        check_settings(self, "a training", ("hidden",), steps=self.steps >= 0, drop_rates=rates)


def train_scene_free(
    scenes: Sequence[CalibrationData],
    config: SceneFreeConfig,
    *,
    progress: Callable[[int, float], None] | None = None,
) -> GainNetwork:
    """Trains a network by the error of lossy, concealed pictures against lossless ones.

    The loss of a picture is `log(mean squared error + floor)`: each decibel counts alike in every scene and view.

    Args:
        scenes: What to learn from, with the cameras at the size at which pictures are compared.
        config: The run.
        progress: Called after each step with its number and its loss.

    Returns:
        The network after the last step.

    Raises:
        InvalidValueError: If there is no scene, or one has no cameras.
        DivergedError: If the loss is not finite.
    """
    seeds = np.random.SeedSequence(config.seed).spawn(len(scenes))
    lessons = [_lessons(scene, config, seed) for scene, seed in zip(scenes, seeds, strict=True)]
    return train_on(lessons, GainNetwork(config.hidden, seed=config.seed), config, progress)


def _lessons(data: CalibrationData, config: SceneFreeConfig, seeds: np.random.SeedSequence) -> "Lessons":
    if data.cameras is None:
        raise InvalidValueError("a concealer cannot be trained on a scene without cameras")
    around = surroundings_of(data.complete, torch.arange(data.scene.anchors.num_anchors))
    with torch.no_grad():
        inputs = [
            gain_inputs(data.complete.without(known), around.select(known))
            for known in data.pseudo_losses(config.drop_rates, seeds)
        ]
    return Lessons(data.scene, data.cameras, inputs)


def train_on(
    lessons: "Sequence[Lessons]",
    network: Network,
    config: SceneFreeConfig,
    progress: Callable[[int, float], None] | None = None,
) -> Network:
    """Trains a network on the losses of some scenes; see `train_scene_free`.

    Raises:
        InvalidValueError: If there is no scene.
        DivergedError: If the loss is not finite.
    """
    if not lessons:
        raise InvalidValueError("a concealer cannot be trained on no scene")
    network.standardise(torch.cat([inputs.signature for lesson in lessons for inputs in lesson.inputs]))
    optimiser = torch.optim.Adam(network.parameters(), lr=config.learning_rate, betas=(0.95, 0.99))
    rng = torch.Generator().manual_seed(config.seed)
    for step in range(config.steps):
        lesson = lessons[step % len(lessons)]
        error = lesson.error(network, rng)
        loss = (error + config.floor).log()
        if not bool(loss.isfinite()):
            raise DivergedError(step + 1)
        for group in optimiser.param_groups:
            group["lr"] = config.learning_rate * half_cosine(step / config.steps)
        optimiser.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimiser.step()
        if progress is not None:
            progress(step + 1, float(loss.detach()))
    return network.eval().requires_grad_(False)


class Lessons:
    """Losses and views of one scene, with all that does not change while a network learns.

    Args:
        scene: The complete scene.
        cameras: Where pictures are compared.
        inputs: What the network sees of each loss.
    """

    def __init__(self, scene: Scene, cameras: Cameras, inputs: Sequence[GainInputs] | Sequence[ElementInputs]) -> None:
        self._scene, self._cameras, self.inputs = scene, cameras, inputs
        self._views: dict[int, tuple[SpawnedGaussians, Tensor]] = {}
        self._order: list[tuple[int, int]] = []

    def error(self, network: GainNetwork | ElementNetwork, rng: torch.Generator) -> Float[Tensor, ""]:
        """Mean squared error of the next picture; every loss meets every view before one comes again."""
        if not self._order:
            pairs = [(loss, view) for loss in range(len(self.inputs)) for view in range(self._cameras.num_views)]
            self._order = [pairs[place] for place in torch.randperm(len(pairs), generator=rng).tolist()]
        loss, view = self._order.pop()
        inputs = self.inputs[loss]
        spawned, reference = self._lossless(view)
        place = torch.full((self._scene.num_elements,), -1)
        place[inputs.rows] = torch.arange(len(inputs.rows))
        place = place[spawned.anchor_index]
        arrived = place >= 0
        size, opacity = (gain.index_select(0, place[arrived]) for gain in network(inputs))
        drawn = _with_gains(_rows(spawned.gaussians, arrived), size, opacity)
        return ((self._draw(drawn, view) - reference) ** 2).mean()

    @torch.no_grad()
    def _lossless(self, view: int) -> tuple[SpawnedGaussians, Tensor]:
        if view not in self._views:
            spawned = spawned_gaussians(self._scene, self._cameras, view)
            self._views[view] = spawned, self._draw(spawned.gaussians, view)
        return self._views[view]

    def _draw(self, gaussians: Gaussians, view: int) -> Float[Tensor, "H W 3"]:
        behind = torch.tensor(self._scene.background)
        return create_renderer("cpu")(gaussians, self._cameras.select([view]), background=behind)[0]


def _rows(g: Gaussians, rows: Tensor) -> Gaussians:
    return Gaussians(g.means[rows], g.quats[rows], g.scales[rows], g.opacities[rows], g.colors[rows])


def _with_gains(g: Gaussians, size: Float[Tensor, "G"], opacity: Float[Tensor, "G"]) -> Gaussians:
    return replace(g, scales=g.scales * size[:, None], opacities=(g.opacities * opacity).clamp(max=1))
