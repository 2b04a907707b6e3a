"""What a protocol needs before its first unit: encoded streams, reference pictures and loss masks, each made once."""

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from splatwire.codec import decode_stream, encode_scene, scene_in_order, side_info_parts
from splatwire.codec.background import SECTION as BACKGROUND
from splatwire.conceal.gnn.weights import load_weights
from splatwire.errors import BitstreamError, InvalidValueError
from splatwire.evaluate.study.definition import Loss, Row, SceneEntry, Study, canonical
from splatwire.evaluate.study.masks import LossMask, anchor_bytes, draw_mask, mask_bytes
from splatwire.evaluate.study.references import Progress, digest_of, prepare_references
from splatwire.evaluate.study.store import Store, read_json
from splatwire.importers.hacpp import import_hacpp
from splatwire.model import AnchorScene
from splatwire.model.scene_file import load_scene
from splatwire.packets import SceneStream, read_stream, stream_to_bytes
from splatwire.packets.sections import split_sections, without_concealment


@dataclass(frozen=True)
class PreparedStream:
    """An encoded stream in the store.

    Attributes:
        path: Its file within the store.
        digest: Digest of its content.
        parts: Bytes by part, side information in its own parts.
        num_packets: Packets.
        num_anchors: Anchors.
        num_gaussians: Gaussians that its anchors have.
    """

    path: str
    digest: str
    parts: Mapping[str, int]
    num_packets: int
    num_anchors: int
    num_gaussians: int

    @property
    def num_bytes(self) -> int:
        """Everything, as one file."""
        return sum(self.parts.values())


@dataclass(frozen=True)
class PreparedScene:
    """A scene that is ready for units of work.

    Attributes:
        name: Name of the scene.
        dataset: Group of scenes.
        views: Folder of the references within the store.
        views_digest: Digest of cameras and references.
        reference: What the references are.
        masked: Whether masks say which of their pixels count.
        streams: Encoded stream of every variant of the rows.
        masks: Mask of every variant, loss and seed.
        sections: Named sections that rows may have in their streams.
        weights: File of the GNN's weights; empty if there are none.
        weights_digest: Digest of that file.
        weights_bytes: Its size.
    """

    name: str
    dataset: str
    views: str
    views_digest: str
    reference: str
    masked: bool
    streams: Mapping[str, PreparedStream]
    masks: Mapping[tuple[str, Loss, int], LossMask] = field(default_factory=dict)
    sections: tuple[str, ...] = ()
    weights: str = ""
    weights_digest: str = ""
    weights_bytes: int = 0


def prepare_scene(study: Study, entry: SceneEntry, store: Store, code: str, progress: Progress) -> PreparedScene:
    """Encodes a scene for every row, makes its references and draws its masks; what the store has is taken from there.

    Args:
        study: The protocol.
        entry: The scene.
        store: Where to.
        code: Digest of the code.
        progress: Called with what is being done and the share of it that is done.

    Raises:
        SplatwireError: If the scene or its photos cannot be read, or a row cannot be encoded.
    """
    streams = prepare_streams(study, entry, store, code, progress)
    if not streams:
        raise InvalidValueError(f"scene '{entry.name}' lacks what every row needs")
    first = next(iter(streams.values()))
    stamps = {"scene": first.digest, "code": code}
    views, about = prepare_references(study, entry, store.root / first.path, stamps, store, progress)
    masks = {}
    for name, row in _variants(study).items():
        if name in streams and any(not r.lossless for r in study.rows if r.variant == name):
            masks.update(_save_masks(study, entry.name, row, streams[name], store))
    weights = b"" if entry.weights is None else entry.weights.read_bytes()
    if entry.weights is not None:
        load_weights(entry.weights)
    return PreparedScene(
        name=entry.name,
        dataset=entry.dataset,
        views=views,
        views_digest=str(about["digest"]),
        reference=str(about["source"]),
        masked=bool(about["masked"]),
        streams=streams,
        masks=masks,
        sections=tuple(sections_of(_calibrated_stream(entry))),
        weights=str(entry.weights or ""),
        weights_digest=hashlib.sha256(weights).hexdigest() if weights else "",
        weights_bytes=len(weights),
    )


def prepare_streams(
    study: Study, entry: SceneEntry, store: Store, code: str, progress: Progress
) -> dict[str, PreparedStream]:
    """Encodes a scene once for each packetization of the rows; see `prepare_scene`."""
    lazy, calibrated = _LazyScene(entry), _calibrated_stream(entry)
    stamp = "" if entry.sections is None else source_digest(entry.sections)
    folder = f"inputs/{digest_of(source_digest(entry.source), stamp, code)}"

    def told(share: float) -> None:
        progress(f"{entry.name}: encoding", share)

    return {
        name: _prepare_stream(row, lazy, calibrated, store, folder, told)
        for name, row in _variants(study).items()
        if set(row.sections) <= set(sections_of(calibrated))
    }


