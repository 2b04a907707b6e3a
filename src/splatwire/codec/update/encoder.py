"""Encodes the difference between a stream and an edited scene: new Gaussians, and a mask of removed ones."""

import hashlib
import logging
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from splatwire.anchors.appearance import as_scene
from splatwire.arguments import array_of, checked_except
from splatwire.bitstream import GAUSSIANS, SceneStream, make_stream
from splatwire.bitstream.limits import UPDATE
from splatwire.bitstream.sections import with_section
from splatwire.codec.decoding import decode_stream
from splatwire.codec.encoding import encode_prepared
from splatwire.codec.gaussians.blocks import Boxes
from splatwire.codec.gaussians.encoder import prepare_splats
from splatwire.codec.gaussians.outliers import pull_in_outliers
from splatwire.codec.gaussians.side_info import SideInfo, write_side_info
from splatwire.codec.gaussians.source_scene import refine_flat_classes, to_precision_classes
from splatwire.codec.schema import Options
from splatwire.codec.update.apply import changed_stream, check_base
from splatwire.codec.update.matching import find_unchanged
from splatwire.codec.update.removed import curve_order, write_removed
from splatwire.codec.update.schema import SCHEMA
from splatwire.codec.update.section import SECTION, UpdateFields, manifest_digest, write_update
from splatwire.errors import InvalidValueError, check_kind
from splatwire.types import SplatCoding
from splatwire.types.background import BLACK
from splatwire.types.metadata import metadata_to_json
from splatwire.types.origin import NO_ORIGIN, describe_origin, misses_positions
from splatwire.types.received_scene import ReceivedScene
from splatwire.types.splat_scene import SplatScene
from splatwire.types.splats import Splats
from splatwire.version import __version__

LOG = logging.getLogger(__name__)


@checked_except("scene")
def encode_update(
    base: SceneStream,
    scene: SplatScene | ReceivedScene[SplatScene] | Splats,
    *,
    class_offsets: np.ndarray | None = None,
    threads: int | None = None,
) -> SceneStream:
    """Encodes the difference between an encoded scene and a new scene, for `apply_update`.

    The changed stream keeps the settings of the old one, such as packetization, quantisation steps and background.

    Args:
        base: The stream of the scene before the change, complete.
        scene: The changed scene, in the same units and coordinates.
        class_offsets: Class offset of each Gaussian of `scene`, integers (M). The
            finest class that `base` contains is 0; coarser classes are negative. None for the finest.
        threads: Number of threads; None for one per processor.

    Returns:
        The update: a stream with the new Gaussians and the mask of removed ones.

    Raises:
        InvalidValueError: If the stream cannot be updated (see `check_base`), or the new scene is empty. Also if the
            new scene has another kind of elements, another degree of spherical harmonics, or positions beyond the range
            of the stream's lattice.
    """
    return encode_change(base, scene, class_offsets, threads).update


def _warn_of_other_metadata(scene: SplatScene, before: SplatScene) -> None:
    """Logs a warning if the metadata of a changed scene differ from those of its stream.

    An update cannot change metadata.

    Args:
        scene: The changed scene.
        before: The scene before the change, decoded from the stream.
    """
    new, old = (metadata_to_json(one.metadata.moved_origin(one.origin, before.origin)) for one in (scene, before))
    other = [
        name
        for name, value in new.items()
        if value != old.get(name) and not (isinstance(value, list) and name in old and np.allclose(value, old[name]))
    ]
    if other:
        LOG.warning(
            "encoding: the changed scene has another %s than its stream: an update keeps those of the stream; encode "
            "the scene as a whole to change them", ", ".join(other),
        )  # fmt: skip


class EncodedChange(NamedTuple):
    """An update, and the changed stream.

    Attributes:
        update: The update.
        result: The changed stream, as `apply_update` returns it.
    """

    update: SceneStream
    result: SceneStream


