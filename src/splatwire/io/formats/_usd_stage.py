"""Reads an opened OpenUSD scene in the present process: its visible Gaussians, frames and metadata.

This module is only used in a subprocess with limits on memory and time, because usd-core may crash or never finish if a
file is damaged.
"""

import itertools
import json
import logging
import math
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Tf, Usd, UsdGeom, UsdUtils, UsdVol

from splatwire.errors import MALFORMED, DatasetError
from splatwire.io.formats._asset import metadata_of_asset
from splatwire.io.formats._axes import SPZ_FLIPS, is_similarity, transform_splats
from splatwire.io.formats._axes import flip_axes as flipped
from splatwire.io.formats._columns import MAX_GAUSSIANS, build_splats, check_count, concatenate, warn_of_logits
from splatwire.io.formats._usd_files import checked_layers
from splatwire.io.formats._usd_limits import Limits
from splatwire.io.formats.content import FileContent, origin_of_placed
from splatwire.ops.spherical_harmonics import MAX_DEGREE, num_functions
from splatwire.types.metadata import SceneMetadata
from splatwire.types.origin import NO_ORIGIN, Origin
from splatwire.types.splats import Splats

LOG = logging.getLogger(__name__)
PRIM = "ParticleField3DGaussianSplat"
_COEFFICIENTS, _DEGREE = "radiance:sphericalHarmonicsCoefficients", "radiance:sphericalHarmonicsDegree"
_MAX_READ = 4
"""Maximum degree of harmonics in accepted files; harmonics above `MAX_DEGREE` are left out."""
_ARRAYS = {"positions": 3, "orientations": 4, "scales": 3, "opacities": 1, _COEFFICIENTS: 3}
"""Array attributes of a prim and the numbers of each entry; each may have the type half, with `h` after its name."""
_PROJECTION, _PERSPECTIVE = "projectionModeHint", "perspective"
_HARMLESS = (
    *(_PROJECTION, "sortingModeHint", "extent", "extentsHint", "visibility", "purpose", "colorSpace:name"),
    *("doubleSided", "orientation"),
)
_HARMLESS_SPACES = ("xformOp", "primvars:displayColor", "ui:", "userProperties:", "semantic:", "semantics:")
"""Names of other attributes that have no effect here or are read elsewhere, and beginnings of such names."""
OWN = "splatwire"
"""Key of the layer's custom data with metadata and axes: JSON with an `asset` object as in glTF, and `flips`."""
_STAND_INS = (UsdGeom.Tokens.guide, UsdGeom.Tokens.proxy)
"""Purposes of prims that a picture of the scene does not show."""
_LINEAR = re.compile(r"lin_|linear", re.IGNORECASE)
"""Pattern of names of linear colour spaces."""
KEPT_AXES = (1.0, 1.0, 1.0)
MAX_FRAMES = 20_000
"""Maximum number of frames that are read."""


@contextmanager
def as_dataset_errors(path: Path) -> Iterator[None]:
    """Context manager that converts errors of usd-core to DatasetError.

    Args:
        path: The scene, for messages.
    """
    try:
        yield
    except (Tf.ErrorException, UnicodeDecodeError) as error:
        raise DatasetError(f"{path}: usd-core cannot read it: {reason(error)}") from error


def _opened_stage(path: Path, unread: list[str]) -> Usd.Stage:
    """Opens a stage, and logs the warnings of usd-core instead of letting usd-core print them.

    Args:
        path: The scene.
        unread: Paths of unreadable files for which a warning was already logged.

    Raises:
        Tf.ErrorException: If usd-core cannot open the scene.
    """
    printed = UsdUtils.CoalescingDiagnosticDelegate()  # as long as it exists, usd-core prints nothing
    stage = Usd.Stage.Open(str(path))
    texts = [diagnostic.commentary for diagnostic in printed.TakeUncoalescedDiagnostics()]
    for text in dict.fromkeys(text.partition(" (instantiating stage on ")[0] for text in texts):
        if not any(f"@{name}@" in text for name in unread):
            LOG.warning("%s: usd-core: %.300s", path, text)
    return stage


