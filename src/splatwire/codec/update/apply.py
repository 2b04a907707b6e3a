"""Applies an update to a stream of Gaussians; the result is the stream of the changed scene."""

from dataclasses import replace

import numpy as np

from splatwire.arguments import checked
from splatwire.bitstream import GAUSSIANS, SceneStream
from splatwire.bitstream.limits import UPDATE
from splatwire.bitstream.sections import sections_of, with_section
from splatwire.codec.decoding import decode_stream
from splatwire.codec.encoding import encode_prepared
from splatwire.codec.gaussians.copies import SECTION as SKETCH
from splatwire.codec.gaussians.copies import copies_precision_class, read_copies
from splatwire.codec.gaussians.copies_encoder import write_copies
from splatwire.codec.gaussians.decoder import open_side_info
from splatwire.codec.gaussians.encoder import prepare_splats
from splatwire.codec.gaussians.schema import SCHEMA as GAUSSIAN_SCHEMA
from splatwire.codec.gaussians.schema import ranked_by_attributes
from splatwire.codec.gaussians.side_info import SideInfo, write_header
from splatwire.codec.preview import SECTION as PREVIEW
from splatwire.codec.schema import Options
from splatwire.codec.update.removed import curve_order, read_removed
from splatwire.codec.update.section import SECTION, manifest_digest, read_update
from splatwire.errors import BitstreamError, DesyncError, InvalidValueError
from splatwire.types.splat_scene import SplatScene
from splatwire.types.splats import Splats
from splatwire.types.update_scene import UpdateScene


@checked
def apply_update(base: SceneStream, update: SceneStream, *, threads: int | None = None) -> SceneStream:
    """Applies an update to the stream of a scene, and returns the stream of the changed scene.

    Args:
        base: The stream that the update changes, complete.
        update: The update, complete.
        threads: Number of threads; None for one per processor.

    Raises:
        InvalidValueError: If packets of either stream are missing, or the update is for another stream.
        BitstreamError: If either stream is damaged, or the second one is not an update.
        DesyncError: If the result differs from the stream that the encoder made.
    """
    if update.manifest.schema_name != UPDATE:
        raise BitstreamError(f"the second stream has {update.manifest.elements}, it is not an update")
    info = check_base(base)
    _check_complete(update, "the update", "the old stream remains valid")
    received = decode_stream(update, threads=threads)
    change = received.scene
    assert isinstance(change, UpdateScene)
    _check_base(base, change.base_digest)
    scene = decode_stream(base, threads=threads).scene
    if write_header(info) != write_header(open_side_info(update.manifest, update.side_info)):
        raise BitstreamError("the update has other quantisation steps than the stream that it changes")
    assert scene.coding is not None
    removed = np.empty(scene.num_elements, bool)
    removed[curve_order(scene.splats, scene.coding)] = read_removed(change.removed, scene.num_elements)
    if removed.all() and not change.num_elements:
        raise BitstreamError("the update removes all Gaussians")
    result = changed_stream(base, info, scene, removed, change, change.writer, threads)
    # All bytes must be equal to those of the stream that the encoder of the update computed.
    if manifest_digest(result.manifest) != change.result_digest:
        raise DesyncError(
            f"the changed stream is not the one that {change.writer or 'the encoder'} made: get that stream as a whole"
        )
    return result


@checked
def describe_update(base: SceneStream, update: SceneStream) -> dict[str, int]:
    """Returns the numbers of Gaussians that stay (`num_kept`), are removed (`num_removed`), and are new (`num_new`).

    Args:
        base: The stream that the update changes, complete.
        update: The update.

    Raises:
        InvalidValueError: If the update is for another stream.
        BitstreamError: If the update is damaged.
    """
    fields = read_update(sections_of(update).get(SECTION, b""))
    _check_base(base, fields.base_digest)
    removed = int(read_removed(fields.removed, base.manifest.num_elements).sum())
    kept = base.manifest.num_elements - removed
    return {"num_kept": kept, "num_removed": removed, "num_new": update.manifest.num_elements}


