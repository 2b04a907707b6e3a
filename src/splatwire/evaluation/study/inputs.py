"""Preparation of an evaluation: encoded streams, reference images and loss masks, each computed once."""

import dataclasses
import functools
import logging
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

from splatwire.anchors.appearance import antialiased
from splatwire.anchors.tensor_file import tensor_bytes
from splatwire.bitstream import HACPP_ANCHORS, Packetization, SceneStream, stream_to_bytes
from splatwire.bitstream.limits import SCHEMAS
from splatwire.bitstream.origin import ORIGIN_SECTION
from splatwire.bitstream.sections import sections_of
from splatwire.channel import PacketLossMask, draw_mask
from splatwire.codec import can_repack, decode_stream, encode_scene, repack, schema_of
from splatwire.codec.anchors.hacpp.separated import SECTION as MASKS
from splatwire.codec.antialiasing import SECTION as ANTIALIASED
from splatwire.codec.background import BACKGROUND_SECTION
from splatwire.codec.registry import schema_named
from splatwire.concealment import conceal_if_received, concealer_names, create_concealer
from splatwire.concealment.registry import why_unfit
from splatwire.concealment.temporal.concealers import temporal_concealer_names
from splatwire.data import save_cameras
from splatwire.errors import InvalidValueError, SplatwireError
from splatwire.evaluation.extent import SceneExtent
from splatwire.evaluation.study.decoded import check_decoded, prepare_decoded
from splatwire.evaluation.study.definition import PASSTHROUGH, WEIGHTS, Loss, Row, SceneEntry, Study, canonical
from splatwire.evaluation.study.input_files import InputFiles
from splatwire.evaluation.study.masks import anchor_bytes
from splatwire.evaluation.study.parts import needed_stream, stream_parts, without_sections
from splatwire.evaluation.study.prepared_stream import PreparedStream, file_bytes
from splatwire.evaluation.study.records import CODE
from splatwire.evaluation.study.references import (
    Progress,
    References,
    check_views,
    digest_of,
    digest_of_files,
    prepare_references,
)
from splatwire.evaluation.study.sequences import frame_cameras
from splatwire.evaluation.study.store import Store, read_json
from splatwire.files.names import real_path
from splatwire.io import drawable_scene
from splatwire.io.formats import find_format
from splatwire.io.opening import check_scene_kind, complete_scene, decode_complete
from splatwire.render.importance import surrounding_cameras
from splatwire.render.precision import scene_class_offsets
from splatwire.types import Anchors
from splatwire.types.background import Background
from splatwire.types.scene import Scene

LOG = logging.getLogger(__name__)
_SECTIONS_OF_PICTURES = (BACKGROUND_SECTION.name, ORIGIN_SECTION.name, ANTIALIASED)
"""Names of the sections that determine how and where a scene is drawn."""
AROUND_VIEWS, AROUND_SIZE = 12, 400
"""Number of generated views for scenes without photos and cameras, and their width and height in pixels."""


@dataclass(frozen=True)
class PreparedScene:
    """A scene with its encoded streams, reference images and loss masks, ready for the tasks of an evaluation.

    Attributes:
        entry: Definition of the scene.
        references: The reference images.
        streams: Encoded streams, by name of the stream (`Row.variant`).
        parts: Number of bytes of each part of the data that a method sends. The outer key is the key of the method
            (`Row.key`). The inner key is the name of the part, such as an attribute.
        masks: Loss masks, by name of the stream, loss and seed.
        sections: Names of the additional side information in the scene's streams.
        keeps_sections: True if the sections can be kept when the scene is put into other packets.
        schema_name: Name of the schema; empty if nothing is sent.
    """

    entry: SceneEntry
    references: References
    streams: Mapping[str, PreparedStream]
    parts: Mapping[str, Mapping[str, int]]
    masks: Mapping[tuple[str, Loss, int], PacketLossMask]
    sections: tuple[str, ...]
    keeps_sections: bool
    schema_name: str

    def why_unsupported(self, row: Row) -> str:
        """Returns the reason why a method cannot be evaluated on this scene; an empty text if it can."""
        if row.needs_weights and self.entry.weights is None:
            return "it has no calibrated weights (splatwire calibrate makes them)"
        absent = [name for name in row.sections if name not in self.sections]
        if absent:
            return f"it has no section '{absent[0]}' (splatwire calibrate adds it)"
        is_repacked = row.packetization is not None and not self.references.frames
        if row.sections and is_repacked and not self.keeps_sections:
            return "its sections cannot be kept in other packets (encode without --tiers, and with this release)"
        if row.decoded and row.variant not in self.streams:
            return "no result of this codec is given"
        if row.variant not in self.streams:
            return "only anchors of HAC++ (format 1) can be packed so"
        return self._why_unfit(row) if self.streams[row.variant].num_packets else ""

    def _why_unfit(self, row: Row) -> str:
        """Returns the reason why a method's concealer or ablation does not apply to the scene; else an empty text."""
        # Its concealer may need data that the stream lacks, or it loses single attributes of elements (`Row.erode`).
        # Only streams of anchors have a packet for each attribute.
        name = row.conceal.partition(":")[0]
        if self.references.frames:
            if row.erode is not None:
                return "only anchors lose one attribute alone, and it has tracks"
            is_registered = name in temporal_concealer_names()
            return "" if is_registered else f"concealer '{row.conceal}' is for still scenes, and it is a sequence"
        if name not in concealer_names() and name in temporal_concealer_names():
            return f"concealer '{row.conceal}' is for sequences, and it is a still scene"
        provides = schema_named(self.schema_name).provides
        if row.erode is not None and Anchors not in provides:
            return f"only anchors lose one attribute alone, and it has {self.streams[row.variant].elements}"
        sections = self.sections if row.packetization is None else row.sections
        return why_unfit(row.conceal, provides, sections, row.options)


