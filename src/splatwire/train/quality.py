"""How good the pictures of test views are."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from splatwire.data import Dataset
from splatwire.metrics import psnr, ssim
from splatwire.model import AnchorScene
from splatwire.ops.arrays import to_numpy
from splatwire.render.base import Renderer
from splatwire.render.render import iterate_views


@dataclass(frozen=True, eq=False)
class QualityReport:
    """Pictures of test views, not quantised.

    Attributes:
        iteration: When.
        psnr: Mean over the views, decibels.
        ssim: Mean over the views.
        num_views: Views drawn.
        preview: The first view's photo and picture side by side.
    """

    iteration: int
    psnr: float
    ssim: float
    num_views: int
    preview: Float[np.ndarray, "H W2 3"]


def assess_scene(
    scene: AnchorScene, dataset: Dataset, num_views: int, iteration: int, renderer: str | Renderer = "cpu"
) -> QualityReport:
    """Draws the first views of a dataset evenly spread over it, and compares them with the photos.

    Args:
        scene: The scene.
        dataset: Test views.
        num_views: At most so many.
        iteration: For the report.
        renderer: What draws them.
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
