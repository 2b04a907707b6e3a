"""Edited scenes: packets that change if everything else is pinned, and bytes that must be sent.

    python benchmarks/updates.py $SPLATWIRE_DATA/splats/{tandt_truck_opensplat_116k.splat,biker.spz} > updates.json

A ball of 2 % of the Gaussians around one of `CENTRES` random Gaussians is deleted, moved by its radius, or recoloured.
Quantisation steps, precision classes, context tables, boxes and means of blocks are those of the first stream.

`replaced`: Gaussians that stay keep their packet. A packet with a removed Gaussian is encoded again without it;
a recoloured Gaussian stays in its packet. Gaussians that moved are in new packets.

`listed`: updates as `encode_update` makes them. No packet is replaced: removed Gaussians are listed, and all new or
recoloured ones are in new packets. The result of `apply_update` is checked against the edited scene.
"""

import argparse
import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from splatwire.bitstream import HEADER_BYTES, PRESETS, SceneStream
from splatwire.codec import apply_update, decode_stream, encode_scene, encode_update
from splatwire.codec.gaussians.attributes import to_sources, transform_harmonics
from splatwire.codec.gaussians.blocks import block_codes, choose_cell_shift, to_lattice
from splatwire.codec.gaussians.decoder import open_side_info
from splatwire.codec.gaussians.encoder import encode_block
from splatwire.codec.gaussians.side_info import SideInfo
from splatwire.codec.gaussians.source_scene import BlockSource
from splatwire.codec.update.apply import describe_update
from splatwire.io import open_scene
from splatwire.ops.spherical_harmonics import DC
from splatwire.render.precision import scene_class_offsets
from splatwire.types import SplatScene

SHARE, CENTRES = 0.02, 5
COLOUR = np.array([0.3, -0.2, 0.1], np.float32) / DC
"""Change of the RGB of a recoloured object, as spherical harmonics of degree 0."""
PACKETIZATIONS = {
    "paper": PRESETS["paper"],
    "datagram": PRESETS["datagram"],
    "datagram, blocks of 500": replace(PRESETS["datagram"], block_size=500),
}


def ball(scene: SplatScene, centre: int) -> tuple[np.ndarray, float]:
    """Indices of the Gaussians in a ball around one of them, `SHARE` of the scene; and the radius of the ball."""
    distances = np.linalg.norm(scene.splats.means - scene.splats.means[centre], axis=1)
    chosen = np.argsort(distances, kind="stable")[: round(SHARE * scene.num_elements)]
    return chosen, float(distances[chosen[-1]])


def edited(scene: SplatScene, chosen: np.ndarray, radius: float, edit: str) -> SplatScene:
    """The scene after an edit other than deletion, in the same order."""
    means, sh = scene.splats.means.copy(), scene.splats.sh.copy()
    if edit == "moved":
        means[chosen, 0] += np.float32(radius)
    if edit == "recoloured":
        sh[chosen, 0] += COLOUR
    return replace(scene, splats=replace(scene.splats, means=means, sh=sh))


def packet_bytes(stream: SceneStream, info: SideInfo, scene: SplatScene, n: int, left: np.ndarray) -> bytes:
    """Payload of packet `n` with only its Gaussians `left` (indices in coding order), which may have new colours."""
    plan, block = stream.manifest.plan, stream.packets[n].id.block
    members = np.sort(plan.block_indices(block))
    corner, bits = info.boxes.corners[block], int(info.boxes.bits[block])
    everything = to_lattice(scene.splats.means[members].astype(np.float64), info.lattice_bits, info.size_log) - corner
    cell_shift, some = choose_cell_shift(everything, bits), scene.splats.select(left)
    positions, s = everything[np.searchsorted(members, left)], to_sources(some, info.size_log)
    source = BlockSource(
        np.int64(cell_shift), np.int64(1), block_codes(positions, bits), positions,
        scene.coding.precision_classes[left].astype(np.int64), s.logs, s.axes, s.colours, transform_harmonics(some,
        info.transform),
    )  # fmt: skip
    return encode_block(source, info, block, np.array([len(left)]), 0).payloads[0]


def measured(stream: SceneStream, edit: str, centre: int) -> dict[str, int]:
    """Packets and bytes of one edit of a stream."""
    info, scene = open_side_info(stream.manifest, stream.side_info), decode_stream(stream).scene
    chosen, radius = ball(scene, centre)
    after = edited(scene, chosen, radius, edit)
    gone = np.zeros(scene.num_elements, bool)
    gone[chosen] = True
    changed, sent = 0, 0
    for n, packet in enumerate(stream.packets):
        ranks = stream.manifest.plan.members(packet.id, packet.num_elements)
        if not gone[ranks].any():
            continue
        changed += 1
        left = np.sort(ranks if edit == "recoloured" else ranks[~gone[ranks]])
        if len(left):
            payload = packet_bytes(stream, info, after, n, left)
            sent += HEADER_BYTES + len(payload)
    precision = scene.coding.precision_classes.astype(np.int64) - int(scene.coding.precision_classes.max())
    if edit == "deleted":
        after, precision = after.select(~gone), precision[~gone]
    update = encode_update(stream, after, class_offsets=precision)
    assert describe_update(stream, update)["num_removed"] == len(chosen)
    assert apply_update(stream, update).manifest.num_elements == after.num_elements
    new_bytes = sum(packet.num_bytes for packet in update.packets)
    return {
        "changed": changed, "replaced": sent + (new_bytes if edit == "moved" else 0),
        "listed": update.num_bytes,
    }  # fmt: skip


def main() -> None:
    """Measures all edits of the given scenes."""
    parser = argparse.ArgumentParser()
    parser.add_argument("scenes", nargs="+", type=Path)
    rows = []
    for path in parser.parse_args().scenes:
        scene = open_scene(path)
        scene = scene.select(scene.drawable)
        classes = scene_class_offsets(scene)
        centres = np.random.default_rng(0).integers(scene.num_elements, size=CENTRES)
        for name, packetization in PACKETIZATIONS.items():
            stream = encode_scene(scene, packetization, class_offsets=classes)
            for edit in ("deleted", "moved", "recoloured"):
                found = [measured(stream, edit, int(centre)) for centre in centres]
                totals = {"changed": len(stream.packets), "replaced": stream.num_bytes, "listed": stream.num_bytes}
                shares = {key: [round(one[key] / total, 4) for one in found] for key, total in totals.items()}
                rows.append({
                    "scene": path.name, "packetization": name, "bytes": stream.num_bytes,
                    "packets": len(stream.packets), "edit": edit, **shares,
                })  # fmt: skip
    print(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
