"""Fine-tuning of explicit Gaussians by gradient descent on rendered pictures, including the codec's rounding."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Float32, Int8

from splatwire.arguments import check_fields, checked
from splatwire.codec.gaussians.packets import divide_into_packets
from splatwire.codec.gaussians.rounding import coding_for, round_splats
from splatwire.errors import InvalidValueError
from splatwire.finetuning.latents import Gradients, Latents, RoundingErrors, gradients_of, harmonic_gradient, map_slices
from splatwire.finetuning.options import FineTuning
from splatwire.finetuning.pictures import Pictures
from splatwire.finetuning.receptions import SimulatedReception, simulate_reception
from splatwire.finetuning.sampled_loss import SampledLoss
from splatwire.finetuning.sparsity import HarmonicCost
from splatwire.ops.adam import update_run
from splatwire.ops.threads import one_blas_thread
from splatwire.render.antialiasing import compensated
from splatwire.render.cpu import ViewRasterizer, float_arrays, keep_freed_memory
from splatwire.render.precision import MEASURED_VIEWS, measure_class_offsets
from splatwire.render.precision import VIEW_SIZE as MEASURED_SIZE
from splatwire.types import Cameras, SplatCoding, SplatScene
from splatwire.types.splats import Splats

RATES = {"displacements": 0.02, "rotations": 0.01, "logs": 0.01, "logits": 0.04, "base": 0.008, "harmonics": 0.02}
"""Learning rate of each parameter of `Latents` in the first iteration. Centres move in units of their Gaussian's size,
so that one rate fits scenes of any size. With a smaller rate of the harmonics, fewer of them would become 0 (see
`HarmonicCost`)."""
FINAL_RATE_RATIO = 0.03
"""Ratio of the last to the first learning rate; in between, the rate follows a cosine."""
BETA1, BETA2, EPSILON = 0.9, 0.999, 1e-15
"""Constants of Adam. The second moment remembers all views: a Gaussian may fill few views and be tiny in the others."""
_NUM_DIVISIONS = 8
"""Number of times that the division into packets is computed, if the channel loses packets."""
MAX_CHECK_INTERVAL = 50
"""Maximum number of iterations between two checks of the loss."""
MIN_CHECKS = 4
"""Number of checks in a fine-tuning with few iterations, which are then closer together."""
BACKTRACKING_FACTOR = 0.5
"""Factor on all learning rates after a check that found a larger loss than the check before."""
_CHECKED_RECEPTIONS = 2
"""Number of simulated packet losses with which checks measure the loss, if the channel loses packets."""
MIN_ERROR = 10**-4.6
"""Minimum divisor of gradients, as a mean squared error (46 dB). Without it, views that were better at first would have
so much weight that they determine the direction of every step."""


@dataclass(frozen=True)
class Progress:
    """Progress of a fine-tuning after one of its iterations.

    Attributes:
        iteration: Number of completed iterations.
        iterations: Total number of iterations.
        psnr: PSNR of the picture of this iteration, decibels.
    """

    iteration: int
    iterations: int
    psnr: float

    def __post_init__(self) -> None:
        check_fields(self)


@dataclass(frozen=True, eq=False)
class TunedGaussians:
    """Result of fine-tuning.

    Attributes:
        scene: The Gaussians before rounding, without quantisation steps.
        coding: The quantisation steps with which the Gaussians were fine-tuned.
    """

    scene: SplatScene
    coding: SplatCoding

    @property
    def rounded(self) -> SplatScene:
        """Scene whose Gaussians have the values that a decoder would return, and the steps that quantise to them.

        Encoding with these steps keeps all values.
        """
        return replace(self.scene, splats=round_splats(self.scene.splats, self.coding), coding=self.coding)


@checked
def fine_tune(
    scene: SplatScene,
    pictures: Pictures,
    options: FineTuning = FineTuning(),  # noqa: B008 - frozen
    progress: Callable[[Progress], None] | None = None,
) -> SplatScene:
    """Fine-tunes Gaussians as `tuned_gaussians` does, and rounds the result.

    Arguments and errors are those of `tuned_gaussians`.

    Returns:
        The scene with rounded Gaussians and their quantisation steps; encoding it without a quality setting is
        lossless.
    """
    return tuned_gaussians(scene, pictures, options, progress).rounded


@one_blas_thread()  # results must not depend on the number of processors
def tuned_gaussians(
    scene: SplatScene,
    pictures: Pictures,
    options: FineTuning = FineTuning(),  # noqa: B008 - frozen
    progress: Callable[[Progress], None] | None = None,
    class_offsets: Int8[np.ndarray, "N"] | None = None,
) -> TunedGaussians:
    """Optimises Gaussians so that renderings of the decoded Gaussians match given pictures.

    Centres, rotations, scales, opacities and harmonics are optimised with Adam; the number of Gaussians stays the same.
    Rounding is simulated, with straight-through gradients. The loss of a view is its mean squared error, divided by the
    error of the same view when it was first rendered. A further loss term is the estimated size of the encoded
    harmonics above degree 0; it makes most of them 0.

    The result depends only on the arguments, not on the number of threads.

    Args:
        scene: The Gaussians, already pruned to the final number. Each must have a visible effect.
        pictures: The pictures and their cameras, relative to the origin of the scene.
        options: The options.
        progress: Called after each iteration.
        class_offsets: Precision class of each Gaussian relative to the finest class: 0 for the finest quantisation
            steps, negative for coarser ones; None to measure the class offsets.

    Returns:
        The Gaussians before rounding, and their quantisation steps.

    Raises:
        InvalidValueError: If there are no Gaussians, or the cameras and the scene have different origins.
    """
    # Dividing by the first error (at least `MIN_ERROR`) gives all views similar weight; a view that becomes much
    # worse gets more weight. At intervals, the loss is measured in a fixed sample of the pictures (`SampledLoss`). If
    # it has grown since the check before, the Gaussians of that check are restored, and the learning rates are
    # multiplied by `BACKTRACKING_FACTOR`. The loss of the result, including the cost of harmonics, is thus not above
    # that of the rounded Gaussians at the start.
    if not scene.num_elements:
        raise InvalidValueError("fine-tuning: there are no Gaussians")
    if pictures.cameras.origin != scene.origin:
        raise InvalidValueError("fine-tuning: the cameras have another origin than the scene")
    keep_freed_memory()
    rng = np.random.Generator(np.random.PCG64(options.seed))
    if class_offsets is None:
        class_offsets = measure_class_offsets(scene.splats, _sample_cameras(pictures.cameras, options.seed))
    latents, views = Latents.of(scene.splats), _shuffled(pictures.cameras.num_views, rng)
    coding, rounding_errors, division = coding_for(latents.splats(), options.quality, class_offsets), None, None
    optimizer = _Adam(_rate_factors(coding))
    division_interval = options.rounding_interval * max(
        1, options.iterations // (_NUM_DIVISIONS * options.rounding_interval)
    )
    initial_errors = dict[tuple[int, bool], float]()
    sampled_loss = _sampled_loss(scene, latents.splats(), coding, pictures, options)
    cost, cost_gradient = HarmonicCost.of(coding) if latents.harmonics.size else None, None

    def loss_of(latents: Latents) -> float:
        loss = sampled_loss.loss(round_splats(latents.splats(), coding))
        return loss if cost is None else loss + cost.value(latents.harmonics)

    best, best_loss, rate = latents.copy(), loss_of(latents), options.rate
    check_interval = min(MAX_CHECK_INTERVAL, max(options.iterations // MIN_CHECKS, 1))
    for step in range(options.iterations):
        is_check = step > 0 and step % check_interval == 0
        if is_check:
            loss = loss_of(latents)
            if loss > best_loss:
                latents, rate = best.copy(), rate * BACKTRACKING_FACTOR
                optimizer.reset_first_moments()
            else:
                best, best_loss = latents.copy(), loss
        if step % options.rounding_interval == 0 or is_check:
            exact = latents.splats()
            rounded = round_splats(exact, coding)
            rounding_errors = RoundingErrors.between(exact, rounded)
            cost_gradient = None if cost is None else cost.gradient(latents.harmonics)
            if options.packet_loss is not None and step % division_interval == 0:
                division = divide_into_packets(replace(scene, splats=rounded, coding=coding), options.packetization)
        view, decoded = next(views), latents.splats(rounding_errors)
        reception = None
        if division is not None and step % 2:
            reception = simulate_reception(division, options, rng)
        shown = decoded if reception is None else reception.received_splats(decoded)
        mask = None if pictures.masks is None else pictures.masks[view]
        target = pictures.images[view].astype(np.float32) / 255
        shown_scene = replace(scene, splats=shown, coding=None, hints=None)
        # The divisor is fixed: with the logarithm of the error as the loss, Gaussians that are large in a single view
        # would be sacrificed for other views.
        error, splat_gradients = picture_gradients(
            shown_scene, pictures.cameras, view, target, mask, initial_errors.get((view, reception is None))
        )
        initial_errors.setdefault((view, reception is None), error)
        if reception is not None:
            splat_gradients = reception.gradients(decoded, splat_gradients)
        gradients = gradients_of(latents, decoded, rounding_errors, splat_gradients)
        if cost_gradient is not None:
            _add(gradients["harmonics"], cost_gradient)
        optimizer.update(latents.trained(), gradients, rate * _decay(step / options.iterations))
        latents.apply_rotations()
        if progress:
            progress(Progress(step + 1, options.iterations, -10 * math.log10(max(error, 1e-12))))
    if loss_of(latents) > best_loss:
        latents = best
    return TunedGaussians(replace(scene, splats=latents.splats(), coding=None, hints=None), coding)


def picture_gradients(
    scene: SplatScene,
    cameras: Cameras,
    view: int,
    target: Float[np.ndarray, "H W 3"],
    mask: Bool[np.ndarray, "H W"] | None = None,
    divisor: float | None = None,
) -> tuple[float, Gradients]:
    """Renders one view, and returns its mean squared error against a reference picture and the gradients of the error.

    Args:
        scene: The Gaussians.
        cameras: The cameras.
        view: Index of the camera of this view.
        target: RGB in [0, 1] of the reference picture.
        mask: True for pixels that are compared; None for all.
        divisor: Divisor of the gradients; None for the mean squared error of this view. A divisor below `MIN_ERROR` is
            raised to `MIN_ERROR`.

    Returns:
        Mean squared error of the view; and its gradients with respect to the attributes of the Gaussians, after the
        division.
    """
    # The rendering is clamped to [0, 1] before the comparison, as in `render_scene`. The error is the mean over all
    # pixels of the view, also with a mask. Small Gaussians of antialiased scenes are drawn with reduced opacity;
    # the gradients treat this reduction, and the viewing directions of the spherical harmonics, as constants.
    # Division by the error gives the gradients of its logarithm.
    splats, cameras = scene.splats, cameras.relative_to(scene.origin)
    plain = seen = splats.seen_from(cameras.centers[view])
    if scene.antialiased:
        seen = compensated(seen, cameras, view)
    arrays = float_arrays(seen)
    rasterizer = ViewRasterizer(arrays, cameras, view, for_gradients=True)
    image, _ = rasterizer.draw(np.array(scene.background, np.float32))
    difference = np.clip(image, 0, 1) - target
    if mask is not None:
        difference *= mask[:, :, None]
    error = float(np.mean(np.square(difference, dtype=np.float64)))
    d_image = difference * np.float32(2 / (difference.size * max(error if divisor is None else divisor, MIN_ERROR)))
    means, quats, scales, opacities, colors, _ = rasterizer.gradients(arrays, image, d_image)
    if scene.antialiased:
        opacities = opacities * (seen.opacities / np.maximum(plain.opacities, np.float32(1e-12)))
    sh = harmonic_gradient(splats, seen, cameras.centers[view], colors)
    return error, Gradients(means, quats, scales, opacities, sh)


class _Adam:
    """The Adam optimiser, with learning rates that differ between Gaussians.

    Args:
        rate_factors: For each Gaussian, factor on the learning rates of all its parameters.
    """

    def __init__(self, rate_factors: Float[np.ndarray, "N"]) -> None:
        self._rate_factors = rate_factors
        self._moments: dict[str, tuple[np.ndarray, np.ndarray]] = {}
        self._num_steps = 0

    def update(self, trained: dict[str, np.ndarray], gradients: dict[str, np.ndarray], rate: float) -> None:
        """Performs one step of the Adam optimiser on the trained arrays, in place.

        Args:
            trained: Parameter arrays of the Gaussians, by name; changed in place.
            gradients: Gradient of the loss with respect to each array, by the same names.
            rate: Factor on all learning rates.
        """
        # The learning rates are those of `RATES`, times `rate` and the factor of the Gaussian.
        self._num_steps += 1
        root = math.sqrt(1 - BETA2**self._num_steps)

        for name, values in trained.items():
            if name not in self._moments:
                self._moments[name] = np.zeros_like(values), np.zeros_like(values)
            step_size = RATES[name] * rate / (1 - BETA1**self._num_steps)
            constants = [np.float32(number) for number in (step_size, 1 / root, BETA1, BETA2, EPSILON)]

            def change(
                rows: slice, name: str = name, values: np.ndarray = values, constants: list[np.float32] = constants
            ) -> None:
                gradient = np.ascontiguousarray(gradients[name][rows], np.float32)
                steps = np.zeros_like(gradient)
                flat = [array.reshape(-1) for array in (steps, gradient, *(each[rows] for each in self._moments[name]))]
                update_run(*flat, 0, steps.size, *constants)
                values[rows] += self._rate_factors[rows].reshape(-1, *[1] * (values.ndim - 1)) * steps

            map_slices(len(values), change)

    def reset_first_moments(self) -> None:
        """Sets the first moments to 0, so that earlier gradients no longer move the parameters."""
        for first, _ in self._moments.values():
            first[:] = 0


def _add(values: Float[np.ndarray, "N K 3"], more: Float[np.ndarray, "N K 3"]) -> None:
    """Adds `more` to `values` in place, in parallel threads."""

    def add(rows: slice) -> None:
        values[rows] += more[rows]

    map_slices(len(values), add)


def _rate_factors(coding: SplatCoding) -> Float32[np.ndarray, "N"]:
    """Returns a factor on each Gaussian's optimiser steps, larger for Gaussians with coarser quantisation."""
    # Class 0 is the coarsest. Pictures are about equally sensitive to a quantisation step of any Gaussian. Optimiser
    # steps that are equal for all Gaussians would be too large for the sensitive ones, and too small for the others.
    # The geometric mean of the factors is 1.
    classes = coding.precision_classes.astype(np.float64)
    return np.exp2(classes.mean() - classes).astype(np.float32)


