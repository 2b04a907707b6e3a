"""Content of a file of explicit Gaussians: the Gaussians and scene properties."""

import logging
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from splatwire.arguments import CheckedFields
from splatwire.types.metadata import NO_METADATA, SceneMetadata
from splatwire.types.origin import NO_ORIGIN, Origin, choose_origin, choose_origin_of_small, describe_origin
from splatwire.types.splats import Splats

LOG = logging.getLogger(__name__)
_VISIBLE = 0.5
"""Ratio of the step of rounded positions to the median size of Gaussians above which rounding is visible."""
_MIN_ROUNDED_SHARE, _SAMPLE = 0.05, 1 << 16
"""Minimum share of visibly rounded Gaussians for a warning, and maximum number of Gaussians that are examined."""
_MAX_HELD = 1 << 20
"""Maximum number of transparent Gaussians of frames that are held until a frame is visible."""
Content = TypeVar("Content", bound="FileContent")


@dataclass(frozen=True, eq=False)
class FileContent(CheckedFields):
    """Gaussians and scene properties in a file.

    Attributes:
        splats: The Gaussians; positions are relative to `origin`.
        origin: World coordinates of the point that positions are relative to.
        antialiased: True if the file declares that the scene was trained with antialiased rendering (Mip-Splatting).
        metadata: Metadata of the scene; the initial view is relative to `origin`.
    """

    splats: Splats
    origin: Origin = NO_ORIGIN
    antialiased: bool = False
    metadata: SceneMetadata = NO_METADATA

    @property
    def is_visible(self) -> bool:
        """True if at least one Gaussian is not transparent."""
        return bool((self.splats.opacities > 0).any())

    def relative_to(self: Content, origin: Origin) -> Content:
        """Returns the same Gaussians and metadata with positions relative to another origin."""
        return replace(
            self,
            splats=self.splats.moved_origin(self.origin, origin),
            origin=origin,
            metadata=self.metadata.moved_origin(self.origin, origin),
        )

    def with_chosen_origin(self: Content) -> Content:
        """Chooses an origin near the Gaussians, and returns the content with positions relative to this origin.

        Content is returned unchanged if its positions are near 0, or if it already has an origin.
        """
        if self.origin != NO_ORIGIN:
            return self
        return self.relative_to(choose_origin(self.splats.means, low_thresholds=False))


def relative_to_first(frames: Iterable[Content]) -> Iterator[Content]:
    """Yields the frames of a sequence with positions relative to the origin of the first visible frame.

    Empty frames before it are held until it is known; of many transparent Gaussians, those of the first frame choose
    the origin.
    """
    origin, held, num_held = None, list[Content](), 0
    for frame in frames:
        if origin is None:
            held.append(frame)
            num_held += frame.splats.num_gaussians
            if not frame.is_visible and num_held <= _MAX_HELD:
                continue
            origin = (frame if frame.is_visible else held[0]).origin
            yield from (each.relative_to(origin) for each in held)
            held.clear()
        else:
            yield frame.relative_to(origin)
    yield from (frame.relative_to(held[0].origin) for frame in held)


def origin_of_placed(parts: Sequence[tuple[Splats, np.ndarray, np.ndarray]]) -> Origin:
    """Chooses an origin for Gaussians whose local coordinates are transformed to world coordinates.

    World coordinates relative to the origin are small, so that float32 stores them precisely. The result is `NO_ORIGIN`
    if the Gaussians are near 0 anyway.

    Args:
        parts: Gaussians in local coordinates, and the transform of each part to the world: matrix (3, 3) and shift (3),
            float64.
    """
    shifts = np.array([shift for _, _, shift in parts]).reshape(-1, 3)
    origin = choose_origin(shifts, low_thresholds=False)
    if origin != NO_ORIGIN or not shifts.any():
        return origin
    samples = [
        part.means[:: max(1, len(parts) * part.num_gaussians // _SAMPLE)].astype(np.float64) @ matrix.T + shift
        for part, matrix, shift in parts
    ]
    return choose_origin_of_small(np.concatenate(samples))


def warn_of_rounded_positions(path: Path, splats: Splats, origin: Origin) -> None:
    """Logs a warning if positions in a file are visibly rounded, because they are float32 and far from 0.

    Args:
        path: The file.
        splats: The Gaussians, relative to the origin.
        origin: Origin near the Gaussians; it was subtracted from the positions in the file.
    """
    if origin == NO_ORIGIN:
        return
    step = float(np.spacing(np.float32(np.abs(origin).max())))
    sizes = splats.scales[np.isfinite(splats.scales)]
    if len(sizes) and step > _VISIBLE * float(np.median(sizes)):
        LOG.warning(
            "%s: positions are float32 and up to %.6g from 0, where they have steps of %.2g, and the median size of "
            "Gaussians is %.2g: the file has lost precision; write float64, or subtract a point near the scene first",
            path, float(np.abs(origin).max()), step, float(np.median(sizes)),
        )  # fmt: skip


def coarse_positions(splats: Splats) -> tuple[float, float, float] | None:
    """Finds Gaussians so far from the scene's origin that rounding their positions to float32 is visible.

    Args:
        splats: The Gaussians, relative to the origin.

    Returns:
        Three numbers about these Gaussians: their share of all Gaussians, 0 to 1; their largest distance from the
        origin, world units; and the largest rounding step of their positions, world units. None if only few Gaussians
        are affected.
    """
    sample = slice(None, None, max(1, -(-splats.num_gaussians // _SAMPLE)))
    distances, sizes = np.abs(splats.means[sample]).max(axis=1), splats.scales[sample].max(axis=1)
    with np.errstate(invalid="ignore"):
        steps = np.spacing(distances.astype(np.float32))
        rounded = np.isfinite(distances) & (sizes > 0) & (steps > _VISIBLE * sizes)
    share = float(rounded.mean()) if len(rounded) else 0.0
    if share <= _MIN_ROUNDED_SHARE:
        return None
    return share, float(distances[rounded].max()), float(steps[rounded].max())


def warn_of_distant_sites(path: Path, splats: Splats, origin: Origin) -> None:
    """Logs a warning if many Gaussians are so far from the origin that rounding to float32 visibly moves them.

    If the whole scene is far from the origin, the file has lost precision. If only parts are, the scene has several
    distant sites, which need separate files.

    Args:
        path: The file.
        splats: The Gaussians, relative to the origin.
        origin: World coordinates of the point that positions are relative to.
    """
    if (coarse := coarse_positions(splats)) is None:
        return
    share, farthest, step = coarse
    if choose_origin_of_small(splats.means) != NO_ORIGIN:
        LOG.warning(
            "%s: positions are float32 and up to %.6g from 0, where they have steps of up to %.2g, more than half the "
            "size of %.3g %% of the Gaussians: the file has lost precision; write float64, or subtract a point near "
            "the scene first", path, farthest, step, 100 * share,
        )  # fmt: skip
    else:
        LOG.warning(
            "%s: %.3g %% of the Gaussians are up to %.6g from the scene's origin (%s), where positions have steps of "
            "up to %.2g, more than half of their size: split the sites into files",
            path, 100 * share, farthest, describe_origin(origin), step,
        )  # fmt: skip