class Stage:
    """An opened OpenUSD scene (stage), with its visible prims that contain Gaussians.

    Args:
        path: Path of the scene file.
        limits: Limits on the memory and time of the current process. Each file of the scene raises the limits before it
            is read. The Gaussians that are read also raise the limits.

    Raises:
        DatasetError: If usd-core cannot open the file, no prim with Gaussians is visible, or a point instancer draws
            such a prim repeatedly, which is not supported.
    """

    def __init__(self, path: Path, limits: Limits) -> None:
        self._path, self._limits = path, limits
        try:
            self._layers, unread = checked_layers(path, limits.add_file)
            self._stage = _opened_stage(path, unread)
        except Tf.ErrorException as error:
            raise DatasetError(f"{path}: usd-core cannot open it: {reason(error)}") from error
        everything = list(Usd.PrimRange(self._stage.GetPseudoRoot(), Usd.TraverseInstanceProxies()))
        gaussians = [prim for prim in everything if prim.GetTypeName() == PRIM]
        visible = [prim for prim in gaussians if any(_is_visible(prim, time) for time in _visibility_times(prim))]
        if not visible:
            raise DatasetError(f"{path}: no visible prim of the type {PRIM}")
        self._prims = [prim for prim in visible if UsdGeom.Imageable(prim).ComputePurpose() not in _STAND_INS]
        self._prims = self._prims or visible
        self._num_stand_ins = len(visible) - len(self._prims)
        self._num_others = sum(prim.IsA(UsdVol.ParticleField) and prim.GetTypeName() != PRIM for prim in everything)
        for prim in everything:
            if prim.IsA(UsdGeom.PointInstancer):
                for target in UsdGeom.PointInstancer(prim).GetPrototypesRel().GetForwardedTargets():
                    if any(one.GetPath().HasPrefix(target) for one in self._prims):
                        raise DatasetError(f"{path}: {prim.GetPath()} repeats Gaussians, which is not read")

    def warn_of_left_out(self) -> None:
        """Logs warnings about ignored prims and attributes, and about linear colours, which are read as sRGB."""
        if self._num_stand_ins:
            LOG.warning("%s: %d prims with the purpose guide or proxy are left out", self._path, self._num_stand_ins)
        if self._num_others:
            LOG.warning("%s: %d particle fields that are no %s are left out", self._path, self._num_others, PRIM)
        if unknown := sorted({name for prim in self._prims for name in _unknown_attributes(prim)}):
            LOG.warning(
                "%s: attributes %s of Gaussians are not known: the scene may look different",
                self._path, ", ".join(unknown)[:120],
            )  # fmt: skip
        spaces = {str(Usd.ColorSpaceAPI.ComputeColorSpaceName(prim, None)) for prim in self._prims}
        if linear := sorted(name for name in spaces if _LINEAR.match(name)):
            LOG.warning(
                "%s: its colours are linear (%s): they are read as sRGB and may look too dark", self._path, linear[0]
            )

    def warn_of_motion(self) -> None:
        """Logs a warning if the transform or visibility of Gaussians changes over time; the first value is used."""
        if later := sum(not _is_visible(prim, Usd.TimeCode.EarliestTime()) for prim in self._prims):
            LOG.warning("%s: %d prims that are invisible at first and appear later are left out", self._path, later)
        above = [prim for one in self._prims for prim in (one, *_ancestors(one))]
        if any(
            UsdGeom.Xformable(prim).TransformMightBeTimeVarying()
            or (UsdGeom.Imageable(prim) and UsdGeom.Imageable(prim).GetVisibilityAttr().ValueMightBeTimeVarying())
            for prim in above
            if UsdGeom.Xformable(prim)
        ):
            LOG.warning("%s: animations of transforms and visibility are left out", self._path)

    def frames(self) -> tuple[list[float], float] | None:
        """Returns the frames of a moving OpenUSD scene.

        Returns:
            Time codes of the frames, ascending, and frames per second. None for a still scene, whose Gaussians have
            values at fewer than two times.

        Raises:
            DatasetError: If there are too many frames, or their rate is not a number above 0.
        """
        times = {
            time
            for prim in self._prims
            for name in _ARRAYS
            if (attribute := _attribute(prim, name)) is not None
            for time in attribute.GetTimeSamples()
        }
        ordered = sorted(times)
        if len(ordered) < 2:
            return None
        step = min(after - before for before, after in itertools.pairwise(ordered))
        rate = self._stage.GetTimeCodesPerSecond() / step
        if len(ordered) > MAX_FRAMES or not 0 < rate < math.inf:
            raise DatasetError(f"{self._path}: {len(ordered):,} frames at {rate:g} per second are out of range")
        return ordered, rate

    def content(self, time: Usd.TimeCode, *, may_be_empty: bool = False) -> FileContent:
        """Returns the Gaussians at a time, with transforms applied, and the metadata.

        Args:
            time: Time of the values.
            may_be_empty: True if there may be no Gaussian at that time.
        """
        try:
            parts, count, vanished = [], 0, 0
            for prim in self._prims:  # a file may refer to the same prim any number of times
                if not _is_visible(prim, time):
                    continue
                placement = self._placement(prim, time)
                if not placement[:3, :3].any():
                    vanished += 1
                    continue
                splats = self._splats(prim, time)
                parts.append((splats, placement))
                count += splats.num_gaussians
                if count:
                    check_count(self._path, count, self._limits.file_bytes)
                self._limits.add_gaussians(sum(getattr(splats, field.name).nbytes for field in fields(splats)))
        except (Tf.ErrorException, *MALFORMED) as error:
            raise DatasetError(f"{self._path}: {first_line(error)}") from error
        if not parts and not may_be_empty:
            why = "are scaled to nothing or appear later" if vanished else "appear later"
            raise DatasetError(f"{self._path}: its {len(self._prims):,} prims of the type {PRIM} {why}")
        if vanished and not may_be_empty:
            LOG.warning("%s: %d prims that are scaled to nothing are left out", self._path, vanished)
        if not count and not may_be_empty:
            check_count(self._path, count, self._limits.file_bytes)
        flips, own_axes = self._axes()
        if not all(np.isfinite(placement).all() for _, placement in parts):
            raise DatasetError(f"{self._path}: a transform of its Gaussians is not finite")
        if any(splats.degree and not is_similarity(placement[:3, :3]) for splats, placement in parts):
            LOG.warning(
                "%s: transforms stretch Gaussians: their shape follows, and their harmonics only turn", self._path
            )
        signs = np.diag(flips)
        origin = origin_of_placed(
            [(one, signs @ part_placement[:3, :3], signs @ part_placement[:3, 3]) for one, part_placement in parts]
        )
        moved = [_transformed(splats, placement, flips, origin) for splats, placement in parts]
        metadata = metadata_of_asset(own_axes.get("asset"), self._path)
        if metadata.up is None and flips == KEPT_AXES:
            metadata = SceneMetadata(up=UsdGeom.GetStageUpAxis(self._stage).lower()).over(metadata)
        splats = concatenate(moved) if moved else Splats.empty(0, 0)
        return FileContent(splats, origin, metadata=metadata.moved_origin(NO_ORIGIN, origin))

    def _axes(self) -> tuple[tuple[float, float, float], dict[str, Any]]:
        """Returns the conversion from the axes of the stage to the axes of a PLY, and the metadata of the stage.

        Returns:
            Signs of x, y and z to apply to positions; and metadata as a JSON object.
        """
        try:
            data = self._stage.GetRootLayer().customLayerData.get(OWN)
        except (Tf.ErrorException, *MALFORMED) as error:
            raise DatasetError(f"{self._path}: its metadata are damaged: {first_line(error)}") from error
        try:
            stored = json.loads(data) if isinstance(data, str) else {}
        except (ValueError, RecursionError):
            stored = {}
        stored = stored if isinstance(stored, dict) else {}
        if stored.get("flips") in (list(KEPT_AXES), list(SPZ_FLIPS)):
            return tuple(stored["flips"]), stored
        return (SPZ_FLIPS if UsdGeom.GetStageUpAxis(self._stage) == UsdGeom.Tokens.y else KEPT_AXES), stored

    def _placement(self, prim: Usd.Prim, time: Usd.TimeCode) -> np.ndarray:
        """Returns the transform of a prim to world coordinates, float64 (4, 4), for column vectors."""
        return np.array(UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(time), np.float64).T

    def _splats(self, prim: Usd.Prim, time: Usd.TimeCode) -> Splats:
        """Returns the Gaussians of a prim in its own coordinates."""
        arrays = {name: self._array(prim, name, width, time) for name, width in _ARRAYS.items()}
        count = len(arrays["positions"])
        degree = prim.GetAttribute(_DEGREE).Get(time)
        if not isinstance(degree, int) or not 0 <= degree <= _MAX_READ:
            raise DatasetError(f"{self._path}: {prim.GetPath()}: harmonics of degree {degree}, not 0 to {_MAX_READ}")
        functions = (degree + 1) ** 2
        if len(arrays[_COEFFICIENTS]) != count * functions:
            raise DatasetError(
                f"{self._path}: {prim.GetPath()}: {len(arrays[_COEFFICIENTS]):,} coefficients for {count:,} Gaussians "
                f"of degree {degree}, which have {functions} each"
            )
        if degree > MAX_DEGREE:
            LOG.warning(
                "%s: %s: harmonics of degree %d are read up to degree %d: the scene may look different",
                self._path, prim.GetPath(), degree, MAX_DEGREE,
            )  # fmt: skip
        warn_of_logits(self._path, arrays["opacities"][:, 0], "OpenUSD")
        return build_splats(
            self._path,
            means=arrays["positions"],
            quats=np.roll(arrays["orientations"], 1, axis=1),
            scales=arrays["scales"],
            opacities=arrays["opacities"][:, 0],
            sh=arrays[_COEFFICIENTS].reshape(count, functions, 3)[:, : num_functions(min(degree, MAX_DEGREE))],
        )

    def _array(self, prim: Usd.Prim, name: str, width: int, time: Usd.TimeCode) -> np.ndarray:
        """Returns an array attribute of a prim, float32 (N, width).

        Args:
            prim: The prim.
            name: Name of the attribute.
            width: Numbers per row.
            time: Time of the values.

        Raises:
            DatasetError: If the attribute is missing, has no value, or has too many rows.
        """
        attribute = _attribute(prim, name)
        if attribute is None:
            raise DatasetError(f"{self._path}: {prim.GetPath()}: has no {name}")
        values = attribute.Get(time)
        if values is None:
            raise DatasetError(f"{self._path}: {prim.GetPath()}: {name} has no value")
        if len(values) > MAX_GAUSSIANS * num_functions(MAX_DEGREE):
            raise DatasetError(f"{self._path}: {prim.GetPath()}: {len(values):,} {name} are too many")
        return np.array(values, np.float32).reshape(len(values), width)


