"""Comparison of an exported file of explicit Gaussians with the scene of neural anchors that it was made from."""

from collections.abc import Callable
from typing import Any

import numpy as np

from splatwire.data import Dataset
from splatwire.metrics import psnr
from splatwire.render import iterate_views
from splatwire.types import Cameras
from splatwire.types.scene import Scene


def compare_export(
    scene: Scene, written: Scene, cameras: Cameras, photos: Dataset | None, progress: Callable[[str, float], None]
) -> dict[str, Any]:
    """Compares images of the exported Gaussians with images of the original scene, and both with photos if available.

    Args:
        scene: The scene.
        written: The Gaussians of the export.
        cameras: Cameras of the comparison.
        photos: Photos of these cameras, or None.
        progress: Called with the name of the task and its finished share, 0 to 1.

    Returns:
        Mapping with the number of views, `num_views`, and mean PSNR values over the views in decibels. `psnr_to_scene`
        compares the export with the original scene. If there are photos, `psnr_scene` compares the original scene with
        the photos, `psnr_export` compares the export with the photos, and `psnr_loss` is `psnr_scene - psnr_export`.
    """
    background = np.array(scene.background)
    rows = []
    shown = (scene, written)
    pairs = zip(*(iterate_views(drawn, cameras, background=background) for drawn in shown), strict=True)
    for view, (neural, explicit) in enumerate(pairs):
        row = [float(psnr(explicit[None], neural[None])[0])]
        if photos is not None:
            photo, mask = photos.image(view)[None], photos.mask(view)
            masks = None if mask is None else mask[None]
            row += [float(psnr(picture[None], photo, masks)[0]) for picture in (neural, explicit)]
        rows.append(row)
        progress("measuring", (view + 1) / cameras.num_views)
    means = np.mean(rows, axis=0).tolist()
    result: dict[str, Any] = {"num_views": cameras.num_views, "psnr_to_scene": means[0]}
    if photos is not None:
        result |= {"psnr_scene": means[1], "psnr_export": means[2], "psnr_loss": means[1] - means[2]}
    return result
