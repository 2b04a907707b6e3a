"""Fine-tuning of Gaussians for a stream of a given size or PSNR."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Int8

from splatwire.anchors.appearance import origin_of
from splatwire.arguments import check_fields
from splatwire.bitstream import Packetization
from splatwire.channel import LossModel
from splatwire.codec.gaussians.quality import Quality
from splatwire.errors import InvalidValueError
from splatwire.finetuning.options import FineTuning
from splatwire.finetuning.pictures import SIZE, VIEWS, Pictures, fitting_cameras, own_pictures
from splatwire.finetuning.tune import Progress, tuned_gaussians
from splatwire.rate_control.views import MIN_CAMERAS, not_held_out
from splatwire.types import Cameras, SplatScene

MAX_GAUSSIANS = 1_000_000
"""Maximum number of Gaussians of a scene to fine-tune. More would need more views than `VIEWS`: the fitted pictures
have 38 million pixels together."""
MAX_PIXELS = 1 << 30
"""Maximum number of pixels of all fitted pictures together. A pixel takes 3 bytes of memory."""
_RANGES = {"iterations": (1, 100_000), "num_views": (2, 10_000), "size": (16, 4096), "seed": (0, (1 << 63) - 1)}
"""Smallest and largest permitted value of each number of `Tuning`."""
_MOVED = 0.3
"""Standard deviation by which copies of given cameras are moved along each axis, relative to the median distance of a
camera from the nearest other one."""


@dataclass(frozen=True)
class Tuning:
    """Options of the fine-tuning of Gaussians by an encoder that aims at a target size or PSNR.

    Attributes:
        iterations: Number of iterations of each fine-tuning, each with one view, 1 to 100,000.
        num_views: Number of fitted views, 2 to 10,000.
        size: Maximum width and height of fitted pictures, pixels, 16 to 4096.
        packet_loss: Loss model of the channel, used in every second iteration; None for no packet losses.
        seed: Random seed for the order of the views, the packet losses and the moved cameras, 0 to 2^63 - 1.

    Raises:
        InvalidValueError: If a value is out of range, or the pictures together are too large.
    """

    # All pictures together have at most `MAX_PIXELS`.

    iterations: int = 600
    num_views: int = VIEWS
    size: int = SIZE
    packet_loss: LossModel | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        check_fields(self)
        for name, (least, most) in _RANGES.items():
            if not least <= getattr(self, name) <= most:
                raise InvalidValueError(f"fine-tuning: {name} is {least:,} to {most:,}, not {getattr(self, name):,}")
        if self.num_views * self.size**2 > MAX_PIXELS:
            raise InvalidValueError(
                f"fine-tuning: {self.num_views:,} views of {self.size:,} x {self.size:,} pixels are more than "
                f"{MAX_PIXELS:,} pixels together"
            )


def check_tunable(scene: SplatScene) -> None:
    """Checks that a scene is not too large for fine-tuning.

    Raises:
        InvalidValueError: If the scene has more than `MAX_GAUSSIANS` Gaussians.
    """
    if scene.num_elements > MAX_GAUSSIANS:
        raise InvalidValueError(
            f"effort best takes at most {MAX_GAUSSIANS:,} Gaussians, and this scene has {scene.num_elements:,}: use "
            f"effort default, or encode parts of the scene"
        )


def fitted_pictures(
    source: SplatScene, cameras: Cameras | None, tuning: Tuning, progress: Callable[[str, float], None]
) -> Pictures:
    """Renders pictures of a complete scene. Fine-tuning then adapts the pruned scene to these pictures.

    Args:
        source: The complete scene.
        cameras: Cameras at typical viewing positions; None for views around the scene.
        tuning: Number of views, image size and seed.
        progress: Called with the name of the current task and its finished share, 0 to 1.
    """
    seen = fitted_cameras(source, cameras, tuning)
    return own_pictures(source, seen, lambda share: progress("drawing pictures", share))


def tuned_to_pictures(
    pruned: SplatScene,
    class_offsets: Int8[np.ndarray, "N"],
    pictures: Pictures,
    quality: Quality,
    packetization: Packetization,
    tuning: Tuning,
    progress: Callable[[str, float], None],
) -> SplatScene:
    """Fine-tunes Gaussians so that their rendering after quantisation matches given pictures.

    Args:
        pruned: The Gaussians to fine-tune.
        class_offsets: Precision class of each Gaussian, which selects its quantisation steps: 0 or more for the finest,
            negative for coarser ones.
        pictures: Pictures of the complete scene.
        quality: Quality setting, which determines the quantisation steps.
        packetization: Way to split the stream into packets, for simulating the packet losses of `tuning.packet_loss`.
        tuning: Options of the fine-tuning.
        progress: Called with the name of the current task and its finished share, 0 to 1.

    Returns:
        The fine-tuned Gaussians, not yet quantised.
    """
    options = FineTuning(
        quality, tuning.iterations, packet_loss=tuning.packet_loss, packetization=packetization, seed=tuning.seed
    )

    def report(state: Progress) -> None:
        progress("fine-tuning", state.iteration / state.iterations)

    return tuned_gaussians(pruned, pictures, options, report, class_offsets).scene


def fitted_cameras(scene: SplatScene, cameras: Cameras | None, tuning: Tuning) -> Cameras:
    """Chooses the views for fine-tuning, disjoint from the views for the reported PSNR.

    Args:
        scene: The scene.
        cameras: Cameras at typical viewing positions; None for views around the scene.
        tuning: Number of views, image size and seed.
    """
    # If cameras are given, all are used except the held-out ones. If they are too few, randomly moved copies are
    # added, so that Gaussians are also fitted to the views between them. With fewer than `MIN_CAMERAS`, cameras
    # are placed around the scene.
    if cameras is None or cameras.num_views < MIN_CAMERAS:
        return fitting_cameras(scene, tuning.num_views, tuning.size)
    usable = not_held_out(cameras.relative_to(origin_of(scene)), tuning.num_views)
    usable = usable.scaled(min(1.0, tuning.size / max(usable.width, usable.height)))
    centers = usable.centers.astype(np.float64)
    away = np.linalg.norm(centers[:, None] - centers[None], axis=2) + np.diag(np.full(len(centers), np.inf))
    rng = np.random.Generator(np.random.PCG64(tuning.seed))
    moved = usable.select([view % usable.num_views for view in range(tuning.num_views)])
    shifts = _MOVED * float(np.median(away.min(axis=1))) * rng.standard_normal((tuning.num_views, 3))
    shifts[: usable.num_views] = 0
    poses = moved.viewmats.copy()
    poses[:, :3, 3] -= np.einsum("vij,vj->vi", poses[:, :3, :3], shifts).astype(np.float32)
    return replace(moved, viewmats=poses, names=tuple(f"fit_{view:03d}" for view in range(tuning.num_views)))
