"""A third-party scene type, coloured points, defined in one file.

It is encoded, transmitted with losses, decoded progressively, concealed and rendered. A page refuses it. No other file
changes.
"""

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

from random_numbers import Numbers
from scenes import tiny_cameras
from splatwire.anchors.appearance import gaussians_of_view
from splatwire.bitstream import (
    HEADER_BYTES,
    PRESETS,
    Manifest,
    Packet,
    Packetization,
    PacketPlan,
    SceneStream,
    read_stream,
    spread_packetization,
    write_stream,
)
from splatwire.bitstream.limits import SCHEMAS
from splatwire.bitstream.sections import read_sections, write_sections
from splatwire.channel import parse_loss, transmit
from splatwire.codec import (
    ProgressiveDecoder,
    can_repack,
    decode_stream,
    encode_scene,
    register_schema,
    repack,
    schema_named,
    schema_of,
)
from splatwire.codec.background import BACKGROUND_SECTION
from splatwire.codec.named_sections import concealer_sections
from splatwire.codec.schema import CodedPackets, Options, PacketBatch, Prepared, Schema
from splatwire.codec.weight_bytes import framed
from splatwire.concealment import conceal, concealer_names
from splatwire.errors import BitstreamError, DesyncError, InvalidValueError, MissingSideInfoError, UnknownNameError
from splatwire.files.byte_io import ByteReader
from splatwire.render import render_scene
from splatwire.transport.http.pack import pack_stream
from splatwire.types import Cameras, Gaussians, GrowStrength, LossMask, ReceivedScene, RenderHints
from splatwire.types.background import BLACK, Background
from splatwire.types.validity import ElementValidity
from splatwire.view.page import page_of_stream


@dataclass(frozen=True, eq=False)
class Points:
    positions: np.ndarray
    colors: np.ndarray

    @property
    def log_sizes(self) -> np.ndarray:
        return np.log(np.full_like(self.positions[:, 0], 0.05))

    def select(self, index: np.ndarray) -> "Points":
        return Points(self.positions[index], self.colors[index])

    def with_losses(self, known: np.ndarray, positions: np.ndarray) -> "Points":
        return Points(np.where(known[:, None], self.positions, positions), self.colors * known[:, None])

    def with_estimates(self, loss_mask: LossMask, estimates: "Points") -> "Points":
        return replace(self, colors=np.where(loss_mask.fully_received[:, None], self.colors, estimates.colors))


@dataclass(frozen=True, eq=False)
class PointScene:
    ELEMENTS: ClassVar[str] = "points"
    GROW_STRENGTH: ClassVar[GrowStrength] = GrowStrength(size=1.0, opacity=0.0)
    points: Points
    hints: RenderHints | None = None
    background: Background = BLACK

    @property
    def elements(self) -> Points:
        return self.points

    @property
    def positions(self) -> np.ndarray:
        return self.points.positions

    @property
    def num_elements(self) -> int:
        return len(self.positions)

    num_gaussians = num_elements

    @property
    def drawable(self) -> np.ndarray:
        return self.validity().kept

    @property
    def facts(self) -> dict[str, int | float]:
        return {"num_points": self.num_elements}

    def validity(self) -> ElementValidity:
        return ElementValidity(np.ones(self.num_elements, np.bool_), 0, 0, None)

    def select(self, index: np.ndarray) -> "PointScene":
        return replace(self, points=self.points.select(index), hints=None)

    def with_elements(self, elements: Points, hints: RenderHints | None = None) -> "PointScene":
        return replace(self, points=elements, hints=hints)


@gaussians_of_view.register
def _(scene: PointScene, cameras: Cameras, view: int) -> Gaussians:
    points, sizes, there = scene.points, np.exp(scene.points.log_sizes), np.ones(scene.num_elements, np.bool_)
    if scene.hints is not None:
        sizes, there = sizes * scene.hints.size_gain, ~scene.hints.left_out
    count = int(there.sum())
    turns = np.tile(np.array([1.0, 0.0, 0.0, 0.0], np.float32), (count, 1))
    scales = np.repeat(sizes[there, None], 3, axis=1)
    return Gaussians(
        points.positions[there], turns, scales, np.full((count,), 0.9, np.float32), points.colors[there] / 255
    )


