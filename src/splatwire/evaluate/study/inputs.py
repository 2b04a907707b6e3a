"""What an evaluation needs before its first unit: encoded streams, references and loss masks, each made once."""

import dataclasses
import functools
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from splatwire.channel import LossMask, draw_mask
from splatwire.codec import decode_stream, encode_scene, repack, repackable, schema_of
from splatwire.codec.background import SECTION as BACKGROUND
from splatwire.codec.registry import schema_named
from splatwire.codec.schemas.hacpp.separated import SECTION as MASKS
from splatwire.conceal import create_concealer
from splatwire.conceal.registry import why_unfit
from splatwire.data import save_cameras
from splatwire.errors import InvalidValueError
from splatwire.evaluate.study.definition import AS_IT_IS, WEIGHTS, Loss, Row, SceneEntry, Study, canonical
from splatwire.evaluate.study.masks import anchor_bytes
from splatwire.evaluate.study.parts import needed_stream, stream_parts, without_sections
from splatwire.evaluate.study.records import CODE
from splatwire.evaluate.study.references import Progress, References, digest_of, digest_of_files, prepare_references
from splatwire.evaluate.study.store import Store, read_json
from splatwire.formats import format_of
from splatwire.importers import HACPP_CODEC
from splatwire.model import AnchorScene
from splatwire.model.appearance import Scene, scene_of
from splatwire.model.tensor_file import tensor_bytes
from splatwire.packets import Packetization, SceneStream, read_stream, stream_to_bytes
from splatwire.packets.limits import SCHEMAS
from splatwire.packets.sections import sections_of
from splatwire.render.importance import surrounding_cameras
from splatwire.render.precision import classes_of
from splatwire.scene import Anchors
from splatwire.scene_io import background_of_file, drawable_scene, open_scene, read_scene_file

AROUND_VIEWS, AROUND_SIZE = 12, 400
"""Views of a scene that nobody has photos or cameras of, and their width and height in pixels."""


@dataclass(frozen=True)
class PreparedStream:
    """What is sent, or scored, for rows of one variant.

    Attributes:
        path: Its file within the store, or where the user has it.
        digest: Digest of its content.
        parts: Bytes by part, side information in its own parts.
        num_packets: Packets of the complete stream; 0 for a scene that is scored as it is.
        num_anchors: Elements.
        num_gaussians: Gaussians that these have; None where nobody counted them.
        seconds_encode: Seconds that encoding it took; None for what was encoded before.
        elements: What its elements are called.
    """

    path: str
    digest: str
    parts: Mapping[str, int]
    num_packets: int
    num_anchors: int
    num_gaussians: int | None = None
    seconds_encode: float | None = None
    elements: str = AnchorScene.ELEMENTS


@dataclass(frozen=True)
class PreparedScene:
    """A scene that is ready for units of work.

    Attributes:
        entry: The scene.
        references: What its pictures are compared with.
        streams: Encoded stream of every variant of the rows.
        parts: Bytes by part that each row needs, by its key: with its weights, without sections that others read.
        masks: Mask of every variant, loss and seed.
        sections: Named sections that rows may have in their streams.
        codec: Name of the schema that codes its elements; empty if nothing is sent.
    """

    entry: SceneEntry
    references: References
    streams: Mapping[str, PreparedStream]
    parts: Mapping[str, Mapping[str, int]]
    masks: Mapping[tuple[str, Loss, int], LossMask]
    sections: tuple[str, ...]
    codec: str

    def lacks(self, row: Row) -> str:
        """Why a row cannot run on this scene; empty if it can."""
        if row.needs_weights and self.entry.weights is None:
            return "it has no calibrated weights (splatwire calibrate makes them)"
        absent = [name for name in row.sections if name not in self.sections]
        if absent:
            return f"it has no section '{absent[0]}' (splatwire calibrate adds it)"
        if row.variant not in self.streams:
            return "only anchors of HAC++ (format 1) can be packed so"
        return self._why_unfit(row) if self.streams[row.variant].num_packets else ""

    def _why_unfit(self, row: Row) -> str:
        """Reason why the concealer or the erosion of a row cannot work on the stream; empty if it can."""
        offers = schema_named(self.codec).offers
        if row.erode is not None and Anchors not in offers:
            return f"only anchors lose one attribute alone, and it has {self.streams[row.variant].elements}"
        sections = self.sections if row.packetization is None else row.sections
        return why_unfit(row.conceal, offers, sections, row.options)