def _ancestors(prim: Usd.Prim) -> Iterator[Usd.Prim]:
    """Yields the ancestors of a prim, from its parent upwards, without the root of the stage."""
    above = prim.GetParent()
    while above and not above.IsPseudoRoot():
        yield above
        above = above.GetParent()


def _unknown_attributes(prim: Usd.Prim) -> list[str]:
    """Returns the names of attributes that are ignored although they may change how a prim looks, for a warning."""
    names = [one.GetName() for one in prim.GetAuthoredAttributes() if one.HasAuthoredValue()]
    known_names = {*_ARRAYS, *(f"{name}h" for name in _ARRAYS), _DEGREE, *_HARMLESS}
    unknown = [name for name in names if name not in known_names and not name.startswith(_HARMLESS_SPACES)]
    if str(prim.GetAttribute(_PROJECTION).Get() or _PERSPECTIVE) != _PERSPECTIVE:
        unknown.append(_PROJECTION)
    return unknown


def _is_visible(prim: Usd.Prim, time: Usd.TimeCode) -> bool:
    return bool(UsdGeom.Imageable(prim).ComputeVisibility(time) != UsdGeom.Tokens.invisible)


def _visibility_times(prim: Usd.Prim) -> list[Usd.TimeCode]:
    """Returns the times at which a scene element (prim) may become visible or invisible, ascending.

    The first entry is always the earliest possible time (`EarliestTime`), even if the file stores no change for it.
    """
    above = (UsdGeom.Imageable(one) for one in (prim, *_ancestors(prim)))
    times = {time for one in above if one for time in one.GetVisibilityAttr().GetTimeSamples()}
    return [Usd.TimeCode.EarliestTime(), *map(Usd.TimeCode, sorted(times))]