class PointEncoder:
    def __init__(self, colors: np.ndarray, plan: PacketPlan) -> None:
        self.colors, self.members, p = colors, plan.all_members(), plan.packetization
        self.most = (p.packet_bytes - HEADER_BYTES) // 3 if p.hashed else len(colors)

    def batches(self) -> Iterator[slice]:
        return (slice(a, b) for a, b in itertools.pairwise(self.members.starts.tolist()))

    def encode(self, batch: slice) -> CodedPackets:
        rows = self.colors[self.members.indices[batch]]
        cuts = [rows[at : at + self.most] for at in range(0, len(rows), self.most)]
        return CodedPackets(np.array([len(cut) for cut in cuts]), [cut.tobytes() for cut in cuts], (rows,))


class PointDecoder:
    order: np.ndarray | None = None
    batches_are_blocks, packets_independent, redecode_on_demand = False, True, False
    row_bytes = 3

    def __init__(self, manifest: Manifest, side_info: bytes, num_bytes: int) -> None:
        if not side_info:
            raise MissingSideInfoError("no side information")
        reader = ByteReader(side_info, "side information")
        places = np.frombuffer(reader.blob(), "<f4")
        if places.size != 3 * manifest.num_elements:
            raise BitstreamError("places are missing")
        self.places, self.sections = places.reshape(-1, 3).copy(), read_sections(reader.rest())
        self.scene_bytes = 64 * manifest.num_elements

    def working_bytes(self, packets: Sequence[Packet]) -> int:
        return 1 << 16

    def allocate(self, threads: int | None, progress: Callable[[float], None] | None = None) -> None:
        self.colors = np.zeros(self.places.shape, np.uint8)
        self.loss_mask = LossMask.of_elements(np.zeros(len(self.places), np.bool_))

    def decode(self, batch: PacketBatch) -> tuple[np.ndarray, ...]:
        sizes = (3 * batch.counts).tolist()
        data = b"".join(payload[:n].ljust(n, b"\0") for payload, n in zip(batch.payloads, sizes, strict=True))
        return (np.frombuffer(data, np.uint8).reshape(-1, 3),)

    def store(self, batch: PacketBatch, rows: tuple[np.ndarray, ...]) -> None:
        self.colors[batch.indices], self.loss_mask.received[batch.indices] = rows[0], True

    def update_digest(self, digest: Any, rows: tuple[np.ndarray, ...]) -> None:
        digest.update(rows[0].tobytes())

    def scene(self) -> ReceivedScene:
        points = Points(self.places, self.colors)
        scene = PointScene(points, background=BACKGROUND_SECTION.read(self.sections))
        return ReceivedScene(scene, self.loss_mask, concealer_sections(self.sections))


def prepare(scene: PointScene, options: Options) -> Prepared:
    plan = PacketPlan(options.packetization or PRESETS["datagram"], scene.num_elements, ())
    places = framed(scene.positions.astype("<f4").tobytes())
    side_info = places + write_sections(BACKGROUND_SECTION.sections(scene.background))
    return Prepared(PointEncoder(scene.points.colors, plan), side_info, plan)


def prepare_repack(stream: SceneStream, packetization: Packetization, threads: int | None) -> Prepared:
    return prepare(decode_stream(stream, threads=threads).scene, Options(packetization))


def points_schema(**changes: Any) -> Schema:
    facts = {
        "name": "points", "format_version": 2, "elements": "points", "sections": ("places",),
        "elements_per_byte": 1024, "page": False, "scene_type": PointScene, "provides": frozenset((Points,)),
        "prepare": prepare, "prepare_repack": prepare_repack, "open_decoder": PointDecoder,
        "update_digest": lambda digest, rows: digest.update(rows[0].tobytes()),
    }  # fmt: skip
    return Schema(**{**facts, **changes})


