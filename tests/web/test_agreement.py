"""Python and TypeScript accept the same streams and decode arbitrary bytes to the same integers.

`SPLATWIRE_FUZZ_CASES=84000 pytest tests/web/test_agreement.py` runs longer, in parts: 84,000 manifests and tile
indexes, and 16,800 packets and side informations for each of six streams (100,800 each).
"""

import base64
import contextlib
import copy
import hashlib
import importlib.util
import itertools
import json
import math
import os
import random
import subprocess
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from codec.gaussians.test_gaussians import some_splats
from moving_sequences import cut_frames, darkened, lasting_frames, moving_frames
from mutations import HOSTILE, mutated_bytes, mutated_json
from random_numbers import Numbers
from splatwire.bitstream import (
    Packet,
    Packetization,
    SceneStream,
    make_packet,
    manifest_from_bytes,
    read_stream,
    stream_from_bytes,
    write_stream,
)
from splatwire.bitstream.limits import CODING_ORDERS, GROUPINGS, PACKAGINGS, SCHEMAS
from splatwire.bitstream.sections import sections_of, with_section
from splatwire.bitstream.tile_index import SECTION
from splatwire.codec import encode_scene
from splatwire.codec.decoding import decode_stream, open_decoder
from splatwire.codec.schema import PacketBatch
from splatwire.codec.sequence.lifetimes import SECTION as LIFETIMES
from splatwire.codec.sequence.side_info import open_side_info, write_side_info
from splatwire.codec.weight_bytes import framed
from splatwire.errors import BitstreamError, SplatwireError
from splatwire.files.byte_io import ByteReader, ByteWriter
from splatwire.lod import Viewpoint, cut_of, encode_levels, tiles_of
from splatwire.ops.spherical_harmonics import DC
from splatwire.sequence import Frame, SequenceOptions, encode_sequence
from splatwire.sequence.decoding import decode_frames
from splatwire.types import SplatScene
from web.node import WEB, lacking
from web.sketched import with_copies

pytestmark = pytest.mark.slow

CASES = int(os.environ.get("SPLATWIRE_FUZZ_CASES", "240"))
PART = 6000
"""Largest number of cases of one part; its results are one file."""
GOLDEN = Path(__file__).parents[1] / "golden"
EDGES = sorted(
    {max(0, (1 << bits) + d) for bits in (0, 3, 6, 8, 10, 12, 14, 16, 24, 28, 31, 32, 53, 64) for d in (-1, 0, 1)}
)
WORDS = [*GROUPINGS, *CODING_ORDERS, *PACKAGINGS, *SCHEMAS.registered(), "splatwire/stream", "00000007", "a" * 64]


def golden_streams() -> dict[str, SceneStream]:
    pinned = json.loads((GOLDEN / "gaussians.json").read_text())
    found = {name: stream_from_bytes(base64.b64decode(case["swz"]))[0] for name, case in pinned.items()}
    files = ("tiny_causal", "tiny", "tiny_clip", "tiny_shots", "tiny_units", "tiny_levels")
    return found | {name: read_stream(GOLDEN / f"{name}.swz")[0] for name in files}