def _attribute(prim: Usd.Prim, name: str) -> Usd.Attribute | None:
    """Returns an array attribute of a prim: its float32 variant if it has values, otherwise its float16 variant.

    The name of the float16 variant is `name` with the suffix `h`. The result is None if neither variant has values.
    """
    for each in (name, f"{name}h"):
        attribute = prim.GetAttribute(each)
        if attribute and attribute.HasAuthoredValue():
            return attribute
    return None


def _transformed(splats: Splats, placement: np.ndarray, flips: tuple[float, float, float], origin: Origin) -> Splats:
    """Converts Gaussians from the coordinates of their prim to world coordinates relative to `origin`.

    Args:
        splats: The Gaussians.
        placement: Transform from the prim to the world, float64 (4, 4), for column vectors.
        flips: Signs of x, y and z that convert the axes of the stage to the axes of a PLY.
        origin: World coordinates of the point that the result is relative to, in the axes of a PLY.
    """
    signs = np.diag(flips)
    shift = signs @ placement[:3, 3] - np.array(origin)
    if np.array_equal(placement[:3, :3], np.eye(3)):
        turned = splats if flips == KEPT_AXES else flipped(splats, flips)
        if not shift.any():
            return turned
        return Splats(
            means=(turned.means + shift).astype(np.float32), quats=turned.quats, scales=turned.scales,
            opacities=turned.opacities, sh=turned.sh,
        )  # fmt: skip
    return transform_splats(splats, signs @ placement[:3, :3], shift)


def first_line(error: BaseException) -> str:
    """Returns the first line of the message of an error."""
    lines = [line.strip(" \t'\"") for line in _text_of(error).splitlines() if line.strip(" \t'\"")]
    return next((line for line in lines if not line.startswith(("Error in", "Error:"))), (lines or [repr(error)])[0])


def reason(error: BaseException) -> str:
    """Returns the text of the first error that usd-core reported."""
    match = re.search(r"^\s*Error in .*? : '(.*)'$", _text_of(error), re.MULTILINE)
    return match[1] if match else first_line(error)


def _text_of(error: BaseException) -> str:
    try:
        return str(error)
    except UnicodeDecodeError:  # usd-core quotes the file, which may be damaged
        return "it is damaged"