def check_base(base: SceneStream) -> SideInfo:
    """Checks that a stream can be updated, and returns the side information of the stream.

    Raises:
        InvalidValueError: If packets are missing, or updates of such a stream are not possible.
        BitstreamError: If the stream is damaged.
    """
    manifest = base.manifest
    if manifest.schema_name != GAUSSIANS:
        raise InvalidValueError(
            f"updates are for streams of explicit Gaussians, not for schema '{manifest.schema_name}'"
        )
    if manifest.tiers:
        raise InvalidValueError("a stream with importance tiers cannot be updated: encode it without --tiers")
    _check_complete(base, "the stream to change", "only a complete stream can be changed")
    info = open_side_info(manifest, base.side_info)
    if info.packet_dependent:
        raise InvalidValueError("an older release encoded the stream to change: encode its scene again")
    return info


def changed_stream(
    base: SceneStream, info: SideInfo, scene: SplatScene, removed: np.ndarray, new: SplatScene, writer: str,
    threads: int | None,
) -> SceneStream:  # fmt: skip
    """Encodes a changed scene with the settings of the old stream.

    Args:
        base: The old stream.
        info: Side information of the old stream.
        scene: The decoded scene of the old stream.
        removed: Mask of the removed Gaussians, bool (N).
        new: The decoded new Gaussians, with the same quantisation steps.
        writer: Program that wrote the changed stream.
        threads: Number of threads; None for one per processor.
    """
    kept = np.flatnonzero(~removed)
    # In an order that does not depend on the packets of the update.
    new = new.select(ranked_by_attributes(new.splats))
    assert scene.coding is not None
    assert new.coding is not None
    splats = _joined(scene.splats.select(kept), new.splats)
    coding = replace(
        scene.coding,
        precision_classes=np.concatenate([scene.coding.precision_classes[kept], new.coding.precision_classes]),
    )
    changed = replace(scene, splats=splats, coding=coding)
    # A preview would show the old scene.
    sections = {name: data for name, data in info.sections.items() if name not in (SKETCH, PREVIEW)}
    options = Options(base.manifest.packetization, threads=threads)
    prepared = prepare_splats(changed, options, replace(info, sections=sections))
    stream = encode_prepared(GAUSSIAN_SCHEMA, prepared, threads, None)
    stream = replace(stream, manifest=replace(stream.manifest, writer=writer))
    return _with_copies(stream, base, info, kept, splats)


def _with_copies(
    stream: SceneStream, base: SceneStream, info: SideInfo, kept_indices: np.ndarray, splats: Splats
) -> SceneStream:
    """Adds the redundant copies of the old stream to a changed stream, except for copies of removed Gaussians.

    Args:
        stream: The changed stream without copies.
        base: The old stream.
        info: Side information of the old stream.
        kept_indices: Indices in the old stream of the Gaussians that stay, ascending.
        splats: Gaussians of the changed scene: first those that stay, then the new ones.
    """
    num_before = base.manifest.num_elements
    if (copies := read_copies(info, num_before)) is None:
        return stream
    chosen = np.flatnonzero(np.isin(kept_indices, copies.indices))
    if not len(chosen):
        return stream
    decoded = decode_stream(stream).scene.splats
    new_index = np.empty(len(decoded.means), np.int64)
    new_index[ranked_by_attributes(splats)] = ranked_by_attributes(decoded)
    stream_info = open_side_info(stream.manifest, stream.side_info)
    level = copies_precision_class(info, num_before)
    data = write_copies(decoded, np.sort(new_index[chosen]), stream_info, precision_class=level, growth=copies.growth)
    return with_section(stream, SKETCH, data)


def _joined(first: Splats, second: Splats) -> Splats:
    return Splats(*(np.concatenate(pair) for pair in zip(vars(first).values(), vars(second).values(), strict=True)))


def _check_base(base: SceneStream, digest: str) -> None:
    """Raises `InvalidValueError` if an update does not apply to a stream.

    Args:
        base: The stream.
        digest: Digest of the stream that the update changes (`manifest_digest`), hexadecimal.
    """
    if digest != (digest_of_base := manifest_digest(base.manifest)):
        raise InvalidValueError(
            f"the update changes another stream: one with the digest {digest[:12]}, not {digest_of_base[:12]}; the "
            "same scene in other packets is another stream, too"
        )


def _check_complete(stream: SceneStream, subject: str, consequence: str) -> None:
    """Raises `InvalidValueError` if a packet of a stream is missing.

    Args:
        stream: The stream.
        subject: Name of the stream, for the error message.
        consequence: Consequence for the user, for the error message.
    """
    if missing := stream.manifest.num_packets - len(stream.packets):
        count = f"{missing:,} of {stream.manifest.num_packets:,} packets of {subject}"
        raise InvalidValueError(f"{count} are missing: {consequence}")