def _sample_cameras(cameras: Cameras, seed: int) -> Cameras:
    """Selects cameras at random, and reduces their image size, to measure the class offset of each Gaussian."""
    # The default views for this measurement only look inwards. They would give the surroundings of a scene the
    # coarsest quantisation.
    views = np.random.Generator(np.random.PCG64([seed, 2])).permutation(cameras.num_views)[:MEASURED_VIEWS]
    chosen = cameras.select(sorted(views.tolist()))
    return chosen.scaled(min(1.0, MEASURED_SIZE / max(chosen.width, chosen.height)))


def _sampled_loss(
    scene: SplatScene, splats: Splats, coding: SplatCoding, pictures: Pictures, options: FineTuning
) -> SampledLoss:
    """Creates the object that measures the training loss during fine-tuning, with random views and packet losses.

    The loss is relative to the errors of the given Gaussians after rounding.

    Args:
        scene: The scene.
        splats: The Gaussians at the start, before rounding.
        coding: Quantisation steps of the Gaussians.
        pictures: All pictures of the fine-tuning.
        options: Options with the loss model and the random seed.
    """
    # Its random views and packet losses differ from those of the iterations.
    rounded, receptions = round_splats(splats, coding), list[SimulatedReception]()
    rng = np.random.Generator(np.random.PCG64([options.seed, 1]))
    if options.packet_loss is not None:
        division = divide_into_packets(replace(scene, splats=rounded, coding=coding), options.packetization)
        sampled = [simulate_reception(division, options, rng) for _ in range(_CHECKED_RECEPTIONS)]
        receptions = [reception for reception in sampled if reception is not None]
    return SampledLoss.create(scene, rounded, pictures, receptions, MIN_ERROR, rng)


def _decay(share: float) -> float:
    return FINAL_RATE_RATIO + (1 - FINAL_RATE_RATIO) * 0.5 * (1 + math.cos(math.pi * share))


def _shuffled(count: int, rng: np.random.Generator) -> Iterator[int]:
    """Yields the indices 0 to `count - 1` of views, endlessly, in a new random order in each round."""
    while True:
        yield from rng.permutation(count).tolist()
