"""Quality of a scene against a reference."""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from splatwire.arguments import array_of, checked_except
from splatwire.metrics import psnr, ssim
from splatwire.render import Renderer, render_scene
from splatwire.reprs import summary_repr
from splatwire.types import Cameras, ReceivedScene
from splatwire.types.scene import Scene
from splatwire.types.splats import Splats


@dataclass(frozen=True, eq=False)
class Scores:
    """Image quality of each view.

    Attributes:
        psnr: Peak signal-to-noise ratio of each view, decibels; infinite if a view equals its reference.
        ssim: Structural similarity of each view, at most 1.
    """

    psnr: Float[np.ndarray, "C"]
    ssim: Float[np.ndarray, "C"]

    __repr__ = summary_repr


@checked_except("scene", "reference", "cameras", "renderer")
def evaluate(
    scene: Scene | ReceivedScene | Splats,
    reference: Scene | ReceivedScene | Splats | Float[np.ndarray, "C H W 3"] | Sequence[Float[np.ndarray, "H W 3"]],
    cameras: Cameras | str | os.PathLike[str],
    *,
    renderer: str | Renderer = "cpu",
) -> Scores:
    """Compares the pictures of a scene with a reference, view by view.

    Args:
        scene: The scene, e.g. after losses and concealment.
        reference: The scene without losses, or one picture per camera, RGB in [0, 1]: an array of numpy or torch, or a
            list of arrays.
        cameras: Cameras, or the path of a file for `splatwire.data.load_cameras`.
        renderer: A renderer or its name.

    Returns:
        PSNR and SSIM of each view.

    Raises:
        InvalidValueError: If an argument has a wrong type, or the size of pictures differs from that of the cameras.

    Example:
        >>> import splatwire
        >>> from splatwire.data import load_cameras
        >>> received, _ = splatwire.transmit(splatwire.read_stream("scene.swz")[0], "bernoulli:0.2", seed=1)
        >>> seen = splatwire.conceal(splatwire.decode(received), "grow")
        >>> scores = splatwire.evaluate(seen, splatwire.open_scene("scene.swz"), load_cameras("cameras.json"))
        >>> bool((scores.psnr > 15).all())
        True
    """
    images = render_scene(scene, cameras, renderer=renderer)
    wanted: Any = reference
    if isinstance(reference, Sequence) and not isinstance(reference, str | bytes):
        wanted = array_of(reference, "reference", ("C", "H", "W", 3))
    elif not hasattr(reference, "shape"):
        wanted = render_scene(reference, cameras, renderer=renderer)
    return Scores(psnr(images, wanted), ssim(images, wanted))