@dataclass(frozen=True)
class Source:
    """A scene given by the user, which is read on first access.

    Attributes:
        entry: Definition of the scene.
        files: Reader of the scene's files.
    """

    entry: SceneEntry
    files: InputFiles = field(default_factory=InputFiles)

    @cached_property
    def stream(self) -> SceneStream | None:
        """The stream of the scene, if the user gave one; otherwise None."""
        # If `SceneEntry.sections` names a stream with additional side information, it is this one.
        path = self.entry.sections or (self.entry.source if self.entry.kind == "stream" else None)
        if path is None:
            return None
        stream = self.files.stream(path)
        return (
            stream if stream.manifest.schema.timed and self.entry.reference is not None else stream.require_static(path)
        )

    @property
    def timed(self) -> bool:
        """True for a sequence of frames; each frame is then evaluated as one view."""
        return self.stream is not None and self.stream.manifest.schema.timed

    @cached_property
    def scene(self) -> Scene:
        """The complete scene to evaluate; decoded from the stream if the user gave one.

        Raises:
            BitstreamError: If the stream is incomplete.
        """
        if self.entry.sections is not None or self.entry.kind == "stream":
            path = self.entry.sections or self.entry.source
            return decode_complete(self.files.stream(path), path)
        if self.entry.kind == "model":
            return self.files.model(self.entry.source)
        return complete_scene(self.files.loaded_scene(self.entry.source), self.entry.source)

    @property
    def received(self) -> Scene:
        """The scene, without the elements of packets that are missing in the user's stream."""
        if self.stream is not None:
            return conceal_if_received(decode_stream(self.stream), create_concealer("drop"))
        loaded = self.files.loaded_scene(self.entry.source).loaded
        return conceal_if_received(loaded, create_concealer("drop"))

    @property
    def sections(self) -> Mapping[str, bytes]:
        """Named sections of side information in the stream, including sections that `splatwire calibrate` added."""
        return {} if self.stream is None else sections_of(self.stream)

    @property
    def schema_name(self) -> str:
        """Name of the schema of the scene."""
        if self.entry.kind == "model":
            return HACPP_ANCHORS
        return schema_of(self.scene).name if self.stream is None else self.stream.manifest.schema_name

    def can_encode(self, packetization: Packetization) -> bool:
        """Returns True if the scene can be encoded with the packetization."""
        return packetization.universal or SCHEMAS[self.schema_name].separable

    @property
    def keeps_sections(self) -> bool:
        """True if the sections of the stream can be kept when the scene is put into other packets."""
        return self.stream is not None and not self.stream.manifest.tiers and can_repack(self.stream)

    def can_pack(self, row: Row) -> bool:
        """Returns True if a method puts the scene into other packets, and the scene has all that this needs."""
        if row.decoded or row.packetization is None or self.timed:
            return False
        has_sections = not row.sections or (set(row.sections) <= set(self.sections) and self.keeps_sections)
        return has_sections and self.can_encode(row.packetization)


