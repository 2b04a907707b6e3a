"""Fits a preview: as many explicit Gaussians as one datagram holds, to the training photos."""

import time
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from splatwire.calibrate.checks import check_settings
from splatwire.calibrate.views import CalibrationViews, Progress, References, spread_evenly
from splatwire.codec.preview import (
    MAX_PREVIEW_BYTES,
    MOST_AWAY,
    MOST_LEVELS,
    Preview,
    PreviewFrame,
    gaussians_within,
    preview_gaussians,
    write_preview,
)
from splatwire.errors import InvalidValueError
from splatwire.model.appearance import Scene
from splatwire.model.tensors import to_tensors
from splatwire.ops.knn import nearest_neighbors
from splatwire.render import iterate_views
from splatwire.render.backends import create_training_renderer
from splatwire.render.cpu import render_cpu
from splatwire.render.importance import footprint_importance
from splatwire.scene import Gaussians
from splatwire.train.schedule import half_cosine

_PLACE, _SIZE, _COLOR, _OPACITY = 0.02, 0.04, 0.03, 0.03
RATES = (_PLACE, _PLACE, _PLACE, _SIZE, _SIZE, _SIZE, _COLOR, _COLOR, _COLOR, _OPACITY)
"""Learning rates of a Gaussian's numbers, which are those of `PreviewFrame.values`; that of the background is 0.01."""
BACKGROUND_RATE = 0.01
_LOWEST = (*[-MOST_AWAY] * 3, *[-6.0] * 3, 0.0, 0.0, 0.0, 1 / 32)
_HIGHEST = (*[MOST_AWAY] * 3, *[3.0] * 3, 1.0, 1.0, 1.0, 31 / 32)
_FIRST_OPACITY = 0.8
_SPLIT_SHIFT, _SPLIT_SHRINK = 0.6, 0.5
"""Where halves of a split Gaussian go, in standard deviations, and what their longest axis loses, as a logarithm."""
_ERROR_VIEWS = 12