def some_cuts(stream: SceneStream, rng: random.Random) -> list[dict[str, Any]]:
    """Tiles that are visible, and tiles that are requested, for some views."""
    tiles, found = tiles_of(stream), []
    for _ in range(CASES // 10):
        there = [rng.random() < 0.8 for _ in range(tiles.num_tiles)]
        matrix = np.eye(4)
        matrix[:3, :3] = np.linalg.qr(np.array([[rng.gauss(0, 1) for _ in range(3)] for _ in range(3)]))[0]
        matrix[:3, 3] = matrix[:3, :3] @ -tiles.low.mean(axis=0) + [rng.gauss(0, 1), rng.gauss(0, 1), rng.gauss(2, 3)]
        viewpoint = None if rng.random() < 0.1 else Viewpoint(matrix, rng.uniform(5, 500), 320, 240)
        budget = rng.randrange(2000)
        cut = cut_of(tiles, np.array(there), viewpoint, budget)
        camera = (
            None
            if viewpoint is None
            else {"viewmat": matrix.tolist(), "focal": viewpoint.focal, "width": 320, "height": 240}
        )
        found.append({"there": there, "look": camera, "budget": budget, "drawn": cut.drawn, "wanted": cut.wanted})
    return found


def manifest_of(codec: str, **changes: Any) -> dict[str, Any]:
    """Content of a manifest without its digest."""
    packetization = {
        "block_size": 100, "lanes": 4, "seed": 1337, "order": "morton", "grouping": "stratified", "packaging": "atomic",
    }  # fmt: skip
    content = {
        "schema": "splatwire/stream", "format_version": SCHEMAS[codec].format_version, "num_anchors": 1000,
        "num_packets": 40, "packetization": packetization, "side_info_bytes": 300, "side_info_digest": "0" * 64,
        "stream_id": "0000abcd", "symbols_digest": "f" * 64, "writer": 'splatwire "1" \\',
    }  # fmt: skip
    layout = {"feature_dim": 8, "num_offsets": 4, "feature_groups": [4, 4]}
    return copy.deepcopy({**content, **(layout if SCHEMAS[codec].layout else {"codec": codec}), **changes})


def bases() -> list[dict[str, Any]]:
    """Valid manifests of every kind."""
    packetization = manifest_of("causal")["packetization"]
    hashed = {**packetization, "grouping": "hashed", "lanes": 1, "packet_bytes": 1150}
    parts = {**packetization, "packaging": "separated"}
    large = {**packetization, "block_size": 65535, "lanes": 175}
    return [
        *(manifest_of(codec) for codec, schema in SCHEMAS.registered().items() if not schema.timed),
        manifest_of("tracks", tiers=[[300, 1], [300, 1], [0, 1], [400, 1]], packetization=hashed, num_packets=77),
        manifest_of("causal", packetization=hashed), manifest_of("gaussians", packetization=hashed, num_packets=77),
        manifest_of("hacpp", packetization=parts, num_packets=160),
        manifest_of("causal", tiers=[[200, 2], [800, 4]], num_packets=36),
        manifest_of("causal", num_anchors=0, num_packets=0),
        manifest_of("gaussians", num_anchors=3_500_000, side_info_bytes=380, packetization=large, num_packets=9450),
    ]  # fmt: skip


def mutated_manifest(base: dict[str, Any], rng: random.Random) -> bytes:
    """A manifest with one or two changes and, mostly, a valid digest."""
    content, kind = copy.deepcopy(base), rng.random()
    if kind < 0.3:
        try:
            content = json.loads(mutated_json(base, rng))
        except (RecursionError, ValueError):
            return b"[" * 100_000
    else:
        for _ in range(rng.randrange(3)):
            holder: Any = content
            while True:
                key = rng.choice(range(len(holder)) if isinstance(holder, list) else sorted(holder))
                if not isinstance(holder[key], list | dict) or not holder[key] or rng.random() < 0.1:
                    break
                holder = holder[key]
            old = holder[key]
            near = [old + d for d in (-1, 0, 1)] if type(old) is int else [old]
            holder[key] = rng.choice(
                [*near, *near, rng.choice(EDGES), rng.choice(WORDS), copy.deepcopy(rng.choice(HOSTILE))]
            )
        if rng.random() < 0.1:
            content["tiers"] = rng.choice(
                [
                    [],
                    [[1000, 4]],
                    [[1, 1], [999, 4]],
                    [[500, 4], [500, 5]],
                    [[500, 4, 1], [500, 4]],
                    [[0, 1], [1000, 1]],
                ]
            )
        if rng.random() < 0.05:
            content["packetization"] = {**base["packetization"], "packet_bytes": rng.choice([0, 1150])}
    if isinstance(content, dict) and rng.random() < 0.95:
        content["digest"] = digest_of(content)
    layout = rng.choice([{"separators": (",", ":")}, {"indent": 1}, {"ensure_ascii": False}])
    text = json.dumps(content, sort_keys=rng.random() < 0.5, **layout)
    if rng.random() < 0.05:
        text = rng.choice(
            ["\ufeff" + text, text + " ", text + "x", text.replace("1000", "1000.0"), text.replace("4", "04", 1)]
        )
    data = text.encode("utf-8", "surrogatepass")
    return mutated_bytes(data, rng) if rng.random() < 0.05 else data


def digest_of(content: dict[str, Any]) -> str:
    plain = {key: value for key, value in content.items() if key != "digest"}
    return hashlib.sha256(json.dumps(plain, sort_keys=True, separators=(",", ":")).encode()).hexdigest()[:16]


def accepted(data: bytes) -> bool:
    try:
        manifest_from_bytes(data)
    except BitstreamError:
        return False
    return True


def hostile_payload(payload: bytes, rng: random.Random) -> bytes:
    """Bytes that no encoder writes, including codes at the end of their span."""
    kept = payload[: rng.randrange(min(len(payload), 60) + 1)] if rng.random() < 0.7 else b""
    rest = rng.choice([b"\xff", b"\xff" * 3, b"\xff\xff\xff\xfe", b"\0", rng.randbytes(8)]) * rng.randrange(12)
    return kept + rest + rng.randbytes(rng.randrange(9))


def hostile_packets(stream: SceneStream, cases: int, rng: random.Random) -> list[tuple[int, int, int, str, str]]:
    """Packets and the digests of their decoded values."""
    manifest, found = stream.manifest, []
    decoder = open_decoder(manifest, stream.side_info)
    for _ in range(cases):
        packet, digest = rng.choice(stream.packets), hashlib.sha256()
        payload, count = hostile_payload(packet.payload, rng), packet.num_elements
        if manifest.packetization.hashed:
            count = rng.randrange(1, count + 1)
        altered = make_packet(packet.id, count, payload)
        batch = PacketBatch(packet.id.block, (altered,), (manifest.plan.members(packet.id, count),))
        decoder.update_digest(digest, decoder.decode(batch))
        text = base64.b64encode(payload).decode()
        found.append((packet.id.block, packet.id.index_in_block, count, text, digest.hexdigest()))
    return found


def hostile_heads(stream: SceneStream, cases: int, rng: random.Random) -> list[tuple[str, bool]]:
    """Side information with one changed common section, and whether it is accepted."""
    manifest, found = stream.manifest, []
    for _ in range(cases):
        reader = ByteReader(stream.side_info, "side information")
        sections = [reader.blob() for _ in SCHEMAS[manifest.schema_name].sections]
        hit = rng.randrange(len(sections))
        sections[hit] = mutated_bytes(sections[hit][:200], rng) + sections[hit][200:]
        data = b"".join(map(framed, sections)) + reader.rest()
        try:
            open_decoder(manifest, data)
        except SplatwireError:
            found.append((base64.b64encode(data).decode(), False))
        else:
            found.append((base64.b64encode(data).decode(), True))
    return found


def hostile_lifetimes(stream: SceneStream, cases: int, rng: random.Random) -> list[tuple[str, bool]]:
    """Side information with another lifetimes section, and whether it is accepted."""
    found = []
    for _ in range(cases):
        writer = ByteWriter()
        for _ in range(2):
            count = rng.randrange(4)
            writer.unsigned(count)
            for _ in range(count):
                writer.unsigned(rng.choice([0, 1, rng.randrange(100), rng.choice(EDGES[:-1])]))
                writer.unsigned(rng.choice([rng.randrange(1, 12), rng.choice(EDGES[:-1])]))
        data = writer.bytes() if rng.random() < 0.8 else mutated_bytes(writer.bytes(), rng)
        changed = with_section(stream, LIFETIMES, data)
        try:
            open_decoder(changed.manifest, changed.side_info)
        except SplatwireError:
            found.append((base64.b64encode(changed.side_info).decode(), False))
        else:
            found.append((base64.b64encode(changed.side_info).decode(), True))
    return found


def hostile_units(stream: SceneStream, cases: int, rng: random.Random) -> list[tuple[str, bool]]:
    """Side information with another unit of motion of a shot, and whether it is accepted."""
    info, found = open_side_info(stream.manifest, stream.side_info), []
    for _ in range(cases):
        shots, hit = list(info.shots), rng.randrange(len(info.shots))
        spacing = rng.choice([1, -1]) * rng.choice([rng.randrange(45), *EDGES[:-7]])
        shots[hit] = replace(shots[hit], log2_motion_unit=spacing)
        data = write_side_info(replace(info, shots=tuple(shots)))
        try:
            open_decoder(stream.manifest, data)
        except SplatwireError:
            found.append((base64.b64encode(data).decode(), False))
        else:
            found.append((base64.b64encode(data).decode(), True))
    return found


def hostile_views(stream: SceneStream, cases: int, rng: random.Random) -> list[tuple[str, bool]]:
    """Side information with other viewpoint and copies sections, and whether it is accepted."""
    found = []
    sketch = sections_of(stream).get("sketch")
    for _ in range(cases):
        name = rng.choice(["viewpoint", "viewpoint", "up", "extent", "background", *(["sketch"] if sketch else [])])
        if name == "sketch":
            data = mutated_bytes(sketch, rng)
        elif name == "up":
            data = rng.choice([b"y", b"-z", b"x", b"", b"--y", b"-", b"w", b"y\n", b"\xef\xbb\xbfy", b"\xff", b"-yy"])
        else:
            count = {"viewpoint": 9, "extent": 4, "background": 3}[name]
            numbers = [rng.choice([0.0, 1.0, 0.25, -1.0, 3.0, math.nan, math.inf, 3e38]) for _ in range(count)]
            if rng.random() < 0.7:
                numbers = [rng.choice([0.0, 0.25, 1.0]) for _ in range(count)]
            data = np.array(numbers, "<f4").tobytes()
            data = data if rng.random() < 0.9 else mutated_bytes(data, rng)
        changed = with_section(stream, name, data)
        try:
            open_decoder(changed.manifest, changed.side_info)
        except SplatwireError:
            found.append((base64.b64encode(changed.side_info).decode(), False))
        else:
            found.append((base64.b64encode(changed.side_info).decode(), True))
    return found


def hostile_indexes(stream: SceneStream, cases: int, rng: random.Random) -> list[tuple[str, dict[str, Any] | None]]:
    """Side information with another tile index and its content; None if refused."""
    section, found = sections_of(stream)[SECTION], []
    for _ in range(cases):
        data = bytearray(section)
        if rng.random() < 0.6:  # of equal length
            for _ in range(rng.randrange(1, 4)):
                data[rng.randrange(len(data))] = rng.choice([0, 1, 0x7F, 0x80, 0xFF, rng.randrange(256)])
        changed = with_section(stream, SECTION, bytes(data) if rng.random() < 0.6 else mutated_bytes(data, rng))
        said: dict[str, Any] | None = None
        with contextlib.suppress(BitstreamError):
            tiles = tiles_of(changed)
            sizes = [0, *np.cumsum(tiles.sizes).tolist()]
            said = {"packets": tiles.packets.tolist(), "offsets": sizes, "errors": tiles.errors.tolist()}
        found.append((base64.b64encode(changed.side_info).decode(), said))
    return found


def with_repeated_tracks(stream: SceneStream) -> SceneStream:
    """A clip without a third of its motion, and with packets of the rest that repeat the tracks of another one."""
    manifest, kept = stream.manifest, list[Packet]()
    for block, together in itertools.groupby(stream.packets, key=lambda packet: packet.id.block):
        packets = list(together)
        if not manifest.plan.is_keyframe(block):
            small = min(packets, key=lambda packet: packet.num_elements)
            packets = packets[: 2 * len(packets) // 3]
            packets[1::2] = [
                make_packet(packet.id, small.num_elements, small.payload, manifest.stream_id)
                for packet in packets[1::2]
            ]
        kept += packets
    return stream.with_packets(kept)


def lossy_clips(
    stream: SceneStream, folder: Path, shares: tuple[float, ...] = (1.0, 0.6)
) -> Iterator[tuple[Path, list[list[list[float]]]]]:
    """A lossy clip, and rows of every frame by track: track, position, rotation, sizes, appearance."""
    plan, rng = stream.manifest.plan, random.Random(3)
    for share in shares:
        kept = [p for p in stream.packets if plan.is_keyframe(p.id.block) or rng.random() < share]
        assert (len(kept) == len(stream.packets)) == (share == 1.0)
        path = folder.with_name(f"{folder.name}_{share}.swz")
        write_stream(stream.with_packets(kept), path)
        shown = []
        for frame in decode_frames(decode_stream(stream.with_packets(kept)).scene):
            s, tracks = frame.scene.splats, frame.tracks[:, None]
            columns = (tracks, s.means, s.quats, s.scales, s.opacities[:, None], 0.5 + DC * s.sh[:, 0])
            shown.append(np.concatenate([column.astype(np.float64) for column in columns], axis=1).tolist())
        yield path, shown


def web_script(name: str) -> Any:
    """Imports a script of `web/scripts`."""
    spec = importlib.util.spec_from_file_location(name, WEB / "scripts" / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_typescript_weights_equal_the_python_weights() -> None:
    made = web_script("make_weights")
    assert made.TARGET.read_text() == made.module(), "run web/scripts/make_weights.py"


def test_typescript_tables_equal_the_python_tables() -> None:
    made = web_script("make_tables")
    for name, module in made.FILES.items():
        assert (made.SOURCES / name).read_text() == module(), f"run web/scripts/make_tables.py: {name} is old"


def test_typescript_accepts_every_manifest_kind_except_empty_tiers() -> None:
    for base in bases():
        assert accepted(json.dumps({**base, "digest": digest_of(base)}).encode()), base
    empty = manifest_of("causal", tiers=[])
    with pytest.raises(BitstreamError, match="tiers"):
        manifest_from_bytes(json.dumps({**empty, "digest": digest_of(empty)}).encode())


@pytest.mark.parametrize("part", range(math.ceil(CASES / PART)))
def test_python_and_typescript_decoders_agree(tmp_path: Path, part: int) -> None:
    if reason := lacking():
        pytest.skip(reason)
    cases = min(PART, CASES - part * PART)
    rng, packets, heads, streams = random.Random(7 + part), {}, {}, golden_streams()
    for name, stream in streams.items():
        if not SCHEMAS[stream.manifest.schema_name].layout:
            write_stream(stream, tmp_path / f"{name}.swz")
            packets[str(tmp_path / f"{name}.swz")] = hostile_packets(stream, cases // 5, rng)
            heads[str(tmp_path / f"{name}.swz")] = hostile_heads(stream, cases // 5, rng)
    lives = hostile_lifetimes(streams["tiny_clip"], cases, rng)
    assert cases / 20 < sum(fine for _, fine in lives) < cases * 0.95, "too few lifetimes of one kind"
    heads[str(tmp_path / "tiny_clip.swz")] += lives
    sketched = with_copies(encode_scene(SplatScene(some_splats(300)), Packetization(block_size=200, lanes=1)))
    write_stream(sketched, tmp_path / "sketched.swz")
    views = {str(tmp_path / "sketched.swz"): hostile_views(sketched, cases // 2, rng)}
    for name in ("tiny_clip", "tiny_causal", "tiny_levels"):
        views[str(tmp_path / f"{name}.swz")] = hostile_views(streams[name], cases // 4, rng)
    judged = [fine for some in views.values() for _, fine in some]
    assert len(judged) / 20 < sum(judged) < len(judged) * 0.95, "too few views of one kind"
    for name, some in views.items():
        heads[name] = [*heads.get(name, []), *some]
    manifests = [mutated_manifest(rng.choice(bases()), rng) for _ in range(cases)]
    said = [accepted(data) for data in manifests]
    assert cases / 10 < sum(said) < cases * 0.9, "too few cases of one kind"
    answers = tmp_path / "answers.json"
    pairs = [(base64.b64encode(data).decode(), fine) for data, fine in zip(manifests, said, strict=True)]
    births = encode_sequence(map(Frame.of, moving_frames(3000)), SequenceOptions(group_frames=4))[0]
    assert LIFETIMES in sections_of(births)
    scattered = Numbers(part)
    wild = [replace(s, means=s.means + 0.1 * scattered.randn(*s.means.shape)) for s in moving_frames(1000)]
    confused = encode_sequence(map(Frame.of, wild), SequenceOptions(group_frames=4, order="tracked"))[0]
    dark = encode_sequence(darkened(moving_frames(300), range(3, 8)), SequenceOptions(group_frames=4))[0]
    shots = encode_sequence(cut_frames(300, 4, [1.0, 0.02, 30.0]), SequenceOptions(group_frames=4))[0]
    units = encode_sequence(lasting_frames(4, [1.0, 1 / 5000, 1.0]), SequenceOptions(group_frames=4))[0]
    write_stream(units, tmp_path / "units.swz")
    turned = hostile_units(units, cases // 2, rng)
    assert len(turned) / 20 < sum(fine for _, fine in turned) < len(turned) * 0.95, "too few units of one kind"
    heads[str(tmp_path / "units.swz")] = [*turned, *hostile_heads(units, cases // 5, rng)]
    packets[str(tmp_path / "units.swz")] = hostile_packets(units, cases // 5, rng)
    clips = {
        "tiny": streams["tiny_clip"], "births": births, "confused": confused, "dark": dark, "shots": shots,
        "units": units,
    }  # fmt: skip
    frames = {str(p): shown for name, clip in clips.items() for p, shown in lossy_clips(clip, tmp_path / name)}
    repeated = lossy_clips(with_repeated_tracks(confused), tmp_path / "repeated", (0.9,))
    frames |= {str(path): shown for path, shown in repeated}
    cuts = {str(tmp_path / "tiny_levels.swz"): some_cuts(streams["tiny_levels"], rng)}
    indexes = {str(tmp_path / "tiny_levels.swz"): hostile_indexes(streams["tiny_levels"], cases, rng)}
    taken = sum(said is not None for _, said in indexes[str(tmp_path / "tiny_levels.swz")])
    assert cases / 20 < taken < cases * 0.95, "too few indexes of one kind"
    fields = {
        "manifests": pairs, "packets": packets, "heads": heads, "frames": frames, "cuts": cuts, "indexes": indexes,
        "tiled": str(tmp_path / "tiled.swz"),
    }  # fmt: skip
    small = Packetization(block_size=200, lanes=1, grouping="hashed", packet_bytes=250)
    tiled = encode_levels(SplatScene(some_splats(2000)), small)
    write_stream(tiled, tmp_path / "tiled.swz")
    answers.write_text(json.dumps(fields))
    done = subprocess.run(
        ["node", "scripts/test.mjs", "only", "agreement"], cwd=WEB, capture_output=True, text=True, timeout=1200,
        env={**os.environ, "ANSWERS": str(answers)}, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-1000:]
    assert "skipped 0" in done.stdout
