"""Pruning and fine-tuning in one step."""

from collections.abc import Callable

import numpy as np

from splatwire.errors import InvalidValueError
from splatwire.finetuning.options import FineTuning
from splatwire.finetuning.pictures import Pictures
from splatwire.finetuning.shares import share_for
from splatwire.finetuning.tune import fine_tune
from splatwire.render.pruning import removal_errors
from splatwire.types import SplatScene

_MEASURED_VIEWS, _MEASURED_SIZE = 80, 280
"""Maximum number of views in which the effect of removing a Gaussian is measured, and their largest side in pixels."""


def prune_and_tune(
    scene: SplatScene,
    pictures: Pictures,
    options: FineTuning = FineTuning(),  # noqa: B008 - frozen
    *,
    share: float | None = None,
    psnr: float | None = None,
    progress: Callable[[str, float], None] = lambda task, share: None,
) -> SplatScene:
    """Removes the Gaussians with the least effect on pictures, and fine-tunes the others.

    Args:
        scene: The complete scene. Gaussians that draw nothing are removed.
        pictures: The pictures to reproduce.
        options: Options of the fine-tuning.
        share: Share of the drawable Gaussians to keep, above 0 and at most 1; None to choose it by `psnr`.
        psnr: PSNR to reach, decibels; None if `share` is given. The share to keep is then estimated by `share_for`. The
            PSNR of the result is not measured.
        progress: Called with the name of the current task and its finished share, 0 to 1.

    Returns:
        The scene with rounded Gaussians and their quantisation steps (see `fine_tune`).

    Raises:
        InvalidValueError: If both or none of `share` and `psnr` are given, the share is out of range, or nothing is
            left.
    """
    if (share is None) == (psnr is None):
        raise InvalidValueError("fine-tuning: give either the share to keep or a PSNR")
    if share is not None and not 0 < share <= 1:
        raise InvalidValueError(f"fine-tuning: a share is above 0 and at most 1, not {share:g}")
    source, cameras = scene.select(np.flatnonzero(scene.drawable)), pictures.cameras
    step = -(-cameras.num_views // _MEASURED_VIEWS)
    seen = cameras.select(list(range(0, cameras.num_views, step)))
    seen = seen.scaled(min(1.0, _MEASURED_SIZE / max(cameras.width, cameras.height)))
    errors = removal_errors(
        source, seen, seed=options.seed, progress=lambda done: progress("measuring Gaussians", done)
    )
    if share is None:
        assert psnr is not None
        share = share_for(source, errors, pictures, psnr, lambda done: progress("pruning", done))
    kept = np.sort(np.argsort(-errors, kind="stable")[: round(share * source.num_elements)])
    return fine_tune(
        source.select(kept), pictures, options,
        lambda report: progress(f"fine-tuning, {report.psnr:.1f} dB", report.iteration / report.iterations),
    )  # fmt: skip
