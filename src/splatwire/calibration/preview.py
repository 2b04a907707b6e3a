"""Fits a preview to the training photos: a low-quality scene of as many explicit Gaussians as fit one datagram."""

import math
import time
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from splatwire.arguments import check_fields, checked
from splatwire.calibration.checks import check_settings
from splatwire.calibration.views import CalibrationViews, Progress, References, spread_evenly
from splatwire.codec.preview import (
    MAX_DISTANCE_ASINH,
    MAX_PREVIEW_BYTES,
    Preview,
    PreviewQuantisation,
    gaussians_within,
    preview_gaussians,
    write_preview,
)
from splatwire.errors import InvalidValueError
from splatwire.ops.arrays import lower_median, to_numpy
from splatwire.ops.knn import nearest_neighbors
from splatwire.render import iterate_views
from splatwire.render.cpu import ViewRasterizer, float_arrays, keep_freed_memory, render_cpu
from splatwire.render.importance import footprint_importance
from splatwire.types import Cameras, Gaussians
from splatwire.types.scene import Scene

_POSITION, _SIZE, _COLOR, _OPACITY = 0.02, 0.04, 0.03, 0.03
RATES = (_POSITION, _POSITION, _POSITION, _SIZE, _SIZE, _SIZE, _COLOR, _COLOR, _COLOR, _OPACITY)
"""Learning rates of a Gaussian's parameters, in the order of `PreviewQuantisation.values`."""
BACKGROUND_RATE = 0.01
_LOWEST = (*[-MAX_DISTANCE_ASINH] * 3, *[-6.0] * 3, 0.0, 0.0, 0.0, 1 / 32)
_HIGHEST = (*[MAX_DISTANCE_ASINH] * 3, *[3.0] * 3, 1.0, 1.0, 1.0, 31 / 32)
_FIRST_OPACITY = 0.8
_SPLIT_SHIFT, _SPLIT_SHRINK = 0.6, 0.5
"""Split of a Gaussian along its longest axis: shift of each half in standard deviations, decrease of its log size."""
_ERROR_VIEWS = 12
_BETAS, _EPSILON = (0.9, 0.99), 1e-8
"""Decay rates of Adam's moments; epsilon of its division."""