def check_scenes(study: Study, store: Store, *, views: bool = True) -> None:
    """Checks the files of all scenes, so that one that cannot be used is an error before the work begins.

    Args:
        study: The evaluation.
        store: Store, which keeps the streams in memory.
        views: True to check photos, cameras, references, results of other codecs and network weights, too; False for a
            comparison of sizes, which draws nothing.

    Raises:
        SplatwireError: If a stream, scene file, model folder, cameras file, dataset or weights file cannot be read; if
            a reference or the result of another codec is not a scene; if a stream is a sequence and the scene has no
            reference; or if parts are missing and a method puts the scene into other packets.
    """
    for entry in study.scenes:
        source = Source(entry, store.files)
        if (stream := source.stream) is not None:
            num_missing = stream.manifest.num_packets - len(stream.packets)
            if num_missing and any(source.can_pack(row) for row in study.rows):
                raise InvalidValueError(
                    f"{entry.sections or entry.source}: {num_missing} of {stream.manifest.num_packets} packets are "
                    f"missing, and rows put the scene '{entry.name}' into other packets: only a complete stream can be"
                )
        elif entry.kind == "model":
            store.files.model(entry.source)
        else:
            loaded = store.files.loaded_scene(entry.source)
            if any(source.can_pack(row) for row in study.rows):
                complete_scene(loaded, entry.source)  # refuses a file with losses
        if views:
            _check_comparison(study, source)


def _check_comparison(study: Study, source: Source) -> None:
    """Checks the files with which a scene is compared, the results of other codecs, and the weights of concealers.

    Raises:
        SplatwireError: If one of them cannot be read, or is no scene.
    """
    entry = source.entry
    if source.timed and entry.photos is not None:
        raise InvalidValueError(
            f"scene '{entry.name}' is a sequence, which is compared with frames: leave out its photos"
        )
    if not source.timed:
        check_views(entry)
        if entry.reference is not None:
            check_scene_kind(entry.reference)
    elif len(study.scenes) > 1:  # a single sequence is checked at the beginning of the work
        assert source.stream is not None
        assert entry.reference is not None
        frame_cameras(source.stream, entry.reference, entry.cameras)
    for row in study.rows:
        check_decoded(row, entry)
        if row.needs_weights and entry.weights is not None:
            create_concealer(row.conceal.replace(WEIGHTS, str(entry.weights)), **row.options)


def prepare_scene(study: Study, entry: SceneEntry, store: Store, progress: Progress) -> PreparedScene:
    """Encodes a scene for every method, prepares the reference images, and draws the loss masks.

    Results that are already in the store are reused.

    Args:
        study: The evaluation.
        entry: The scene.
        store: Store for the results.
        progress: Called with the name of the current task and its finished share, 0 to 1.

    Raises:
        SplatwireError: If the scene or its photos cannot be read, or encoding fails for one of the methods.
    """
    source = Source(entry, store.files)
    streams = prepare_streams(study, source, store, progress)
    variant, first = next(iter(streams.items()))

    @functools.cache
    def drawn() -> Scene:
        if entry.reference is not None:
            return drawable_scene(entry.reference, "drop")[0]
        if variant == PASSTHROUGH:
            return source.scene
        return decode_complete(store.files.stream(store.root / first.path), store.root / first.path)

    stamp = first.digest if entry.reference is None else digest_of_files(entry.reference)
    if entry.reference is not None and not source.timed and entry.kind != "model":
        _warn_of_another_scene(source, drawn, digest_of(first.digest, stamp, CODE), store)
    background = _background(first, store) if entry.background is None else entry.background
    looked_at = _frame_views(source, stamp, store) if source.timed else _with_cameras(entry, drawn, stamp, store)
    references = prepare_references(study, looked_at, background, drawn, stamp, store, progress, frames=source.timed)
    for row in study.rows:
        if (decoded := prepare_decoded(row, entry, references, lambda: _is_antialiased(first, store))) is not None:
            streams[row.variant] = decoded
    return PreparedScene(
        entry=entry,
        references=references,
        streams=streams,
        parts={row.key: _parts(row, source, streams[row.variant]) for row in study.rows if row.variant in streams},
        masks=dict(_draw_masks(study, streams, store)),
        sections=tuple(source.sections),
        keeps_sections=source.keeps_sections,
        schema_name=source.schema_name if any(stream.num_packets for stream in streams.values()) else "",
    )


