"""A kind of scene that the package does not know, points with a colour, in one file.

It is encoded, lost in part, decoded while it arrives, concealed, drawn, sent, and refused by a page, without any other
file changing: the acceptance test of one trunk.
"""

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
import torch

from scenes import tiny_cameras
from splatwire.byte_io import ByteReader
from splatwire.channel import parse_loss, transmit
from splatwire.codec import ProgressiveDecoder, decode_stream, encode_scene, register_schema, registry, repack
from splatwire.codec.background import background_sections, read_background
from splatwire.codec.named_sections import concealer_sections
from splatwire.codec.schema import CodedPackets, Options, Prepared, Run, Schema
from splatwire.codec.weight_bytes import framed
from splatwire.conceal import conceal, concealer_names
from splatwire.errors import BitstreamError, DesyncError, InvalidValueError, MissingSideInfoError
from splatwire.model import Coverage, Partial, RenderHints
from splatwire.model.appearance import gaussians_of_view
from splatwire.packets import (
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
from splatwire.packets.limits import SCHEMAS, StreamSchema, register_stream_schema
from splatwire.packets.sections import read_sections, write_sections
from splatwire.render import render_scene
from splatwire.scene import Cameras, Erasures, Gaussians
from splatwire.scene.background import BLACK, Background
from splatwire.scene.rows import Rows
from splatwire.transport.pack import pack_stream
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

    def arrived(self, known: np.ndarray, places: np.ndarray) -> "Points":
        return Points(np.where(known[:, None], self.positions, places), self.colors * known[:, None])

    def kept(self, erasures: Erasures, proposed: "Points") -> "Points":
        return replace(self, colors=np.where(erasures.known[:, None], self.colors, proposed.colors))


@dataclass(frozen=True, eq=False)
class PointScene:
    ELEMENTS: ClassVar[str] = "points"
    COVERAGE: ClassVar[Coverage] = Coverage(size=1.0, opacity=0.0)
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
        return self.rows().kept

    @property
    def facts(self) -> dict[str, int | float]:
        return {"num_points": self.num_elements}

    def rows(self) -> Rows:
        return Rows(np.ones(self.num_elements, np.bool_), 0, 0, None)

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
        self.colors, self.groups, p = colors, plan.groups(), plan.packetization
        self.most = (p.packet_bytes - HEADER_BYTES) // 3 if p.hashed else len(colors)

    def runs(self) -> Iterator[slice]:
        return (slice(a, b) for a, b in itertools.pairwise(self.groups.starts.tolist()))

    def encode(self, run: slice) -> CodedPackets:
        rows = self.colors[self.groups.ranks[run]]
        cuts = [rows[at : at + self.most] for at in range(0, len(rows), self.most)]
        return CodedPackets(np.array([len(cut) for cut in cuts]), [cut.tobytes() for cut in cuts], (rows,))


class PointDecoder:
    order: np.ndarray | None = None
    whole_blocks, alone, again = False, True, False
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

    def expect(self, threads: int | None, progress: Callable[[float], None] | None = None) -> None:
        self.colors = np.zeros(self.places.shape, np.uint8)
        self.erasures = Erasures.of_anchors(np.zeros(len(self.places), np.bool_))

    def decode(self, run: Run) -> tuple[np.ndarray, ...]:
        sizes = (3 * run.counts).tolist()
        data = b"".join(payload[:n].ljust(n, b"\0") for payload, n in zip(run.payloads, sizes, strict=True))
        return (np.frombuffer(data, np.uint8).reshape(-1, 3),)

    def store(self, run: Run, rows: tuple[np.ndarray, ...]) -> None:
        self.colors[run.ranks], self.erasures.received[run.ranks] = rows[0], True

    def update_digest(self, digest: Any, rows: tuple[np.ndarray, ...]) -> None:
        digest.update(rows[0].tobytes())

    def scene(self) -> Partial:
        points = Points(self.places, self.colors)
        scene = PointScene(points, background=read_background(self.sections))
        return Partial(scene, self.erasures, concealer_sections(self.sections))


def prepare(scene: PointScene, options: Options) -> Prepared:
    plan = PacketPlan(options.packetization or PRESETS["datagram"], scene.num_elements, ())
    places = framed(scene.positions.astype("<f4").tobytes())
    side_info = places + write_sections(background_sections(scene.background))
    return Prepared(PointEncoder(scene.points.colors, plan), side_info, plan)


def prepare_again(stream: SceneStream, packetization: Packetization, threads: int | None) -> Prepared:
    return prepare(decode_stream(stream, threads=threads).scene, Options(packetization))


@pytest.fixture(scope="module", autouse=True)
def registered() -> Iterator[None]:
    register_stream_schema(StreamSchema("points", 2, "points", ("places",), 1024, page=False))
    register_schema(
        Schema("points", lambda scene: isinstance(scene, PointScene), frozenset((Points,)), prepare, prepare_again,
               PointDecoder, lambda digest, rows: digest.update(rows[0].tobytes()))
    )  # fmt: skip
    yield
    del SCHEMAS["points"], registry._SCHEMAS["points"]


@pytest.fixture
def scene() -> PointScene:
    rng = torch.Generator().manual_seed(2)
    points = Points(
        torch.rand(400, 3, generator=rng).numpy() - 0.5,
        (256 * torch.rand(400, 3, generator=rng).numpy()).astype(np.uint8),
    )
    return PointScene(points, background=(0.0, 0.25, 0.5))


@pytest.fixture(params=["datagram", "paper", "spread"])
def stream(scene: PointScene, request: pytest.FixtureRequest) -> SceneStream:
    small = {"datagram": replace(PRESETS["datagram"], packet_bytes=150), "paper": Packetization(block_size=90, lanes=4)}
    return encode_scene(scene, small.get(request.param, spread_packetization(400)))


def assert_same(one: Partial, other: Partial) -> None:
    assert np.array_equal(one.known, other.known)
    assert np.array_equal(one.scene.points.colors, other.scene.points.colors)
    assert one.scene.background == other.scene.background == (0.0, 0.25, 0.5)


def test_what_is_encoded_is_decoded(scene: PointScene, stream: SceneStream, tmp_path: Path) -> None:
    write_stream(stream, tmp_path / "points.swz")
    read, report = read_stream(tmp_path / "points.swz")
    whole = decode_stream(read)
    assert report.num_missing == whole.erasures.num_lost == 0
    assert np.array_equal(whole.scene.points.colors, scene.points.colors)
    assert stream.manifest.elements == "points"
    wrong = replace(stream, manifest=replace(stream.manifest, symbols_digest="0" * 64))
    with pytest.raises(DesyncError):
        decode_stream(wrong)


def test_it_goes_into_other_packets(scene: PointScene, stream: SceneStream) -> None:
    packed = repack(stream, Packetization(block_size=50, lanes=2))
    assert packed.manifest.packetization != stream.manifest.packetization
    assert_same(decode_stream(packed), decode_stream(stream))


def test_while_it_arrives_it_is_what_a_decoder_makes_of_the_same_packets(stream: SceneStream) -> None:
    lossy, record = transmit(stream, parse_loss("bernoulli:0.3"), seed=1)
    assert record.num_lost
    arriving = ProgressiveDecoder(stream.manifest, stream.side_info)
    for count, packet in enumerate(lossy.packets, start=1):
        assert len(arriving.add([packet])) == packet.num_elements
        if count % 4 == 0:
            assert_same(arriving.partial, decode_stream(stream.with_packets(lossy.packets[:count])))
    assert_same(arriving.snapshot(), decode_stream(lossy))


@pytest.mark.parametrize("name", ["drop", "grow"])
def test_its_losses_are_concealed_and_drawn(stream: SceneStream, name: str) -> None:
    whole, partial = decode_stream(stream), decode_stream(stream.with_packets(stream.packets[::2]))
    scene, known = conceal(partial, name), partial.known
    assert np.array_equal(scene.hints.left_out, ~known)
    assert np.array_equal(scene.points.colors[known], whole.scene.points.colors[known])
    assert bool((scene.hints.size_gain[known] > 1).any()) == (name == "grow")
    picture, complete = (render_scene(drawn, tiny_cameras(1, 48, 32)) for drawn in (scene, whole.scene))
    assert picture.shape == complete.shape == (1, 32, 48, 3)
    assert 0 < float(np.abs(picture - complete).mean()) < float(complete.mean())


def test_who_needs_more_is_not_offered_and_says_so(stream: SceneStream) -> None:
    partial = decode_stream(stream.with_packets(stream.packets[:3]))
    assert set(concealer_names((), partial.offers)) == {"drop", "grow"}
    for name in ("cari", "scene_free"):
        with pytest.raises(InvalidValueError, match=f"concealer '{name}' needs .* this stream of points has not: drop"):
            conceal(partial, name)


def test_a_page_refuses_it_politely(stream: SceneStream) -> None:
    with pytest.raises(InvalidValueError, match="a stream of points is not for browsers"):
        page_of_stream("scene", stream, None, "127.0.0.1")
    with pytest.raises(InvalidValueError, match="a stream of points is not for browsers"):
        pack_stream(stream, "points")