@pytest.fixture(scope="module", autouse=True)
def registered() -> Iterator[None]:
    register_schema(points_schema())
    yield
    for known in (SCHEMAS._entries, SCHEMAS._sources):
        del known["points"]


@pytest.fixture
def scene() -> PointScene:
    rng = Numbers(2)
    points = Points(
        rng.rand(400, 3) - 0.5,
        (256 * rng.rand(400, 3)).astype(np.uint8),
    )
    return PointScene(points, background=(0.0, 0.25, 0.5))


@pytest.fixture(params=["datagram", "paper", "spread"])
def stream(scene: PointScene, request: pytest.FixtureRequest) -> SceneStream:
    small = {"datagram": replace(PRESETS["datagram"], packet_bytes=150), "paper": Packetization(block_size=90, lanes=4)}
    return encode_scene(scene, small.get(request.param, spread_packetization(400)))


def assert_same(one: ReceivedScene, other: ReceivedScene) -> None:
    assert np.array_equal(one.fully_received, other.fully_received)
    assert np.array_equal(one.scene.points.colors, other.scene.points.colors)
    assert one.scene.background == other.scene.background == (0.0, 0.25, 0.5)


def test_third_party_scene_round_trips(scene: PointScene, stream: SceneStream, tmp_path: Path) -> None:
    write_stream(stream, tmp_path / "points.swz")
    read, report = read_stream(tmp_path / "points.swz")
    whole = decode_stream(read)
    assert report.num_missing == whole.loss_mask.num_lost == 0
    assert np.array_equal(whole.scene.points.colors, scene.points.colors)
    assert stream.manifest.elements == "points"
    wrong = replace(stream, manifest=replace(stream.manifest, symbols_digest="0" * 64))
    with pytest.raises(DesyncError):
        decode_stream(wrong)


def test_third_party_scene_is_repacked(scene: PointScene, stream: SceneStream) -> None:
    packed = repack(stream, Packetization(block_size=50, lanes=2))
    assert packed.manifest.packetization != stream.manifest.packetization
    assert_same(decode_stream(packed), decode_stream(stream))


def test_third_party_scene_decodes_progressively(stream: SceneStream) -> None:
    lossy, record = transmit(stream, parse_loss("bernoulli:0.3"), seed=1)
    assert record.num_lost
    arriving = ProgressiveDecoder(stream.manifest, stream.side_info)
    for count, packet in enumerate(lossy.packets, start=1):
        assert len(arriving.add([packet])) == packet.num_elements
        if count % 4 == 0:
            assert_same(arriving.received_scene, decode_stream(stream.with_packets(lossy.packets[:count])))
    assert_same(arriving.snapshot(), decode_stream(lossy))


@pytest.mark.parametrize("name", ["drop", "grow"])
def test_third_party_scene_is_concealed_and_rendered(stream: SceneStream, name: str) -> None:
    whole, received = decode_stream(stream), decode_stream(stream.with_packets(stream.packets[::2]))
    scene, known = conceal(received, name), received.fully_received
    assert np.array_equal(scene.hints.left_out, ~known)
    assert np.array_equal(scene.points.colors[known], whole.scene.points.colors[known])
    assert bool((scene.hints.size_gain[known] > 1).any()) == (name == "grow")
    picture, complete = (render_scene(drawn, tiny_cameras(1, 48, 32)) for drawn in (scene, whole.scene))
    assert picture.shape == complete.shape == (1, 32, 48, 3)
    assert 0 < float(np.abs(picture - complete).mean()) < float(complete.mean())


@pytest.mark.needs_torch
def test_concealers_with_unmet_needs_are_not_offered(stream: SceneStream) -> None:
    received = decode_stream(stream.with_packets(stream.packets[:3]))
    offered = concealer_names((), received.provides)
    assert {"drop", "grow"} <= set(offered)
    for name in ("cari", "scene_free"):
        assert name not in offered
        with pytest.raises(
            InvalidValueError, match=f"concealer '{name}' needs .* this stream of points does not have: use drop"
        ):
            conceal(received, name)