def prepare_streams(study: Study, source: Source, store: Store, progress: Progress) -> dict[str, PreparedStream]:
    """Encodes a scene once for each distinct stream that the methods of an evaluation use.

    Args:
        study: The evaluation.
        source: The scene.
        store: Store for the streams.
        progress: Called with the name of the current task and its finished share, 0 to 1.

    Returns:
        The streams by name (`Row.variant`).

    Raises:
        InvalidValueError: If the scene cannot be encoded for any method.
    """
    entry = source.entry
    stamp = "" if entry.sections is None else digest_of_files(entry.sections)
    digest = digest_of_files(entry.source)
    folder = f"inputs/{digest_of(digest, stamp, CODE)}"
    streams = {}
    for name, row in {row.variant: row for row in reversed(study.rows) if not row.decoded}.items():
        if row.packetization is None or source.timed:
            streams[name] = _passthrough(source, digest)
        elif source.can_pack(row):
            streams[name] = _prepare_stream(row, source, store, folder, progress)
    if all(row.decoded for row in study.rows):  # the scene still gives the views and the background
        streams[PASSTHROUGH] = _passthrough(source, digest)
    if not streams:
        raise InvalidValueError(f"scene '{entry.name}' lacks what every row needs, or cannot be packed so")
    return streams


def _warn_of_another_scene(source: Source, load_scene: Callable[[], Scene], digest: str, store: Store) -> None:
    """Logs a warning if a scene does not fit its reference.

    The reasons are another position or size, and antialiasing of only one of the two.

    The result of the comparison is stored. Empty scenes are not compared.

    Args:
        source: The scene.
        load_scene: Function that loads the reference; called only if the result of the comparison is not stored yet.
        digest: Digest of scene and reference, part of the file name of the stored result.
        store: Store for the result.
    """
    entry = source.entry
    assert entry.reference is not None
    name = f"inputs/extent_{digest_of(digest, str(entry.source), str(entry.reference))}.json"
    if (stored := read_json(store.root / name)) is None:
        received, reference, why = source.received, load_scene(), None
        if len(received.positions) and len(reference.positions):
            evaluated = SceneExtent.of(received, entry.source)
            expected = SceneExtent.of(reference, entry.reference)
            why = expected.difference(evaluated) or expected.drawing_difference(evaluated)
        stored = {"difference": why}
        store.write(name, canonical(stored).encode())
    if stored["difference"] is not None:
        LOG.warning("%s", stored["difference"])


def _background(first: PreparedStream, store: Store) -> Background:
    """Returns the background colour of a scene.

    Args:
        first: Stream or scene file from which the colour is read.
        store: Store that contains the file.
    """
    path = store.root / first.path
    if first.num_packets:
        return BACKGROUND_SECTION.of_stream(store.files.stream(path))
    return store.files.scene(path).background


def _is_antialiased(first: PreparedStream, store: Store) -> bool:
    """True if a scene is drawn antialiased; see `_background` for the arguments."""
    path = store.root / first.path
    if first.num_packets:
        return ANTIALIASED in sections_of(store.files.stream(path))
    return antialiased(store.files.scene(path))


def _frame_views(source: Source, reference_digest: str, store: Store) -> SceneEntry:
    """Writes a cameras file with one camera for each frame of a sequence.

    Args:
        source: The sequence.
        reference_digest: Digest of the reference, part of the file's name.
        store: Store in which the file is written.

    Returns:
        The definition of the scene, with the path of the cameras file.
    """
    entry, stream = source.entry, source.stream
    assert stream is not None
    assert entry.reference is not None
    named = "" if entry.cameras is None else digest_of_files(entry.cameras)
    path = store.root / f"inputs/frames_{digest_of(reference_digest, named, CODE)}.json"
    if not path.is_file():
        path.parent.mkdir(parents=True, exist_ok=True)
        save_cameras(frame_cameras(stream, entry.reference, entry.cameras), path)
    return dataclasses.replace(entry, cameras=path)


def _with_cameras(
    entry: SceneEntry, load_scene: Callable[[], Scene], reference_digest: str, store: Store
) -> SceneEntry:
    """Adds generated cameras to the definition of a scene if the user gave neither cameras nor photos.

    Args:
        entry: The definition.
        load_scene: Function that loads the scene; called only if no cameras are stored.
        reference_digest: Digest of the reference, part of the name of the cameras file.
        store: Store in which the cameras file is written.
    """
    if entry.cameras is not None or entry.photos is not None:
        return entry
    name = f"inputs/around_{digest_of(reference_digest, CODE)}.json"
    if not (store.root / name).is_file():
        (store.root / name).parent.mkdir(parents=True, exist_ok=True)
        save_cameras(surrounding_cameras(load_scene(), AROUND_VIEWS, AROUND_SIZE), store.root / name)
    return dataclasses.replace(entry, cameras=store.root / name)


