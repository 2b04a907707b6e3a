"""Choice of the share of Gaussians to keep at a quantisation level (setting of all quantisation steps)."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64, Int64

from splatwire.rate_control.views import SourcePictures
from splatwire.render.closeups import closeup_cameras
from splatwire.render.framing import framing_cameras
from splatwire.render.importance import surrounding_cameras
from splatwire.render.precision import (
    CLOSEUP_WEIGHT,
    FRAMING_WEIGHT,
    MEASURED_CLOSEUPS,
    MEASURED_FRAMINGS,
    MEASURED_VIEWS,
    PART_GAUSSIANS,
    VIEW_SIZE,
    MeasuredGaussians,
    measure_further_removal,
    measure_gaussians,
)
from splatwire.types import Cameras, SplatScene

SHARES = (0.8, 0.5, 0.3, 0.12)
"""Shares of kept Gaussians at which the error of a pruned scene is measured."""
MEASURED_AGAIN = (0.5, 0.3)
"""Shares of kept Gaussians at which the effect of removing each of them is measured again."""
MIN_SHARE = 0.02
"""Minimum share of Gaussians that is kept."""
STEPS = 400
"""Number of shares among which the best one is chosen."""
LEVELS = np.linspace(2.0, 14.0, 25)
"""Levels of quantisation at which the best share is computed; between these levels, the share is interpolated."""
QUANTISED_PSNR, QUANTISED_LEVEL, OCTAVE_DB = 45.0, 7.5, 5.6
"""Typical PSNR at a level of quantisation (`Quality.level`), and its gain per level in decibels. On seven scenes of
which 70 % of the Gaussians were kept, the PSNR against the kept ones was 41.0 to 48.0 dB."""
TRADE = 3.0
"""Error per share of removed Gaussians, relative to the error of quantisation, up to which removing more saves more
bytes than coarser quantisation. Of 1.5, 3, 6, 12 and 24, the value 3 was within 2 % of the fewest bytes at equal PSNR
on `luigi`, `guitar` and `truck`, from 36 to 49 dB."""
_MIN_SLOPE = 0.2
"""Minimum exponent with which the error of a pruned scene grows with the sum of the errors of single Gaussians."""
_SMALLEST = 1e-14
"""Minimum mean squared error, so that logarithms are finite."""


@dataclass(frozen=True, eq=False)
class RemovalViews:
    """Views for measuring the effect of removing Gaussians from a complete or pruned scene.

    Attributes:
        sets: Weight of each set of views, and pictures of the complete scene in these views. Empty if the scene has no
            given cameras and more than `PART_GAUSSIANS` Gaussians: parts of such a scene are measured separately, in
            views of their own (`measure_gaussians`).
    """

    sets: tuple[tuple[float, SourcePictures], ...]

    @staticmethod
    def of(source: SplatScene, cameras: Cameras | None) -> "RemovalViews":
        """Chooses views for measuring the image error that is caused by removing Gaussians.

        Args:
            source: The complete scene.
            cameras: Cameras at typical viewing positions; then they are the only set of views. None to choose three
                sets from the scene: views around it, views that frame it, and views close to its surfaces.
        """
        if cameras is not None:
            return RemovalViews(((1.0, SourcePictures(source, cameras)),))
        if source.num_elements > PART_GAUSSIANS:
            return RemovalViews(())
        around = SourcePictures(source, surrounding_cameras(source, MEASURED_VIEWS, VIEW_SIZE))
        framing = SourcePictures(source, framing_cameras(source, MEASURED_FRAMINGS, VIEW_SIZE))
        close = SourcePictures(source, closeup_cameras(source, MEASURED_CLOSEUPS, VIEW_SIZE))
        return RemovalViews(((1.0, around), (FRAMING_WEIGHT, framing), (CLOSEUP_WEIGHT, close)))

    def measure_complete(self, source: SplatScene) -> MeasuredGaussians:
        """Measures each Gaussian of the complete scene, in all sets of views.

        Args:
            source: The complete scene.
        """
        if not self.sets:
            return measure_gaussians(source)
        around, *others = (pictures.cameras for _, pictures in self.sets)
        framing, closeups = others or (None, None)
        return measure_gaussians(source, around, framing=framing, closeups=closeups)

    def removal(self, pruned: SplatScene) -> Float64[np.ndarray, "N"]:
        """Estimates, for each Gaussian, the increase of the mean squared image error if only this Gaussian is removed.

        Args:
            pruned: Scene of N Gaussians that are left after pruning, possibly fine-tuned.
        """
        # A removal that reduces the error counts as if the scene were complete: such a correction of the measured views
        # makes others worse. With it, guitar lost 2 dB at a quarter of its Gaussians.
        if not self.sets:
            return measure_gaussians(pruned).removal
        own_error, interaction = np.zeros(pruned.num_elements), np.zeros(pruned.num_elements)
        for weight, pictures in self.sets:
            effect = measure_further_removal(pruned, pictures.cameras, pictures.images)
            own_error += weight * effect.own_error
            interaction += weight * effect.interaction
        return own_error + np.maximum(interaction, 0)


@dataclass(frozen=True, eq=False)
class PruningCurve:
    """Image error of a pruned scene as a function of the share of Gaussians that is kept.

    Attributes:
        order: Indices in the scene of its Gaussians, most important first.
        shares: Shares of kept Gaussians, ascending to 1.
        errors: Mean squared image error at each share.
    """

    order: Int64[np.ndarray, "N"]
    shares: Float64[np.ndarray, "S"]
    errors: Float64[np.ndarray, "S"]

    @staticmethod
    def measured(
        scene: SplatScene,
        removal: Float64[np.ndarray, "N"],
        pictures: SourcePictures,
        views: RemovalViews,
        progress: Callable[[float], None] = lambda share: None,
    ) -> "PruningCurve":
        """Measures how the image error of a scene grows if its least important Gaussians are removed.

        The Gaussians are removed in several steps. After some of the steps, the importance of the remaining Gaussians
        is measured again. The importance of a Gaussian grows when similar Gaussians have been removed.

        Args:
            scene: The scene of N Gaussians.
            removal: Importance of each Gaussian at the start: the image error if only this Gaussian is removed from the
                complete scene, from `measure_gaussians`.
            pictures: Renderings of the complete scene, as references for the pruned scene.
            views: Views for measuring importance again.
            progress: Called with the finished share of the work, 0 to 1.
        """
        # The error is measured for a few shares of kept Gaussians (`SHARES`), and interpolated between them. The first
        # Gaussian of a thin part hardly matters, as others cover the same pixels; the last one does. The effect of the
        # remaining Gaussians is therefore measured again between removals.
        count = scene.num_elements
        removal, order = removal.copy(), np.argsort(-removal, kind="stable")
        counts, logs = [_number(share, count) for share in SHARES], []
        for index, (share, kept) in enumerate(zip(SHARES, counts, strict=True)):
            rows = np.sort(order[:kept])
            pruned = scene.select(rows)
            logs.append(np.log(max(10 ** (-pictures.mean_psnr(pruned) / 10), _SMALLEST)))
            if views.sets and share in MEASURED_AGAIN:
                removal[rows] = views.removal(pruned)
                order[:kept] = rows[np.argsort(-removal[rows], kind="stable")]
            progress((index + 1) / len(SHARES))
        sums = np.maximum(np.append(np.cumsum(removal[order[::-1]])[::-1], 0.0), _SMALLEST)
        log_sums = [np.log(sums[kept]) for kept in counts]
        shares = np.linspace(MIN_SHARE, 1.0, STEPS)
        at = np.log(sums[[_number(share, count) for share in shares]])
        # The error of removing several Gaussians is not the sum of their single errors: Gaussians that cover each other
        # have an effect only if all of them are removed. The error is a power of the sum, fitted to the measurements.
        errors = np.exp(_fitted(at, np.array(log_sums), np.array(logs)))
        errors[-1] = 0.0
        return PruningCurve(order, shares, errors)

    def scaled(self, factor: float) -> "PruningCurve":
        """Returns the curve with all errors multiplied by a factor."""
        # The factor accounts for fine-tuning.
        return replace(self, errors=factor * self.errors)

    def error(self, share: float) -> float:
        """Returns the mean squared error of pictures after pruning to a share of the Gaussians."""
        return float(np.interp(share, self.shares, self.errors))

    def share(self, error: float) -> float:
        """Returns the share of Gaussians to keep if pruning may cause a mean squared image error of `error`.

        With any smaller share, the error would exceed `error`.
        """
        errors = np.maximum.accumulate(self.errors[::-1])
        return float(np.interp(error, errors, self.shares[::-1]))

    def best_share(self, quality_level: float) -> float:
        """Returns the best share of Gaussians to keep if the kept ones are encoded with a given quantisation level.

        Two ways to save a byte are compared: pruning more Gaussians, and coarser quantisation. At the best share, both
        add about the same error.

        Args:
            quality_level: Quantisation level (`Quality.level`), the setting of all quantisation steps.

        Returns:
            The share, above 0 and at most 1.
        """
        # The share never decreases with the level.
        quantised = 10 ** (-(QUANTISED_PSNR + OCTAVE_DB * (LEVELS - QUANTISED_LEVEL)) / 10)
        costs = self.errors + TRADE * quantised[:, None] * np.log(self.shares)
        # At the best share, saving a byte costs the same error by more pruning as by coarser quantisation.
        best = self.shares[np.argmin(costs, axis=1)]
        around = np.concatenate([best[:1], best, best[-1:]])
        smooth = (around[:-2] + around[1:-1] + around[2:]) / 3
        return float(np.interp(quality_level, LEVELS, np.maximum.accumulate(smooth)))

    def kept(self, share: float) -> Int64[np.ndarray, "M"]:
        """Returns the indices of the Gaussians to keep, ascending, given their share."""
        return np.sort(self.order[: _number(share, len(self.order))])


def _number(share: float, count: int) -> int:
    return max(round(share * count), 1)


def _fitted(
    arguments: Float64[np.ndarray, "S"], measured: Float64[np.ndarray, "K"], values: Float64[np.ndarray, "K"]
) -> Float64[np.ndarray, "S"]:
    """Fits an increasing curve to a few noisy measurements; returns the values of the curve at given arguments.

    Args:
        arguments: x values at which the curve is evaluated.
        measured: x values of the measurements.
        values: Measured y values.
    """
    # The curve is a parabola between the measured points and a line outside. Its slope is at least `_MIN_SLOPE`,
    # so that stronger pruning never has a smaller error.
    if np.ptp(measured) < 1e-6:  # the removed Gaussians have no effect at all
        return np.full(len(arguments), values.max())
    # Scenes of two or three Gaussians have fewer than three different measurements.
    fit = np.polynomial.Polynomial.fit(measured, values, min(2, len(np.unique(measured)) - 1))
    grid = np.linspace(measured.min(), measured.max(), 65)
    slopes = np.maximum(fit.deriv()((grid[1:] + grid[:-1]) / 2), _MIN_SLOPE)
    curve = np.append(0.0, np.cumsum(slopes * np.diff(grid)))
    curve += float(np.mean(values - np.interp(measured, grid, curve)))
    fitted = np.interp(arguments, grid, curve)
    for end, slope, beyond in ((0, slopes[0], arguments < grid[0]), (-1, slopes[-1], arguments > grid[-1])):
        fitted[beyond] = curve[end] + slope * (arguments[beyond] - grid[end])
    return fitted
