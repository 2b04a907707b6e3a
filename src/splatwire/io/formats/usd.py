"""Reads and writes OpenUSD scenes with Gaussians (prims of the type `ParticleField3DGaussianSplat`), with usd-core.

Sizes are linear; opacities are from 0 to 1. A stage with y up is rotated to the axes of 3DGS (right, down, forward); a
stage with z up keeps its axes. A prim with time samples is a sequence, with one frame for each sample.
"""

import json
import logging
from collections.abc import Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Gf, Sdf, Tf, Usd, UsdGeom, UsdUtils, UsdVol, Vt

from splatwire.errors import DatasetError
from splatwire.files.atomic_write import atomic_output
from splatwire.io.formats._asset import asset_of
from splatwire.io.formats._axes import SPZ_FLIPS
from splatwire.io.formats._axes import flip_axes as flipped
from splatwire.io.formats._columns import join
from splatwire.io.formats._usd_process import FRAMES, SCENE, TIMES, read_in_process
from splatwire.io.formats._usd_stage import KEPT_AXES, OWN, reason
from splatwire.io.formats.content import FileContent, relative_to_first
from splatwire.types.metadata import NO_METADATA, SceneMetadata
from splatwire.types.origin import NO_ORIGIN, Origin
from splatwire.types.splats import Splats

LOG = logging.getLogger(__name__)
_ZIP_SUFFIX = ".usdz"
_STANDARD_DEVIATIONS = 3.0
"""Radius of a Gaussian for the extent of a prim, standard deviations."""


@dataclass(frozen=True)
class UsdFrames:
    """Frames of an OpenUSD scene with time samples.

    Attributes:
        path: The file.
        times: Time codes of the frames, ascending.
        rate: Frames per second.
    """

    path: Path
    times: tuple[float, ...]
    rate: float

    @property
    def num_frames(self) -> int:
        """Number of frames."""
        return len(self.times)

    def read(self) -> Iterator[FileContent]:
        """Reads the frames, one at a time; a frame may be empty.

        Raises:
            DatasetError: If a frame cannot be read, or the file was changed.
        """
        with closing(read_in_process(FRAMES, self.path)) as answers:
            if next(answers) != [list(self.times), self.rate]:
                raise DatasetError(f"{self.path}: was changed while it was read")
            yield from answers


def read_usd(path: Path) -> FileContent:
    """Reads all visible Gaussians of an OpenUSD scene (`.usd`, `.usda`, `.usdc`, `.usdz`), and its metadata.

    Transforms are applied. If the transforms place the scene far from 0, positions are relative to an origin near the
    Gaussians.
    For a sequence, the first frame is read.

    Raises:
        DatasetError: If usd-core cannot open the file, or the Gaussians are missing, incomplete or too many.
    """
    (content,) = read_in_process(SCENE, path)
    assert isinstance(content, FileContent)
    return content


def usd_frames(path: Path) -> UsdFrames | None:
    """Returns the frames of a moving OpenUSD scene; None for a still scene.

    A scene moves if its Gaussians have values at two or more times.

    Raises:
        DatasetError: If usd-core cannot open the file, or its frames are too many or have no valid rate.
    """
    (frames,) = read_in_process(TIMES, path)
    return None if frames is None else UsdFrames(path, tuple(frames[0]), frames[1])


def write_usd(
    parts: Iterable[Splats], path: Path, *, origin: Origin = NO_ORIGIN, metadata: SceneMetadata = NO_METADATA
) -> int:
    """Writes all Gaussians to an OpenUSD file as one prim (arguments as for `write_splats`).

    The suffix of the file name sets the encoding: text (`.usda`), binary (`.usd`, `.usdc`) or a package (`.usdz`).
    """
    splats = join(path, parts)
    writer = _Writer(origin, metadata, splats.degree)
    writer.put(splats, Usd.TimeCode.Default())
    writer.save(path)
    return splats.num_gaussians


def write_usd_frames(frames: Iterable[FileContent], path: Path, rate: float) -> int:
    """Writes a sequence as one prim with a time sample for each frame; returns the number of frames.

    Args:
        frames: Frames, all with the same degree of harmonics. The file gets the origin of the first visible frame, and
            the metadata of the first frame.
        path: The file, written atomically.
        rate: Frames per second.
    """
    writer, count = None, 0
    for count, frame in enumerate(relative_to_first(frames), 1):
        if writer is None:
            writer = _Writer(frame.origin, frame.metadata, frame.splats.degree, rate)
        writer.put(frame.splats, Usd.TimeCode(count - 1))
    if writer is None:
        raise DatasetError(f"{path}: a sequence without frames cannot be written")
    writer.save(path)
    return count