def _passthrough(source: Source, digest: str) -> PreparedStream:
    entry, path = source.entry, str(real_path(source.entry.source))
    if (stream := source.stream) is not None:
        manifest = stream.manifest
        return PreparedStream(
            path, digest, stream_parts(stream), manifest.num_packets, manifest.num_elements, elements=manifest.elements
        )
    scene = source.files.scene(entry.source)
    if entry.kind == "model":
        parts = {"model": file_bytes(entry.source)}
    else:
        form = find_format(source.files.loaded_scene(entry.source).kind)
        parts = tensor_bytes(entry.source) if form is None else {form.name: file_bytes(entry.source)}
    return PreparedStream(path, digest, parts, 0, scene.num_elements, scene.num_gaussians, elements=scene.ELEMENTS)


def stored_stream(store: Store, path: str, about: Path) -> PreparedStream | None:
    """Returns a stream that an earlier run has prepared; None if there is none.

    Args:
        store: The store.
        path: Path of the stream within the store.
        about: Path of the JSON file that describes the stream.

    Raises:
        SplatwireError: If the stream or the JSON file is damaged; a damaged stream must not be evaluated.
    """
    if (content := read_json(about)) is None:
        return None
    damaged = SplatwireError(f"{store.root / path} is missing or damaged: remove its folder and start again")
    try:
        stored = PreparedStream(**content)
    except TypeError as error:
        raise damaged from error
    if not (store.root / path).is_file() or digest_of_files(store.root / path) != stored.digest:
        raise damaged
    return stored


def _prepare_stream(row: Row, source: Source, store: Store, folder: str, progress: Progress) -> PreparedStream:
    assert row.packetization is not None
    path, about = f"{folder}/{row.variant}.swz", store.root / folder / f"{row.variant}.json"
    if (stored := stored_stream(store, path, about)) is not None:
        return stored
    label = f"{source.entry.name}: encoding {row.variant}"
    if (whole := source.stream) is not None and source.keeps_sections:
        started = time.perf_counter()
        stream = _repacked(whole, row, lambda share: progress(label, share))
    else:
        scene = source.scene
        started = time.perf_counter()
        classes = scene_class_offsets(scene)
        stream = encode_scene(
            scene, row.packetization, class_offsets=classes, progress=lambda share: progress(label, share)
        )
    seconds = time.perf_counter() - started
    ordered = decode_stream(stream).scene
    store.write(path, stream_to_bytes(stream))
    prepared = PreparedStream(
        path,
        digest_of_files(store.root / path),
        stream_parts(stream),
        len(stream.packets),
        stream.manifest.num_elements,
        ordered.num_gaussians,
        seconds,
        stream.manifest.elements,
    )
    store.write(f"{folder}/{row.variant}_anchors.npz", anchor_bytes(stream, ordered.positions))
    store.write(f"{folder}/{row.variant}.json", canonical(vars(prepared)).encode())  # last: marks the entry as complete
    return prepared


def _repacked(whole: SceneStream, row: Row, progress: Callable[[float], None]) -> SceneStream:
    """Encodes a stream again with the packetization of one method of the study.

    The study compares several methods on the same scene. All methods therefore get the same quantised values.

    Args:
        whole: The complete stream.
        row: The method, which is one row of the result table. It sets the packetization. It also lists the sections of
            side information that the method needs. Other sections are removed, except masks and those that determine
            how and where the scene is drawn.
        progress: Called with the finished share, 0 to 1.
    """
    # Quantised values and networks stay the same, so that the methods can be compared. Side information that the method
    # does not need is removed.
    assert row.packetization is not None
    kept = without_sections(whole, set(sections_of(whole)) - {*row.sections, *_SECTIONS_OF_PICTURES, MASKS})
    return repack(kept, row.packetization, progress=progress)


def _parts(row: Row, source: Source, prepared: PreparedStream) -> dict[str, int]:
    name, _, file = row.conceal.partition(":")
    parts, stream = prepared.parts, source.stream
    if row.packetization is None and stream is not None:
        parts = stream_parts(needed_stream(stream, row.conceal))
    file = file.replace(WEIGHTS, str(source.entry.weights or ""))
    return {**parts, **({f"{name}_weights": Path(file).stat().st_size} if file else {})}


def _draw_masks(
    study: Study, streams: Mapping[str, PreparedStream], store: Store
) -> Iterator[tuple[tuple[str, Loss, int], PacketLossMask]]:
    for name in dict.fromkeys(row.variant for row in study.lossy_rows):
        if name not in streams or not streams[name].num_packets:
            continue
        stream = store.files.stream(store.root / streams[name].path)
        for loss in study.losses:
            for seed in study.seeds:
                mask = draw_mask(stream, loss.process, seed=seed, send_order=loss.send_order)
                yield (name, loss, seed), mask