def encode_change(
    base: SceneStream, scene: SplatScene | ReceivedScene[SplatScene] | Splats, class_offsets: np.ndarray | None = None,
    threads: int | None = None, *, finest: int | None = None,
) -> EncodedChange:  # fmt: skip
    """Encodes the changes of a scene (see `encode_update`), and returns the update together with the changed stream.

    Args:
        base: The complete stream of the scene before the changes.
        scene: The changed scene.
        class_offsets: Class offset of each Gaussian, as for `encode_update`.
        threads: Number of threads, as for `encode_update`.
        finest: Precision class that the class offset 0 selects, as numbered in streams: 0 (the coarsest) to
            `MAX_CLASSES - 1`. An unchanged Gaussian is encoded again if its class in the stream is coarser than
            requested. None for the finest class of `base`; unchanged Gaussians then keep their class.
    """
    info = check_base(base)
    edited = as_scene(scene)
    check_kind(edited, SplatScene, "open_scene")
    assert isinstance(edited, SplatScene)
    if class_offsets is not None:
        class_offsets = array_of(class_offsets, "class_offsets", (edited.num_elements,), "i", -128, 127)
    validity = edited.validity()
    validity.log_removed("encoding", edited.ELEMENTS)
    before = decode_stream(base, threads=threads).scene
    coding = before.coding
    assert coding is not None
    after, kept = edited.splats.moved_origin(edited.origin, before.origin).select(validity.kept), validity.kept
    if not after.num_gaussians:
        raise InvalidValueError("the changed scene has no Gaussian that draws anything")
    if after.degree != before.splats.degree:
        raise InvalidValueError(
            f"the changed scene has spherical harmonics of degree {after.degree}, its stream those of degree "
            f"{before.splats.degree}"
        )
    if edited.antialiased != before.antialiased:
        scenes = ("the changed scene", "its stream")
        marked, plain = scenes if edited.antialiased else scenes[::-1]
        LOG.warning(
            "encoding: %s is antialiased, %s is not: an update keeps what the stream has, and the other one looks "
            "different from afar", marked, plain,
        )  # fmt: skip
    # Streams round colours to float32. Files of other formats have no background, which reads as black.
    if edited.background != BLACK and not np.allclose(edited.background, before.background):
        LOG.warning(
            "encoding: the changed scene has the background colour (%s), its stream (%s): an update keeps that of the "
            "stream; encode the scene as a whole to change it",
            *(", ".join(f"{value:.3g}" for value in one.background) for one in (edited, before)),
        )  # fmt: skip
    if edited.origin != before.origin and (distance := misses_positions(NO_ORIGIN, after.means)) is not None:
        LOG.warning(
            "encoding: the changed scene is %.6g away from the origin of its stream (%s), which an update keeps: "
            "positions are rounded to steps of %.2g; give the scene the coordinates of the stream, or encode it as a "
            "whole", distance, describe_origin(before.origin), float(np.spacing(np.float32(distance))),
        )  # fmt: skip
    _warn_of_other_metadata(edited, before)
    after = pull_in_outliers(after, coding.size_log)
    least = None
    if finest is not None:
        wanted = None if class_offsets is None else class_offsets[kept]
        least = to_precision_classes(wanted, after.num_gaussians, finest)
    match = find_unchanged(before.splats, coding, after, least)
    new_rows = np.flatnonzero(match < 0)
    removed = np.ones(before.num_elements, bool)
    removed[match[match >= 0]] = False
    chosen = None if class_offsets is None else class_offsets[kept][new_rows]
    most = int(coding.precision_classes.max()) if finest is None else finest
    new = _encode_new(base, info, coding, after.select(new_rows), chosen, most, threads)
    result = changed_stream(base, info, before, removed, _decoded(new), new.manifest.writer, threads)
    fields = UpdateFields(
        manifest_digest(base.manifest), manifest_digest(result.manifest), result.manifest.writer,
        write_removed(removed[curve_order(before.splats, coding)]),
    )  # fmt: skip
    return EncodedChange(with_section(new, SECTION, write_update(fields)), result)


def _encode_new(
    base: SceneStream, info: SideInfo, coding: SplatCoding, new: Splats, class_offsets: np.ndarray | None,
    finest_class: int, threads: int | None,
) -> SceneStream:  # fmt: skip
    """Encodes the new Gaussians of an update as a stream, with the quantisation steps of the old stream.

    Args:
        base: The old stream.
        info: Side information of the old stream.
        coding: Quantisation steps of the old stream.
        new: The new Gaussians.
        class_offsets: Class offset of each new Gaussian relative to `finest_class`: 0, or negative for coarser ones.
            None to use `finest_class` for all.
        finest_class: Finest precision class (set of quantisation steps), as numbered in streams: 0 is the coarsest.
        threads: Number of threads; None for one per processor.
    """
    packetization = base.manifest.packetization
    info = replace(info, sections={})
    if not new.num_gaussians:
        return _without_gaussians(base, info)
    levels = refine_flat_classes(
        new,
        to_precision_classes(class_offsets, new.num_gaussians, finest_class),
        finest_class,
        info.base_exponents,
        coding.size_log,
    )
    scene = SplatScene(new, coding=replace(coding, precision_classes=np.array(levels)))
    prepared = prepare_splats(scene, Options(packetization, threads=threads), info)
    return encode_prepared(SCHEMA, prepared, threads, None)


def _without_gaussians(base: SceneStream, info: SideInfo) -> SceneStream:
    """Returns an update without new Gaussians, for a change that only removes Gaussians.

    Args:
        base: The stream to change.
        info: Side information of `base` without named sections. The update copies its parameters.
    """
    none = np.zeros(0, np.int64)
    boxes = Boxes(none, none.reshape(0, 3), none.reshape(0, 3))
    side_info = write_side_info(replace(info, boxes=boxes, block_means=none.reshape(0, 7)))
    return make_stream(
        packetization=base.manifest.packetization, num_elements=0, side_info=side_info, packets=(),
        symbols_digest=hashlib.sha256().hexdigest(), writer=f"splatwire {__version__}", schema_name=UPDATE,
    )  # fmt: skip


def _decoded(new: SceneStream) -> SplatScene:
    """Decodes the Gaussians that an update adds.

    Args:
        new: The update's packets as a stream.
    """
    scene: SplatScene = decode_stream(replace(new, manifest=replace(new.manifest, schema_name=GAUSSIANS))).scene
    return scene