def test_page_refuses_a_third_party_scene(stream: SceneStream) -> None:
    with pytest.raises(InvalidValueError, match="a stream of points is not for browsers"):
        page_of_stream("scene", stream, None, "127.0.0.1")
    with pytest.raises(InvalidValueError, match="a stream of points is not for browsers"):
        pack_stream(stream, "points")


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"name": "No good"}, "schema 'No good' is not complete: its name must be 1 to 32 lower-case letters"),
        ({"format_version": 1}, "schema 'other' is not complete: format_version must be 2 to 5, not 1"),
        ({"format_version": 9}, "format_version must be 2 to 5, not 9"),
        ({"elements": ""}, "elements must be a word for its elements"),
        ({"sections": ()}, "sections must be a tuple of names, one or more"),
        ({"sections": "places"}, "sections must be a tuple of names, one or more"),
        ({"elements_per_byte": 0}, "elements_per_byte must be 1 or more, not 0"),
        ({"scene_type": "PointScene"}, "scene_type must be a class, not 'PointScene'"),
        ({"provides": {"Points"}}, "provides must hold classes"),
        ({"prepare": None, "open_decoder": 3}, "prepare, open_decoder cannot be called"),
        ({"name": "gaussians"}, "two schemas are called 'gaussians': splatwire.bitstream.limits.gaussians and "),
    ],
)
def test_schema_that_is_not_complete_is_refused(changes: dict[str, Any], sentence: str) -> None:
    before = SCHEMAS.registered()
    schema = points_schema(name="other")
    for part, value in changes.items():
        object.__setattr__(schema, part, value)
    with pytest.raises(InvalidValueError, match=sentence):
        register_schema(schema)
    assert SCHEMAS.registered() == before


def test_schema_without_a_part_cannot_be_made() -> None:
    with pytest.raises(TypeError, match="open_decoder"):
        Schema(
            "other", 2, "points", ("places",), 1024, scene_type=PointScene, provides=frozenset(), prepare=prepare,
            update_digest=lambda digest, rows: None,
        )  # fmt: skip
    with pytest.raises(InvalidValueError, match="expected a complete Schema"):
        register_schema(SCHEMAS["gaussians"])


@pytest.fixture
def more_schemas() -> Iterator[Callable[[Schema], Schema]]:
    """Registers schemas for one test."""
    kept = SCHEMAS.registered()
    yield register_schema
    for name in set(SCHEMAS.registered()) - set(kept):
        del SCHEMAS._entries[name], SCHEMAS._sources[name]


def test_schema_of_the_most_specific_scene_type_codes_a_scene(scene: PointScene, more_schemas: Any) -> None:
    class FinePoints(PointScene):
        pass

    class FinestPoints(FinePoints):
        pass

    more_schemas(points_schema(name="fine", scene_type=FinePoints))
    assert schema_of(scene).name == "points"
    assert schema_of(FinePoints(scene.points)).name == schema_of(FinestPoints(scene.points)).name == "fine"
    more_schemas(points_schema(name="none_of_them", scene_type=FinestPoints, can_encode=lambda scene: False))
    assert schema_of(FinestPoints(scene.points)).name == "fine"
    more_schemas(points_schema(name="other_fine", scene_type=FinePoints))
    with pytest.raises(InvalidValueError, match="schemas 'fine' and 'other_fine' both code FinePoints"):
        schema_of(FinePoints(scene.points))


def test_packets_of_a_schema_that_cannot_repack_stay(scene: PointScene, more_schemas: Any) -> None:
    class Fixed(PointScene):
        pass

    more_schemas(points_schema(name="fixed", scene_type=Fixed, prepare_repack=None))
    stream = encode_scene(Fixed(scene.points))
    assert not can_repack(stream)
    with pytest.raises(InvalidValueError, match="packets of points cannot be changed: encode the scene again"):
        repack(stream, Packetization(block_size=50, lanes=2))


def test_every_schema_of_the_package_is_complete() -> None:
    for name in SCHEMAS.registered():
        assert schema_named(name).name == name
    with pytest.raises(UnknownNameError, match="unknown schema 'absent'"):
        schema_named("absent")
