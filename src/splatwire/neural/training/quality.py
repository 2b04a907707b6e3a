"""Measurement of picture quality on test views during training."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from splatwire.data import Dataset
from splatwire.metrics import psnr, ssim
from splatwire.ops.arrays import to_numpy
from splatwire.render.base import Renderer
from splatwire.render.render import iterate_views
from splatwire.reprs import summary_repr
from splatwire.types.scene import Scene


@dataclass(frozen=True, eq=False)
class QualityReport:
    """Quality of rendered test views; the scene is rendered without encoding it first.

    Attributes:
        iteration: Iteration of the test.
        psnr: Mean PSNR over the views, decibels.
        ssim: Mean SSIM over the views.
        num_views: Number of views drawn.
        preview: Photo and picture of the first view, side by side.
    """

    iteration: int
    psnr: float
    ssim: float
    num_views: int
    preview: Float[np.ndarray, "H W2 3"]

    __repr__ = summary_repr


def assess_scene(
    scene: Scene, dataset: Dataset, num_views: int, iteration: int, renderer: str | Renderer = "cpu"
) -> QualityReport:
    """Renders evenly spaced views of a dataset and compares the pictures with the photos.

    Args:
        scene: The scene.
        dataset: Test views.
        num_views: Maximum number of views.
        iteration: Number of the iteration, for the report.
        renderer: The renderer, or the name of a renderer.
    """
    count = min(num_views, dataset.num_views)
    views = [i * dataset.num_views // count for i in range(count)]
    chosen = dataset.select(views)
    background = np.array(dataset.background)
    scores: list[tuple[float, float]] = []
    preview = None
    for i, drawn in enumerate(iterate_views(scene, chosen.cameras, renderer=renderer, background=background)):
        photo, image = to_numpy(chosen.image(i)), drawn
        mask = chosen.mask(i)
        compared = (image[None], photo[None], None if mask is None else mask[None])
        scores.append((float(psnr(*compared)[0]), float(ssim(*compared)[0])))
        if preview is None:
            preview = np.concatenate([photo, image], axis=1)
    assert preview is not None
    means = np.mean(scores, axis=0)
    return QualityReport(iteration, float(means[0]), float(means[1]), count, preview)