@dataclass(frozen=True)
class Source:
    """A scene of the user, of which each part is read when it is asked for first.

    Attributes:
        entry: The scene.
    """

    entry: SceneEntry

    @cached_property
    def stream(self) -> SceneStream | None:
        """The stream that the scene comes with or is, whose named sections rows may ask for."""
        path = self.entry.sections or (self.entry.source if self.entry.kind == "stream" else None)
        return None if path is None else read_stream(path)[0].still(path)

    @cached_property
    def scene(self) -> Scene:
        """The complete scene; where it comes with a stream, what that decodes to, so that all rows have its integers.

        Raises:
            BitstreamError: If it is not complete.
        """
        entry = self.entry
        if entry.sections is not None:
            return open_scene(entry.sections)
        if entry.kind == "model":
            from splatwire.importers.hacpp import import_hacpp  # needs torch

            return import_hacpp(entry.source)
        return open_scene(entry.source)

    @property
    def sections(self) -> Mapping[str, bytes]:
        """Its named sections, such as those that `splatwire calibrate` adds."""
        return {} if self.stream is None else sections_of(self.stream)

    @property
    def codec(self) -> str:
        """What codes its elements."""
        if self.entry.kind == "model":
            return HACPP_CODEC
        return schema_of(self.scene).name if self.stream is None else self.stream.manifest.codec

    def travels(self, packetization: Packetization) -> bool:
        """Whether it can be packed so."""
        return packetization.common or SCHEMAS[self.codec].separable


def prepare_scene(study: Study, entry: SceneEntry, store: Store, progress: Progress) -> PreparedScene:
    """Encodes a scene for every row, finds its references and draws its masks; what the store has is taken from there.

    Args:
        study: The evaluation.
        entry: The scene.
        store: Where to.
        progress: Called with what is being done and the share of it that is done.

    Raises:
        SplatwireError: If the scene or its photos cannot be read, or a row cannot be encoded.
    """
    source = Source(entry)
    streams = prepare_streams(study, source, store, progress)
    if entry.weights is not None:
        for row in study.rows:
            if row.needs_weights:
                create_concealer(row.conceal.replace(WEIGHTS, str(entry.weights)), **row.options)
    variant, first = next(iter(streams.items()))

    @functools.cache
    def drawn() -> Scene:
        if entry.reference is not None:
            return drawable_scene(entry.reference, "drop")[0]
        return source.scene if variant == AS_IT_IS else open_scene(store.root / first.path)

    stamp = first.digest if entry.reference is None else digest_of_files(entry.reference)
    own = background_of_file(store.root / first.path)
    background = own if entry.background is None else entry.background
    looked_at = _looked_at(entry, drawn, stamp, store)
    return PreparedScene(
        entry=entry,
        references=prepare_references(study, looked_at, background, drawn, stamp, store, progress),
        streams=streams,
        parts={row.key: _parts(row, source, streams[row.variant]) for row in study.rows if row.variant in streams},
        masks=dict(_draw_masks(study, streams, store)),
        sections=tuple(source.sections),
        codec=source.codec if any(stream.num_packets for stream in streams.values()) else "",
    )


