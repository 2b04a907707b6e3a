"""Node, its packages, and expected results of Python for the node tests."""

import fcntl
import functools
import hashlib
import json
import random
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from explicit import decode_splats
from reference.splitmix64 import splitmix64_reference
from splatwire.anchors.appearance import spawned_gaussians
from splatwire.bitstream import CAUSAL, SceneStream
from splatwire.bitstream.sections import sections_of
from splatwire.bitstream.stream import write_stream
from splatwire.codec import decode_stream
from splatwire.codec.gaussians.tables import flatness_table
from splatwire.codec.preview import preview_gaussians
from splatwire.codec.tiers import assign_stream_packets
from splatwire.concealment import conceal
from splatwire.concealment.sketch.section import SECTION
from splatwire.entropy.tables import exp2_table, half_width_table, inverse_scale_table, logistic_table, normal_table
from splatwire.ops.spherical_harmonics import DC
from splatwire.transport.protocol.messages import ParityRange, Request, Welcome
from splatwire.transport.protocol.wire import encode
from splatwire.types import Cameras
from web.pictures import concealers_of
from web.sketched import copies_of

CAMERA = {
    "viewmat": [[1, 0, 0, 0], [0, 1, 0, 0.1], [0, 0, 1, 2], [0, 0, 0, 1]], "focal": 200, "width": 160, "height": 120,
    "margin": 0,
}  # fmt: skip
"""Camera with strongly view-dependent Gaussians of anchors."""
WEB = Path(__file__).parents[2] / "web"


@functools.cache
def lacking() -> str:
    """Reason why node tests cannot run; empty otherwise."""
    if shutil.which("node") is None or shutil.which("npm") is None:
        return "node is not installed"
    with (WEB / "package-lock.json").open() as one_at_a_time:  # concurrent runs would remove each other's files
        fcntl.flock(one_at_a_time, fcntl.LOCK_EX)
        if _has_the_locked_packages():
            return ""
        done = subprocess.run(
            ["npm", "ci", "--no-audit", "--no-fund"], cwd=WEB, capture_output=True, text=True, timeout=300
        )
    assert "EUSAGE" not in done.stderr, f"package.json and package-lock.json of web/ disagree:\n{done.stderr}"
    return "" if done.returncode == 0 else f"npm cannot install the packages of web/: {done.stderr.strip()[-200:]}"


def _has_the_locked_packages() -> bool:
    """Returns True if `node_modules` matches the lock file, apart from packages of other systems."""
    installed = WEB / "node_modules" / ".package-lock.json"
    if not installed.is_file():
        return False
    wanted, there = (json.loads(file.read_text())["packages"] for file in (WEB / "package-lock.json", installed))
    return all(
        there.get(name, {}).get("version") == package["version"]
        for name, package in wanted.items()
        if name and not package.get("optional")
    )


def answers(streams: Sequence[tuple[Path, SceneStream]], preview: bytes) -> str:
    """Expected results of the node tests, as JSON."""
    tables = {
        "normal": normal_table(), "inverse": inverse_scale_table(), "widths": half_width_table(),
        "flatness": flatness_table(), "sixteenths": (exp2_table(8, 20)[:-1] - (1 << 20)) >> 16,
        "powers": exp2_table(10, 40),
        "exists": np.clip(logistic_table(), 32, 65504),
    }  # fmt: skip
    rng = random.Random(1)
    lanes = []
    for _ in range(50):
        seed, rank, count = rng.getrandbits(64), rng.randrange(1 << 28), rng.randrange(1, 257)
        lanes.append((str(seed), rank, count, splitmix64_reference(rank ^ seed) % count))
    shown, _ = preview_gaussians(preview)
    numbers = [*shown.means.ravel(), *shown.scales.ravel(), *shown.opacities, *shown.colors.ravel()]
    digests = {name: hashlib.sha256(",".join(map(str, t.tolist())).encode()).hexdigest() for name, t in tables.items()}
    welcome = Welcome(
        7, 2, 3, 400, bytes(32), 256, 12, 1150, 4, (ParityRange(1, 0, 0),) * 3, b"preview", view_dependent=True
    )
    return json.dumps({
        "tables": digests,
        "lanes": lanes,
        "request": encode(Request(7, bytes(16), "scène")).hex(),
        "welcome": encode(welcome).hex(),
        "gains": {str(path): gains_of(stream) for path, stream in streams if stream.manifest.num_packets > 1},
        "copies": {
            str(path): copies_of(decode_stream(stream))[1] for path, stream in streams
            if SECTION in sections_of(stream)
        },
        "splats": {str(path): first_packet(stream) for path, stream in streams},
        "camera": CAMERA,
        "preview": {"bytes": preview.hex(), "numbers": [float(n) for n in numbers]},
    })  # fmt: skip


