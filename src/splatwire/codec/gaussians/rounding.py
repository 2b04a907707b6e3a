"""Rounds Gaussians to the values that a decoder would obtain, without encoding them."""

import numpy as np

from splatwire.bitstream import PRESETS, PacketPlan
from splatwire.codec.gaussians import _rounding_kernels as kernels
from splatwire.codec.gaussians.attributes import empty_rows, to_sources, to_splats, transform_harmonics
from splatwire.codec.gaussians.blocks import CACHE_GAUSSIANS, to_lattice
from splatwire.codec.gaussians.encoder import scene_transform
from splatwire.codec.gaussians.quality import Quality
from splatwire.codec.gaussians.source_scene import SourceScene
from splatwire.codec.gaussians.tables import flatness_table
from splatwire.ops.threads import parallel_map
from splatwire.types import SplatCoding
from splatwire.types.splats import Splats


def coding_for(splats: Splats, quality: Quality, class_offsets: np.ndarray | None) -> SplatCoding:
    """Returns the quantisation parameters that the encoder would choose for Gaussians.

    Args:
        splats: The Gaussians, at least one.
        quality: Quality setting.
        class_offsets: Precision class of each Gaussian, which selects its quantisation steps: 0 for the finest steps,
            negative for coarser ones; None for the finest steps.
    """
    plan = PacketPlan(PRESETS["paper"], splats.num_gaussians)
    source = SourceScene.of(splats, plan, class_offsets, None, quality)
    transform, precision_classes = scene_transform(source), np.array(source.precision_classes)
    return SplatCoding(
        source.size_log,
        source.lattice_bits,
        source.max_position_shift,
        tuple(source.base_exponents.tolist()),
        transform,
        precision_classes,
    )


def round_splats(splats: Splats, coding: SplatCoding) -> Splats:
    """Rounds Gaussians to the values that a decoder obtains; the Gaussians keep their order.

    Args:
        splats: The Gaussians.
        coding: Quantisation steps from `coding_for`, or those of a decoded scene.

    Returns:
        The rounded Gaussians. The axes of each Gaussian are sorted: its three scales decrease.

    Raises:
        InvalidValueError: If a position exceeds the range of the lattice.
    """
    # Encoding the result with the same steps does not change it, except for a few positions that float32 rounding moves
    # into a neighbouring step.
    base_exponents, width = np.array(coding.base_exponents), 3 * (splats.sh.shape[1] - 1)
    result = Splats.empty(splats.num_gaussians, splats.degree)

    def round_slice(begin: int) -> None:
        end = min(begin + CACHE_GAUSSIANS, splats.num_gaussians)
        part = splats.slice_range(begin, end)
        sources, (rows, harmonics) = to_sources(part, coding.size_log), empty_rows(end - begin, width)
        harmonics[:] = transform_harmonics(part, coding.transform)
        positions = to_lattice(part.means.astype(np.float64), coding.lattice_bits, coding.size_log)
        kernels.round_rows(
            positions, sources.logs, sources.axes, sources.colours,
            coding.precision_classes[begin:end].astype(np.int64), base_exponents, coding.lattice_bits,
            coding.max_position_shift, flatness_table(), harmonics, rows,
        )  # fmt: skip
        corners = np.zeros((end - begin, 3), np.int64)
        result.fill(begin, to_splats(rows, harmonics, corners, coding.lattice_bits, coding.size_log, coding.transform))

    parallel_map(round_slice, range(0, splats.num_gaussians, CACHE_GAUSSIANS))
    return result