class _Writer:
    """Writer of an OpenUSD scene: a stage in memory with one prim (object) for all Gaussians."""

    def __init__(self, origin: Origin, metadata: SceneMetadata, degree: int, rate: float | None = None) -> None:
        self._rate, self._last = rate, 0.0
        upright = metadata.up in ("y", "z")
        self._flips = KEPT_AXES if upright else SPZ_FLIPS
        self._stage = stage = Usd.Stage.CreateInMemory()
        UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z if metadata.up == "z" else UsdGeom.Tokens.y)
        UsdGeom.SetStageMetersPerUnit(stage, UsdGeom.LinearUnits.meters)
        custom_data = {"asset": asset_of(metadata.moved_origin(origin, NO_ORIGIN)), "flips": self._flips}
        stage.GetRootLayer().customLayerData = {OWN: json.dumps(custom_data)}
        if metadata.title:
            stage.GetRootLayer().documentation = metadata.title
        root = UsdGeom.Xform.Define(stage, "/Scene")
        stage.SetDefaultPrim(root.GetPrim())
        if origin != NO_ORIGIN:
            shift = [flip * value for flip, value in zip(self._flips, origin, strict=True)]
            root.AddTranslateOp(UsdGeom.XformOp.PrecisionDouble).Set(Gf.Vec3d(*shift))
        if rate is not None:
            stage.SetTimeCodesPerSecond(rate)
            stage.SetFramesPerSecond(rate)
            stage.SetStartTimeCode(0)
        self._prim = UsdVol.ParticleField3DGaussianSplat.Define(stage, "/Scene/Gaussians")
        self._prim.CreateRadianceSphericalHarmonicsDegreeAttr(degree)

    def put(self, splats: Splats, time: Usd.TimeCode) -> None:
        """Writes the attributes of the Gaussians of one frame to the stage, as values at `time`."""
        turned, prim = splats if self._flips == KEPT_AXES else flipped(splats, self._flips), self._prim
        prim.CreatePositionsAttr().Set(_vectors(turned.means), time)
        orientations = Vt.QuatfArray.FromNumpy(_contiguous(np.roll(turned.quats, -1, axis=1)))
        prim.CreateOrientationsAttr().Set(orientations, time)
        prim.CreateScalesAttr().Set(_vectors(turned.scales), time)
        prim.CreateOpacitiesAttr().Set(Vt.FloatArray.FromNumpy(_contiguous(turned.opacities)), time)
        prim.CreateRadianceSphericalHarmonicsCoefficientsAttr().Set(_vectors(turned.sh.reshape(-1, 3)), time)
        if turned.num_gaussians:
            reach = _STANDARD_DEVIATIONS * turned.scales.max(axis=1, keepdims=True)
            extent = [(turned.means - reach).min(axis=0), (turned.means + reach).max(axis=0)]
            prim.CreateExtentAttr().Set(_vectors(np.array(extent)), time)
        if not time.IsDefault():
            self._last = time.GetValue()

    def save(self, path: Path) -> None:
        """Writes the OpenUSD stage (scene) to a file, in the format that its suffix sets (see `write_usd`)."""
        if self._rate is not None:
            self._stage.SetEndTimeCode(self._last)
        with atomic_output(path) as target:
            try:
                done = self._export(target, packed=path.suffix.lower() == _ZIP_SUFFIX)
            except Tf.ErrorException as error:  # such as a full disk
                raise DatasetError(f"{path}: usd-core cannot write it: {reason(error)}") from error
            if not done:
                raise DatasetError(f"{path}: usd-core cannot write it")

    def _export(self, target: Path, *, packed: bool) -> bool:
        """Writes the OpenUSD stage (scene) to a file.

        Args:
            target: Path of the file.
            packed: True to write a package (`.usdz`), False for a single layer.

        Returns:
            True if the file was written, False if usd-core reports a failure.
        """
        layer = self._stage.GetRootLayer()
        if not packed:
            return bool(layer.Export(str(target)))
        inside = target.with_name("scene.usdc")
        try:
            return layer.Export(str(inside)) and UsdUtils.CreateNewUsdzPackage(Sdf.AssetPath(str(inside)), str(target))
        finally:
            inside.unlink(missing_ok=True)


def _contiguous(values: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(values, np.float32)


def _vectors(values: np.ndarray) -> Any:
    return Vt.Vec3fArray.FromNumpy(_contiguous(values))