@dataclass(frozen=True)
class PreviewConfig:
    """Settings for fitting a preview: a few Gaussians that are sent first, and shown until the scene arrives.

    Attributes:
        num_bytes: Maximum size of the preview in bytes.
        steps: Number of optimisation steps; each step renders one view.
        num_relocations: Number of times that the least visible Gaussians are moved to regions with a large error.
        relocated_share: Share of the Gaussians that are moved each time, 0 to 1.
        relocation_end: Share of the steps after which no more Gaussians are moved, 0 to 1.
        rounding_start: Share of the steps after which parameters are rounded to values that can be sent, 0 to 1.
        views: Maximum number of views that the preview is fitted to.
        width: Maximum width of these views, pixels.
        scored_views: Maximum number of views for measuring the quality of the result.
        scored_width: Maximum width of the views for measuring the quality, pixels.
        seed: Seed of all random numbers.
    """

    num_bytes: int = MAX_PREVIEW_BYTES
    steps: int = 3000
    num_relocations: int = 20
    relocated_share: float = 0.05
    relocation_end: float = 0.6
    rounding_start: float = 0.7
    views: int = 100
    width: int = 120
    scored_views: int = 25
    scored_width: int = 400
    seed: int = 0

    def __post_init__(self) -> None:
        check_fields(self)
        check_settings(
            self, "the fit of a preview", ("steps", "views", "width", "scored_views", "scored_width"),
            relocated_share=0 < self.relocated_share < 1, relocation_end=0 < self.relocation_end < 1,
            rounding_start=0 < self.rounding_start < 1, num_bytes=gaussians_within(self.num_bytes) > 0,
            num_relocations=self.num_relocations >= 0, seed=self.seed >= 0,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class PreviewResult:
    """Result of the fit of a preview.

    Attributes:
        section: Encoded preview: a few coarse Gaussians for a first picture. It becomes the section `preview` of the
            stream's side information.
        num_gaussians: Number of Gaussians of the preview.
        psnr: Mean PSNR in decibels by name of the pictures: `background` (background colour only), `preview`, or
            `complete` (complete scene).
        seconds: Duration of the fit in seconds.
    """

    section: bytes
    num_gaussians: int
    psnr: dict[str, float]
    seconds: float


@checked
def preview_for_scene(
    scene: Scene,
    views: CalibrationViews,
    config: PreviewConfig | None = None,
    *,
    test: CalibrationViews | None = None,
    progress: Progress | None = None,
) -> PreviewResult:
    """Fits a preview to a scene, and returns the preview as the section `preview` of the side information.

    Args:
        scene: The complete scene. It provides the initial Gaussians, and the target pictures if `views` has no photos.
        views: Views that the preview is fitted to.
        config: The settings; None for the defaults.
        test: Views for measuring the quality of the result; None for `views`.
        progress: Called with the name of the current task and its completed share, 0 to 1.

    Raises:
        InvalidValueError: If no element of the scene is visible in any view.
    """
    config, show, started = config or PreviewConfig(), progress or (lambda task, share: None), time.perf_counter()
    scene = views.with_background_of_views(scene)
    preview = _Fit(scene, References.of(scene, views.reduced(config.views, config.width)), config).run(show)
    section = write_preview(preview)
    scored = (views if test is None else test).reduced(config.scored_views, config.scored_width)
    quality = _scores(scene, section, References.of(scene, scored), show)
    return PreviewResult(section, preview.num_gaussians, quality, time.perf_counter() - started)


class _Fit:
    """Optimiser of a preview's Gaussians, by gradient descent."""

    # The parameters are the ten numbers of each Gaussian (`PreviewQuantisation.values`), divided by their learning
    # rates, so that the Adam optimiser needs only one learning rate.

    def __init__(self, scene: Scene, references: References, config: PreviewConfig) -> None:
        keep_freed_memory()
        self._references, self._config, self._rng = references, config, np.random.default_rng(config.seed)
        self._rates = np.array(RATES, np.float32)
        self.quantisation, values = self._initial_gaussians(scene, gaussians_within(config.num_bytes))
        self._parameters = _Adam(values / self._rates)
        self._background_parameters = _Adam(np.array(scene.background, np.float32) / np.float32(BACKGROUND_RATE))
        self._rounded = False

    def run(self, show: Progress) -> Preview:
        """Fits the Gaussians of the preview; returns the preview, with parameters rounded to values that can be sent.

        Args:
            show: Called with the name of the current task and its completed share, 0 to 1.
        """
        config, num_views = self._config, self._references.cameras.num_views
        relocation_interval = max(1, round(config.relocation_end * config.steps / (config.num_relocations + 1)))
        relocation_steps = {relocation_interval * (number + 1) for number in range(config.num_relocations)}
        for step in range(config.steps):
            if step == round(config.rounding_start * config.steps):
                self._start_rounding()
            elif step in relocation_steps and not self._rounded:
                self._relocate()
            rate = 0.02 + 0.98 * (0.5 + 0.5 * math.cos(math.pi * step / config.steps))
            gradients = self._gradients(int(self._rng.integers(num_views)))
            for part, gradient in zip((self._parameters, self._background_parameters), gradients, strict=True):
                part.step(gradient, rate)
            self._clamp()
            if step % 50 == 0:
                show("fitting a preview", step / config.steps)
        show("fitting a preview", 1.0)
        if not self._rounded:
            self._start_rounding()
        levels = np.rint(self.quantisation.levels(self._parameters.values * self._rates)).astype(np.int64)
        red, green, blue = np.rint(self._background * 255).astype(int).tolist()
        return Preview(self.quantisation, (red, green, blue), levels)

    @property
    def _background(self) -> Float[np.ndarray, "3"]:
        return self._background_parameters.values * np.float32(BACKGROUND_RATE)

    def _initial_gaussians(self, scene: Scene, count: int) -> tuple[PreviewQuantisation, Float[np.ndarray, "G 10"]]:
        """Places the initial Gaussians of the fit at randomly chosen visible elements of the scene.

        Returns:
            The value ranges for quantisation; and the parameters of the Gaussians, as in `PreviewQuantisation.values`.
        """
        # The probability of an element is proportional to its footprint in all views. Sizes follow from the
        # distances to the nearest neighbours.
        share = footprint_importance(scene, self._references.cameras).share.astype(np.float64)
        num_visible = int((share > 0).sum())
        if not num_visible:
            raise InvalidValueError("no view shows anything of the scene: there is nothing to preview")
        chosen = self._rng.choice(len(share), min(count, num_visible), replace=False, p=share / share.sum())
        positions = to_numpy(scene.positions)[chosen]
        middle = lower_median(positions)
        spread = 0.5 * float(lower_median(np.linalg.norm(to_numpy(self._references.cameras.centers) - middle, axis=1)))
        quantisation = PreviewQuantisation.fitting(
            middle.tolist(), max(spread, 1e-3), (*_LOWEST[:3], -6.0), (*_HIGHEST[:3], 3.0)
        )
        values = np.full((len(positions), len(RATES)), 0.5, np.float32)
        values[:, :3] = np.arcsinh((positions - middle) / quantisation.spread)
        spacings = nearest_neighbors(positions, positions, 3)[1].max(axis=1, keepdims=True)
        values[:, 3:6] = np.log(np.maximum(spacings / 2 / quantisation.spread, 1e-2))
        values[:, 9] = _FIRST_OPACITY
        return quantisation, values

    def _current_gaussians(self) -> tuple[Float[np.ndarray, "G 10"], Gaussians]:
        """Returns the Gaussians of the preview in the current state of the optimisation.

        Returns:
            Parameters as in `PreviewQuantisation.values`, float64 (G, 10); and the Gaussians with these parameters.
        """
        # In the last part of the fit, the parameters are rounded to the values that the preview can store.
        values = (self._parameters.values * self._rates).astype(np.float64)
        if self._rounded:
            values = self.quantisation.values(np.rint(self.quantisation.levels(values)))
        return values, self.quantisation.gaussians(values)

    def _gradients(self, view: int) -> tuple[Float[np.ndarray, "G 10"], Float[np.ndarray, "3"]]:
        """Returns the gradients of a view's mean squared error with respect to Gaussian parameters and background."""
        # Rounding of the parameters is treated as the identity function (straight-through).
        values, gaussians = self._current_gaussians()
        drawn = _DifferentiablePicture(gaussians, self._references.cameras, view, self._background)
        mask = self._references.masks[view]
        error = drawn.image - self._references.images[view]
        error = error if mask is None else error * mask[:, :, None]
        gradients, background_gradient = drawn.gradients(
            2 / (3 * (drawn.image[..., 0].size if mask is None else mask.sum())) * error
        )
        means, _, scales, opacities, colors = gradients
        position_slopes = self.quantisation.spread * np.cosh(values[:, :3])
        value_gradients = np.concatenate(
            [means * position_slopes, scales * gaussians.scales, colors, opacities[:, None]], axis=1
        )
        return (value_gradients * self._rates).astype(np.float32), background_gradient * np.float32(BACKGROUND_RATE)

    def _start_rounding(self) -> None:
        """Switches the fit to rounded parameters: from now on, each step rounds them as the encoder will.

        The quantisation ranges are derived from the smallest and the largest current values.
        """
        values = self._parameters.values * self._rates
        low, high = values.min(axis=0), values.max(axis=0)
        lowest, highest = [*low[:3].tolist(), float(low[3:6].min())], [*high[:3].tolist(), float(high[3:6].max())]
        self.quantisation = PreviewQuantisation.fitting(
            self.quantisation.middle, self.quantisation.spread, lowest, highest
        )
        self._rounded = True

    def _clamp(self) -> None:
        bounds = (np.array(bound, np.float32) / self._rates for bound in (_LOWEST, _HIGHEST))
        np.clip(self._parameters.values, *bounds, out=self._parameters.values)
        np.clip(self._background_parameters.values, 0, 1 / BACKGROUND_RATE, out=self._background_parameters.values)

    def _relocate(self) -> None:
        """Moves the least visible Gaussians to regions with a large error."""
        # The Gaussians with the largest error are split in two along their longest axis. A relocated Gaussian
        # becomes one of the two halves.
        visibility, errors = self._weights_and_errors()
        count = max(1, round(self._config.relocated_share * len(visibility)))
        least_visible = np.argsort(visibility, kind="stable")[:count]
        errors[least_visible] = -1
        worst = np.argsort(-errors, kind="stable")[:count]
        values = self._parameters.values * self._rates
        halves, rows = values[worst], np.arange(count)
        axis = halves[:, 3:6].argmax(axis=1)
        shift = np.zeros((count, 3), np.float32)
        shift[rows, axis] = _SPLIT_SHIFT * np.exp(halves[rows, 3 + axis]) / np.cosh(halves[rows, axis])
        halves[rows, 3 + axis] -= _SPLIT_SHRINK
        for targets, sign in ((worst, -1), (least_visible, 1)):
            values[targets] = np.concatenate([halves[:, :3] + sign * shift, halves[:, 3:]], axis=1)
            self._parameters.forget(targets)
        self._parameters.values[:] = values / self._rates

    def _weights_and_errors(self) -> tuple[Float[np.ndarray, "G"], Float[np.ndarray, "G"]]:
        """Measures the visibility of each Gaussian, and the picture error in the pixels that it covers.

        Returns:
            For each Gaussian, the sum of its blending weights over all pixels; and the sum of its blending weights
            times the squared errors of the pixels.
        """
        gaussians = self._current_gaussians()[1]
        visibility, errors = (
            np.zeros(gaussians.num_gaussians, np.float32),
            np.zeros(gaussians.num_gaussians, np.float32),
        )
        for view in spread_evenly(self._references.cameras.num_views, _ERROR_VIEWS):
            drawn = _DifferentiablePicture(gaussians, self._references.cameras, view, self._background)
            error = ((drawn.image - self._references.images[view]) ** 2).sum(axis=2, keepdims=True)
            mask = self._references.masks[view]
            error = error if mask is None else error * mask[:, :, None]
            visibility += drawn.gradients(np.ones_like(drawn.image))[0][4][:, 0]
            errors += drawn.gradients(np.broadcast_to(error, drawn.image.shape))[0][4][:, 0]
        return visibility, errors


class _Adam:
    """Parameters that the Adam optimiser updates (Kingma and Ba 2015).

    Args:
        values: Initial values, float32; changed in place.
    """

    def __init__(self, values: np.ndarray) -> None:
        self.values = values
        self._mean, self._square, self._steps = np.zeros_like(values), np.zeros_like(values), 0

    def step(self, gradient: np.ndarray, rate: float) -> None:
        """Updates the parameters by one step of Adam.

        Args:
            gradient: Gradient of the loss with respect to the parameters.
            rate: Learning rate.
        """
        self._steps += 1
        self._mean += (1 - _BETAS[0]) * (gradient - self._mean)
        self._square += (1 - _BETAS[1]) * (gradient**2 - self._square)
        mean, square = self._mean / (1 - _BETAS[0] ** self._steps), self._square / (1 - _BETAS[1] ** self._steps)
        self.values -= np.float32(rate) * mean / (np.sqrt(square) + np.float32(_EPSILON))

    def forget(self, rows: np.ndarray) -> None:
        """Sets the first moment of the Gaussians at the given indices to zero."""
        # After a relocation it refers to their previous positions.
        self._mean[rows] = 0


class _DifferentiablePicture:
    """Rendered picture of a view that can be differentiated with respect to the Gaussians.

    Args:
        gaussians: The Gaussians to draw.
        cameras: The cameras.
        view: Index of the camera.
        background: RGB of the background, float32.
    """

    def __init__(self, gaussians: Gaussians, cameras: Cameras, view: int, background: np.ndarray) -> None:
        self._arrays = float_arrays(gaussians)
        self._rasterizer = ViewRasterizer(self._arrays, cameras, view, for_gradients=True)
        self.image, self._transmittance = self._rasterizer.draw(background)

    def gradients(self, d_image: np.ndarray) -> tuple[list[np.ndarray], Float[np.ndarray, "3"]]:
        """Computes gradients with respect to the Gaussians and the background, given the gradient of the image.

        Args:
            d_image: Gradient of a loss with respect to the pixels.

        Returns:
            The gradients of means, quats, scales, opacities and colors, and the gradient of the background.
        """
        weights = np.ascontiguousarray(d_image, np.float32)
        gradients = self._rasterizer.gradients(self._arrays, self.image, weights)
        return gradients[:5], np.einsum("hw,hwc->c", self._transmittance, weights)


def _scores(scene: Scene, section: bytes, pictures: References, show: Progress) -> dict[str, float]:
    """Measures the mean PSNR of an encoded preview and of pictures for comparison, over a set of views.

    Args:
        scene: The complete scene, for comparison.
        section: Bytes of the encoded preview.
        pictures: Reference pictures of the views.
        show: Called with the name of the current task and its completed share, 0 to 1.

    Returns:
        Mean PSNR in decibels by name of the pictures, as in `PreviewResult.psnr`.
    """
    gaussians, background = preview_gaussians(section)
    background_color = np.array(background, np.float32)
    totals = dict.fromkeys(("background", "preview", "complete"), 0.0)
    for view, complete in enumerate(iterate_views(scene, pictures.cameras)):
        drawn = render_cpu(gaussians, pictures.cameras.select([view]), background=background_color)[0]
        rows = {
            "background": np.broadcast_to(background_color, drawn.shape),
            "preview": np.clip(drawn, 0, 1),
            "complete": complete,
        }
        for name, picture in rows.items():
            totals[name] += pictures.psnr(view, picture)
        show("comparing pictures", (view + 1) / len(pictures.images))
    return {name: total / len(pictures.images) for name, total in totals.items()}