def _calibrated_stream(entry: SceneEntry) -> SceneStream | None:
    """The stream that a scene comes with or is, whose named sections rows may ask for."""
    path = entry.sections or (entry.source if entry.kind == "stream" else None)
    return None if path is None else read_stream(path)[0]


def sections_of(stream: SceneStream | None) -> Mapping[str, bytes]:
    """The named sections of a stream, such as those that `splatwire calibrate` adds."""
    return {} if stream is None else split_sections(stream.side_info)[1]


def _variants(study: Study) -> dict[str, Row]:
    """A row for each packetization, by its name."""
    return {row.variant: row for row in reversed(study.rows)}


class _LazyScene:
    """A scene that is read when it is needed for the first time."""

    def __init__(self, entry: SceneEntry) -> None:
        self._entry = entry
        self._scene: AnchorScene | None = None

    def __call__(self) -> AnchorScene:
        if self._scene is None:
            self._scene = read_scene(self._entry)
        return self._scene


def read_scene(entry: SceneEntry) -> AnchorScene:
    """Reads the scene of an entry, whatever kind it is of.

    Raises:
        BitstreamError: If it is not complete.
    """
    if entry.kind == "model":
        return import_hacpp(entry.source)
    if entry.kind == "scene":
        return load_scene(entry.source)
    stream, _ = read_stream(entry.source)
    if len(stream.packets) != stream.manifest.num_packets:
        raise BitstreamError(f"{entry.source} has lost packets: a protocol starts from complete streams")
    return decode_stream(stream).scene


def source_digest(path: Path) -> str:
    """Digest of a file, or of all files of a folder."""
    digest = hashlib.sha256()
    for file in [path] if path.is_file() else sorted(p for p in path.rglob("*") if p.is_file()):
        digest.update(f"{file.relative_to(path)}\0".encode())
        digest.update(hashlib.sha256(file.read_bytes()).digest())
    return digest.hexdigest()


def _prepare_stream(
    row: Row,
    scene: _LazyScene,
    calibrated: SceneStream | None,
    store: Store,
    folder: str,
    progress: Callable[[float], None],
) -> PreparedStream:
    path, about = f"{folder}/{row.variant}.swz", store.root / folder / f"{row.variant}.json"
    if (known := read_json(about)) is not None:
        return PreparedStream(**known)
    if row.sections:
        stream = _with_sections(calibrated, row)
    else:
        stream = encode_scene(scene(), row.packetization, progress=progress)
    ordered = scene_in_order(scene(), row.packetization.order)
    data = stream_to_bytes(stream)
    prepared = PreparedStream(
        path,
        hashlib.sha256(data).hexdigest(),
        stream_parts(stream),
        len(stream.packets),
        stream.manifest.num_anchors,
        int(ordered.anchors.mask.sum()),
    )
    store.write(path, data)
    store.write(f"{folder}/{row.variant}_anchors.npz", anchor_bytes(stream, ordered.anchors.positions.numpy()))
    store.write(f"{folder}/{row.variant}.json", canonical(vars(prepared)).encode())  # last: it says that all is there
    return prepared


def _with_sections(calibrated: SceneStream | None, row: Row) -> SceneStream:
    """The calibrated stream itself; of what was added for concealers, with the row's sections only.

    A section is coded against the quantised networks of its own stream: in another encoding it could not be read.

    Raises:
        InvalidValueError: If that stream has other packets than the row.
    """
    if calibrated is None or calibrated.manifest.tiers or calibrated.manifest.packetization != row.packetization:
        raise InvalidValueError(f"row '{row.key}' needs sections made for its own packets ({row.variant})")
    for name in sorted(set(sections_of(calibrated)) - {*row.sections, BACKGROUND}):
        calibrated = without_concealment(calibrated, name)
    return calibrated


def stream_parts(stream: SceneStream) -> dict[str, int]:
    """Bytes of a stream by part, with the side information taken apart; they add up to the whole file."""
    parts = dict(stream.parts())
    whole = parts.pop("side_info")
    inner = side_info_parts(stream.side_info)
    side = {f"side_{name}": size for name, size in inner.items()}
    rest = whole - sum(side.values())
    return {**side, **({"side_other": rest} if rest else {}), **parts}


def _save_masks(
    study: Study, scene: str, row: Row, prepared: PreparedStream, store: Store
) -> dict[tuple[str, Loss, int], LossMask]:
    stream, _ = read_stream(store.root / prepared.path)
    masks = {}
    for loss in study.losses:
        for seed in study.seeds:
            mask = masks[(row.variant, loss, seed)] = draw_mask(stream, loss, seed)
            name = f"masks/{_safe(scene)}/{row.variant}/{_safe(loss.label)}_{seed}_{mask.digest[:12]}.npz"
            if not (store.root / name).is_file():
                store.write(name, mask_bytes(stream, mask, loss, seed))
    return masks


def _safe(name: str) -> str:
    return "".join(c if c.isalnum() or c in "-_." else "_" for c in name)[:100]