def prepare_streams(study: Study, source: Source, store: Store, progress: Progress) -> dict[str, PreparedStream]:
    """Encodes a scene once for each packetization of the rows that it can have; see `prepare_scene`."""
    entry = source.entry
    stamp = "" if entry.sections is None else digest_of_files(entry.sections)
    digest = digest_of_files(entry.source)
    folder = f"inputs/{digest_of(digest, stamp, CODE)}"
    streams = {}
    for name, row in {row.variant: row for row in reversed(study.rows)}.items():
        if row.packetization is None:
            streams[name] = _as_it_is(source, digest)
        elif set(row.sections) <= set(source.sections) and source.travels(row.packetization):
            streams[name] = _prepare_stream(row, source, store, folder, progress)
    if not streams:
        raise InvalidValueError(f"scene '{entry.name}' lacks what every row needs, or cannot be packed so")
    return streams


def _looked_at(entry: SceneEntry, drawn: Callable[[], Scene], stamp: str, store: Store) -> SceneEntry:
    """The entry with cameras around its scene, if it has neither cameras nor photos."""
    if entry.cameras is not None or entry.photos is not None:
        return entry
    name = f"inputs/around_{digest_of(stamp, CODE)}.json"
    if not (store.root / name).is_file():
        save_cameras(surrounding_cameras(drawn(), AROUND_VIEWS, AROUND_SIZE), store.root / name)
    return dataclasses.replace(entry, cameras=store.root / name)


def _as_it_is(source: Source, digest: str) -> PreparedStream:
    entry, path = source.entry, str(source.entry.source.resolve())
    if (stream := source.stream) is not None:
        manifest = stream.manifest
        return PreparedStream(
            path, digest, stream_parts(stream), manifest.num_packets, manifest.num_elements, elements=manifest.elements
        )
    found = read_scene_file(entry.source)
    scene, form = scene_of(found.loaded), format_of(found.kind)
    parts = tensor_bytes(entry.source) if form is None else {form: _num_bytes(entry.source)}
    return PreparedStream(path, digest, parts, 0, scene.num_elements, scene.num_gaussians, elements=scene.ELEMENTS)


def _num_bytes(path: Path) -> int:
    """Bytes of a file, or of all files of a folder."""
    return sum(file.stat().st_size for file in ([path] if path.is_file() else path.rglob("*")) if file.is_file())


def _prepare_stream(row: Row, source: Source, store: Store, folder: str, progress: Progress) -> PreparedStream:
    assert row.packetization is not None
    path, about = f"{folder}/{row.variant}.swz", store.root / folder / f"{row.variant}.json"
    if (known := read_json(about)) is not None:
        return PreparedStream(**known)
    what = f"{source.entry.name}: encoding {row.variant}"
    if (whole := source.stream) is not None and not whole.manifest.tiers and repackable(whole):
        started = time.perf_counter()
        stream = _repacked(whole, row, lambda share: progress(what, share))
    elif row.sections:
        raise InvalidValueError(f"row '{row.key}' needs sections of a stream without tiers: encode without --tiers")
    else:
        scene = source.scene
        started = time.perf_counter()
        classes = classes_of(scene)
        stream = encode_scene(scene, row.packetization, classes=classes, progress=lambda share: progress(what, share))
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
    store.write(f"{folder}/{row.variant}.json", canonical(vars(prepared)).encode())  # last: it says that all is there
    return prepared


def _repacked(whole: SceneStream, row: Row, progress: Callable[[float], None]) -> SceneStream:
    """The stream in the row's packets; of what was added for concealers, with the row's sections only.

    All rows have the integers and the networks of one stream, so that they differ by nothing but packets and sections.
    """
    assert row.packetization is not None
    kept = without_sections(whole, set(sections_of(whole)) - {*row.sections, BACKGROUND, MASKS})
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
) -> Iterator[tuple[tuple[str, Loss, int], LossMask]]:
    for name in dict.fromkeys(row.variant for row in study.lossy_rows):
        if name not in streams or not streams[name].num_packets:
            continue
        stream, _ = read_stream(store.root / streams[name].path)
        for loss in study.losses:
            for seed in study.seeds:
                mask = draw_mask(stream, loss.process, seed=seed, send_order=loss.send_order)
                yield (name, loss, seed), mask