def gains_of(stream: SceneStream) -> dict[str, list[float]]:
    """Size and opacity gains by concealer after every second packet of a stream, packet by packet."""
    received = stream.with_packets(stream.packets[::2])
    decoded, assignment = decode_stream(received), assign_stream_packets(received)
    there = [packet is not None for packet in assignment.packets]
    indices = assignment.members.indices[np.repeat(there, np.diff(assignment.members.starts))]
    found = {}
    for name in concealers_of(stream):
        hints = conceal(decoded, name).hints
        gains = np.stack([hints.size_gain, np.ones_like(hints.size_gain)], axis=1)
        if hints.opacity_gain is not None:
            gains[:, 1] = hints.opacity_gain
        found[name] = gains[indices].astype(np.float64).ravel().tolist()
        if name == SECTION:  # copies of received Gaussians are not drawn
            places = copies_of(decoded)[0]
            found[name] += (
                (gains[places] * ~decoded.loss_mask.fully_received[places, None]).astype(np.float64).ravel().tolist()
            )
    return found


def first_packet(stream: SceneStream) -> list[list[float]]:
    """The Gaussians of a stream's first packet as rows: position, quaternion, scales, opacity, colour, harmonics."""
    if stream.manifest.schema_name == CAUSAL:
        return first_anchors(stream)
    splats, known = decode_splats(stream.with_packets(stream.packets[:1]))
    colours = 0.5 + DC * splats.sh[:, 0]
    harmonics = splats.sh[:, 1:].reshape(len(splats.sh), -1)
    columns = (splats.means, splats.quats, splats.scales, splats.opacities[:, None], colours, harmonics)
    plan, packet = stream.manifest.plan, stream.packets[0]
    places = plan.members(packet.id, packet.num_elements)
    assert known[places].all()
    return np.concatenate([column[places] for column in columns], axis=1).astype(np.float64).tolist()


def first_anchors(stream: SceneStream) -> list[list[float]]:
    """Gaussians that `CAMERA` sees of the first packet's anchors, in the packet's order."""
    received = stream.with_packets(stream.packets[:1])
    lens = [[200.0, 0, 80], [0, 200.0, 60], [0, 0, 1]]
    cameras = Cameras(np.array(CAMERA["viewmat"])[None].astype(np.float32), np.array(lens)[None], 160, 120, ("view",))
    spawned = spawned_gaussians(decode_stream(received).scene, cameras, 0)
    members = assign_stream_packets(received).members
    indices = members.indices[: members.starts[1]].tolist()
    found = spawned.gaussians
    columns = (found.means, found.quats, found.scales, found.opacities[:, None], found.colors)
    rows = np.concatenate(columns, axis=1).astype(np.float64)[found.opacities >= 1 / 255].tolist()
    owners = spawned.anchor_index[found.opacities >= 1 / 255].tolist()
    assert rows
    return [row for _, row in sorted(zip(owners, rows, strict=True), key=lambda pair: indices.index(pair[0]))]


def write(stream: SceneStream, path: Path) -> tuple[Path, SceneStream]:
    """Writes a stream for the tests."""
    write_stream(stream, path)
    return path, stream