@dataclass(frozen=True)
class PreviewConfig:
    """A fit.

    Attributes:
        num_bytes: Most bytes of the preview.
        steps: Steps, one view each.
        rounds: How often Gaussians that hardly show are moved to where the error is.
        moved: Share of the Gaussians that are moved at a time.
        still: Share of the steps after which none is moved any more, and
        rounding: after which the numbers are rounded to those that can be sent.
        views: Most views that are fitted to, and
        width: how wide they are at most, pixels.
        scored_views: Most views that the result is compared in, and
        scored_width: how wide these are at most.
        seed: Seed of everything random.
    """

    num_bytes: int = MAX_PREVIEW_BYTES
    steps: int = 3000
    rounds: int = 20
    moved: float = 0.05
    still: float = 0.6
    rounding: float = 0.7
    views: int = 100
    width: int = 120
    scored_views: int = 25
    scored_width: int = 400
    seed: int = 0

    def __post_init__(self) -> None:
        check_settings(
            self, "the fit of a preview", ("steps", "views", "width", "scored_views", "scored_width"),
            moved=0 < self.moved < 1, still=0 < self.still < 1, rounding=0 < self.rounding < 1,
            num_bytes=gaussians_within(self.num_bytes) > 0, rounds=self.rounds >= 0, seed=self.seed >= 0,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class PreviewResult:
    """What came out.

    Attributes:
        section: Bytes of the section.
        num_gaussians: How many it has.
        psnr: Decibels of `background` alone, of the `preview`, and of the `complete` scene.
        seconds: Time taken.
    """

    section: bytes
    num_gaussians: int
    psnr: dict[str, float]
    seconds: float


def preview_for_scene(
    scene: Scene,
    views: CalibrationViews,
    config: PreviewConfig | None = None,
    *,
    test: CalibrationViews | None = None,
    progress: Progress | None = None,
) -> PreviewResult:
    """Makes the section `preview` for a scene.

    Args:
        scene: The complete scene: where the first Gaussians are, and what is shown where there are no photos.
        views: What is fitted to.
        config: The run.
        test: Views that the result is compared in; None for those that it was fitted to.
        progress: Called with what is done and the share of it that is done.

    Raises:
        InvalidValueError: If no view shows anything of the scene.
    """
    config, show, started = config or PreviewConfig(), progress or (lambda task, share: None), time.perf_counter()
    scene = views.in_front(scene)
    preview = _Fit(scene, References.of(scene, views.reduced(config.views, config.width)), config).run(show)
    section = write_preview(preview)
    scored = (views if test is None else test).reduced(config.scored_views, config.scored_width)
    quality = _scores(scene, section, References.of(scene, scored), show)
    return PreviewResult(section, preview.num_gaussians, quality, time.perf_counter() - started)


class _Fit:
    """Gaussians on their way to a preview.

    Their numbers are those of `PreviewFrame.values`, each over its learning rate, so that one rate does for all.
    """

    def __init__(self, scene: Scene, pictures: References, config: PreviewConfig) -> None:
        self._pictures, self._config = pictures, config
        self._images, self._masks = to_tensors(tuple(pictures.images)), to_tensors(tuple(pictures.masks))
        self._draw = create_training_renderer(torch.device("cpu"))
        self._generator = torch.Generator().manual_seed(config.seed)
        self._rates = torch.tensor(RATES)
        self.frame, values = self._first(scene, gaussians_within(config.num_bytes))
        self._raw = (values / self._rates).requires_grad_()
        self._behind = (torch.tensor(scene.background) / BACKGROUND_RATE).requires_grad_()
        self._rounded = False

    def run(self, show: Progress) -> Preview:
        """Fits, and rounds."""
        config, num_views = self._config, self._pictures.cameras.num_views
        optimizer = torch.optim.Adam([self._raw, self._behind], lr=1.0, betas=(0.9, 0.99))
        every = max(1, round(config.still * config.steps / (config.rounds + 1)))
        moments = {every * (number + 1) for number in range(config.rounds)}
        for step in range(config.steps):
            if step == round(config.rounding * config.steps):
                self._round()
            elif step in moments and not self._rounded:
                self._move(optimizer)
            optimizer.param_groups[0]["lr"] = 0.02 + 0.98 * half_cosine(step / config.steps)
            view = int(torch.randint(num_views, (1,), generator=self._generator))
            error = (self._image(self._gaussians(), view) - self._images[view]).square()
            mask = self._masks[view]
            optimizer.zero_grad()
            (error.mean() if mask is None else error[mask].mean()).backward()
            optimizer.step()
            self._clamp()
            if step % 50 == 0:
                show("fitting a preview", step / config.steps)
        show("fitting a preview", 1.0)
        if not self._rounded:
            self._round()
        with torch.no_grad():
            levels = _levels(self.frame, self._raw * self._rates).round().long().numpy()
            red, green, blue = (self._behind * BACKGROUND_RATE * 255).round().int().tolist()
        return Preview(self.frame, (red, green, blue), levels)

    def _first(self, scene: Scene, count: int) -> tuple[PreviewFrame, Float[Tensor, "G 10"]]:
        """Elements drawn by their share of the pictures, as far apart as they are large."""
        share = torch.from_numpy(footprint_importance(scene, self._pictures.cameras).share)
        shown = int((share > 0).sum())
        if not shown:
            raise InvalidValueError("no view shows anything of the scene: there is nothing to preview")
        chosen = torch.multinomial(share, min(count, shown), generator=self._generator)
        places = torch.as_tensor(scene.positions)[chosen]
        middle = places.median(dim=0).values
        spread = 0.5 * float((torch.as_tensor(self._pictures.cameras.centers) - middle).norm(dim=1).median())
        frame = PreviewFrame.fitting(middle.tolist(), max(spread, 1e-3), (*_LOWEST[:3], -6.0), (*_HIGHEST[:3], 3.0))
        values = torch.full((len(places), len(RATES)), 0.5)
        values[:, :3] = torch.asinh((places - middle) / frame.spread)
        near = torch.from_numpy(nearest_neighbors(places, places, 3)[1]).amax(dim=1, keepdim=True)
        values[:, 3:6] = (near / 2 / frame.spread).clamp(min=1e-2).log()
        values[:, 9] = _FIRST_OPACITY
        return frame, values

    def _gaussians(self) -> Gaussians:
        values = self._raw * self._rates
        if self._rounded:
            levels = _levels(self.frame, values)
            values = _values(self.frame, levels + (levels.round() - levels).detach())
        return _gaussians(self.frame, values)

    def _image(self, gaussians: Gaussians, view: int) -> Float[Tensor, "H W 3"]:
        camera, behind = self._pictures.cameras.select([view]), self._behind * BACKGROUND_RATE
        return self._draw(gaussians, camera, background=behind, watched=False).image

    @torch.no_grad()
    def _round(self) -> None:
        """From here on only what can be sent is drawn; gradients go through as if it were not rounded."""
        values = self._raw * self._rates
        low, high = values.amin(dim=0), values.amax(dim=0)
        low = torch.cat([low[:3], low[3:6].amin()[None]])
        high = torch.cat([high[:3], high[3:6].amax()[None]])
        self.frame = PreviewFrame.fitting(self.frame.middle, self.frame.spread, low.tolist(), high.tolist())
        self._rounded = True

    @torch.no_grad()
    def _clamp(self) -> None:
        self._raw.clamp_(torch.tensor(_LOWEST) / self._rates, torch.tensor(_HIGHEST) / self._rates)
        self._behind.clamp_(0, 1 / BACKGROUND_RATE)

    def _move(self, optimizer: torch.optim.Optimizer) -> None:
        """Splits Gaussians where the error is; those that show least become the second halves."""
        shown, wrong = self._shares()
        count = max(1, round(self._config.moved * len(shown)))
        least = shown.argsort()[:count]
        wrong[least] = -1
        worst = wrong.argsort(descending=True)[:count]
        with torch.no_grad():
            values = self._raw * self._rates
            halves = values[worst]
            axis = halves[:, 3:6].argmax(dim=1)
            rows = torch.arange(count)
            shift = torch.zeros(count, 3)
            shift[rows, axis] = _SPLIT_SHIFT * halves[rows, 3 + axis].exp() / halves[rows, axis].cosh()
            halves[rows, 3 + axis] -= _SPLIT_SHRINK
            for places, sign in ((worst, -1), (least, 1)):
                values[places] = torch.cat([halves[:, :3] + sign * shift, halves[:, 3:]], dim=1)
                optimizer.state[self._raw]["exp_avg"][places] = 0
            self._raw.copy_(values / self._rates)

    def _shares(self) -> tuple[Float[Tensor, "G"], Float[Tensor, "G"]]:
        """How much of the pictures each Gaussian is, and how much of their squared error lies under it."""
        with torch.no_grad():
            now = self._gaussians()
        shown, wrong = torch.zeros(now.num_gaussians), torch.zeros(now.num_gaussians)
        for view in spread_evenly(self._pictures.cameras.num_views, _ERROR_VIEWS):
            colors = now.colors.clone().requires_grad_()
            image = self._image(replace(now, colors=colors), view)
            error = (image.detach() - self._images[view]).square().sum(dim=2, keepdim=True)
            mask = self._masks[view]
            error = error if mask is None else error * mask[:, :, None]
            shown += torch.autograd.grad(image.sum(), colors, retain_graph=True)[0][:, 0]
            wrong += torch.autograd.grad((image * error).sum(), colors)[0][:, 0]
        return shown, wrong


def _scores(scene: Scene, section: bytes, pictures: References, show: Progress) -> dict[str, float]:
    """Mean PSNR of what a receiver of these bytes draws."""
    gaussians, background = preview_gaussians(section)
    behind = np.array(background, np.float32)
    totals = dict.fromkeys(("background", "preview", "complete"), 0.0)
    for view, complete in enumerate(iterate_views(scene, pictures.cameras)):
        drawn = render_cpu(gaussians, pictures.cameras.select([view]), background=behind)[0]
        rows = {
            "background": np.broadcast_to(behind, drawn.shape),
            "preview": np.clip(drawn, 0, 1),
            "complete": complete,
        }
        for name, picture in rows.items():
            totals[name] += pictures.psnr(view, picture)
        show("comparing pictures", (view + 1) / len(pictures.images))
    return {name: total / len(pictures.images) for name, total in totals.items()}


def _values(frame: PreviewFrame, levels: Float[Tensor, "G 10"]) -> Float[Tensor, "G 10"]:
    """Does as `PreviewFrame.values`; differentiable."""
    low, step = to_tensors(frame.scale())
    return low.to(levels) + levels * step.to(levels)


def _levels(frame: PreviewFrame, values: Float[Tensor, "G 10"]) -> Float[Tensor, "G 10"]:
    """Does as `PreviewFrame.levels`; differentiable."""
    low, step = to_tensors(frame.scale())
    most = torch.tensor(MOST_LEVELS).to(values)
    return ((values - low.to(values)) / step.to(values).clamp(min=1e-12)).clamp(min=0).minimum(most)


def _gaussians(frame: PreviewFrame, values: Float[Tensor, "G 10"]) -> Gaussians:
    """Does as `PreviewFrame.gaussians`; differentiable."""
    places = torch.tensor(frame.middle).to(values) + frame.spread * torch.sinh(values[:, :3])
    upright = torch.tensor([1.0, 0.0, 0.0, 0.0]).to(values).repeat(len(values), 1)
    return Gaussians(places, upright, frame.spread * torch.exp(values[:, 3:6]), values[:, 9], values[:, 6:9])
