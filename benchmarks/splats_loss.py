"""Explicit Gaussians at 20 % lost datagrams, with and without a sketch, and the overhead of packets, as JSON.

    python benchmarks/splats_loss.py conceal luigi.ply truck.splat --shares 0.01 0.04 -o splats_loss.json
    python benchmarks/splats_loss.py packets luigi.ply truck.splat -o splats_packets.json

Pictures are compared with the file's own from views around it, others than those that the sketch is calibrated on. One
stream of the same symbols is the payloads of a block's packets in one code, with continued models and without headers.
One stream of neighbours: Gaussians in Morton order, each predicted from all earlier ones.
"""

import argparse
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numba
import numpy as np
from figures import publish

from splatwire.bitstream import HEADER_BYTES, PRESETS, Packetization, SceneStream
from splatwire.calibration.sketch import sketch_of
from splatwire.calibration.sketch_config import SketchConfig
from splatwire.calibration.views import CalibrationViews
from splatwire.channel import parse_loss, transmit
from splatwire.cli._calibration import with_quick_sketch
from splatwire.codec import decode_stream, encode_scene, with_section
from splatwire.codec._coder_kernels import ENCODING, new_coder
from splatwire.codec.gaussians import _packet_kernels as kernels
from splatwire.codec.gaussians.attributes import empty_rows
from splatwire.codec.gaussians.fit import empty_statistics
from splatwire.codec.gaussians.quality import QUALITIES
from splatwire.codec.gaussians.side_info import read_side_info
from splatwire.codec.gaussians.source_scene import SourceScene
from splatwire.concealment import conceal
from splatwire.entropy.range_kernels import encoder_finish, encoder_start
from splatwire.io import open_scene
from splatwire.metrics import psnr
from splatwire.ops.compiled import njit
from splatwire.ops.threads import use_single_thread
from splatwire.render import iterate_views
from splatwire.render.importance import surrounding_cameras
from splatwire.render.precision import scene_class_offsets
from splatwire.types import SplatScene
from splatwire.types.scene import Scene

CONFIG = SketchConfig(views=12, scored_views=4, num_losses=1, num_held_out_losses=1)
WHOLE = Packetization(block_size=(1 << 16) - 1, lanes=1, grouping="contiguous")


def conceal_scene(path: Path, options: argparse.Namespace) -> dict[str, object]:
    scene = open_scene(path)
    stream = encode_scene(scene, PRESETS["datagram"], class_offsets=scene_class_offsets(scene))
    cameras = surrounding_cameras(scene, options.views, options.width)
    truth, loss = list(iterate_views(scene, cameras)), parse_loss("bernoulli:0.2", "datagram")

    def quality(shown) -> float:  # type: ignore[no-untyped-def]
        pairs = zip(iterate_views(shown, cameras), truth, strict=True)
        return sum(float(psnr(a[None], b[None])[0]) for a, b in pairs) / len(truth)

    def concealed(sent, name: str) -> float:  # type: ignore[no-untyped-def]
        """Mean over losses; a section changes neither packets nor which of them are lost."""
        lossy = [decode_stream(transmit(sent, loss, seed=seed)[0]) for seed in options.seeds]
        return sum(quality(conceal(received, name)) for received in lossy) / len(lossy)

    complete = decode_stream(stream)
    rows = {
        name: {"psnr": concealed(stream, name), "bytes": stream.num_bytes} for name in ("drop", "grow", "scene_free")
    }
    views = CalibrationViews(surrounding_cameras(complete.scene))
    for share in options.shares:
        made = sketch_of(stream, complete, views, SketchConfig(**{**vars(CONFIG), "share": share}))
        richer = with_section(stream, "sketch", made.section)
        rows[f"sketch {share}"] = {
            "psnr": concealed(richer, "sketch"), "bytes": richer.num_bytes, "copies": made.num_sketched,
        }  # fmt: skip
    rows["sketch of encode"] = quick_row(scene, lambda sent: concealed(sent, "sketch"))
    print(path.name, {name: round(row["psnr"], 2) for name, row in rows.items()}, file=sys.stderr, flush=True)
    return {"gaussians": scene.num_elements, "no loss": quality(complete.scene), "rows": rows}


def quick_row(scene: Scene, psnr_of: Callable[[SceneStream], float]) -> dict[str, float]:
    """Sketch that `encode --preset datagram` adds, and its processor time relative to the rest of encoding.

    Both are done twice and the second run counts, because the first one loads or compiles kernels.
    """
    for _ in range(2):
        marks = [time.process_time()]
        stream = encode_scene(scene, PRESETS["datagram"], class_offsets=scene_class_offsets(scene), threads=1)
        marks.append(time.process_time())
        richer = with_quick_sketch(stream, None, lambda task, share: None)
        marks.append(time.process_time())
    encoding, sketching = marks[1] - marks[0], marks[2] - marks[1]
    return {
        "psnr": psnr_of(richer), "bytes": richer.num_bytes, "seconds of encoding": encoding,
        "seconds of the sketch": sketching, "ratio": sketching / encoding,
    }  # fmt: skip


@njit(error_model="numpy")
def _encode_joined(
    tables, step_parameters, models, statistics, box_bits, block_means, source, sizes, buffer, rows, harmonics
):  # type: ignore[no-untyped-def]
    begin, coder = 0, new_coder(
        ENCODING, buffer, np.empty(0, np.int64), models, statistics, tables
    )  # fmt: skip
    encoder_start(coder.state)
    for size in sizes:
        end = begin + size
        order = begin + np.argsort(source[2][begin:end], kind="mergesort")
        kernels._code_packet(
            coder, step_parameters, box_bits, block_means, source, order, rows[begin:end], harmonics[begin:end],
            kernels.new_scratch(size),
        )  # fmt: skip
        begin = end
    return encoder_finish(buffer, coder.state)


def joined_bytes(scene: SplatScene, stream: SceneStream, classes: np.ndarray) -> int:
    """Bytes of a stream with the packets of each block joined, and with the same side information and manifest."""
    plan = stream.manifest.plan
    info = read_side_info(stream.side_info, plan.num_blocks)
    source, total = SourceScene.of(scene.splats, plan, classes, None, QUALITIES["default"]), 0
    for block in range(plan.num_blocks):
        sizes = np.array([p.num_elements for p in stream.packets if p.id.block == block])
        rows, harmonics = empty_rows(int(sizes.sum()), info.num_harmonic_columns)
        total += _encode_joined(
            info.kernel_tables, info.step_parameters(), info.models(), empty_statistics(), int(info.boxes.bits[block]),
            info.block_means[block], source.block_source(block, info), sizes,
            np.zeros(700 * len(rows), np.uint8), rows, harmonics,
        )  # fmt: skip
    return int(total) + stream.num_bytes - sum(packet.num_bytes for packet in stream.packets)


def packets_of(path: Path, _: argparse.Namespace) -> dict[str, object]:
    scene = open_scene(path)
    classes = scene_class_offsets(scene)
    whole = encode_scene(scene, WHOLE, class_offsets=classes)
    near = whole.num_bytes - HEADER_BYTES * len(whole.packets)
    found: dict[str, object] = {"gaussians": scene.num_elements, "one stream of neighbours": near}
    for name, preset in (("pak", "paper"), ("datagrams", "datagram")):
        stream = encode_scene(scene, PRESETS[preset], class_offsets=classes)
        joined = joined_bytes(scene, stream, classes)
        found[name] = {
            "bytes": stream.num_bytes, "over one stream of the same symbols": stream.num_bytes / joined - 1,
            "over one stream of neighbours": stream.num_bytes / near - 1,
        }  # fmt: skip
    print(path.name, found, file=sys.stderr, flush=True)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("task", choices=("conceal", "packets"))
    parser.add_argument("scenes", nargs="+", type=Path)
    parser.add_argument("--shares", type=float, nargs="*", default=[0.01, 0.04])
    parser.add_argument("--seeds", type=int, nargs="*", default=[0, 1, 2])
    parser.add_argument("--views", type=int, default=7)
    parser.add_argument("--width", type=int, default=224)
    parser.add_argument("-o", "--output", type=Path)
    options = parser.parse_args()
    use_single_thread()
    numba.set_num_threads(1)
    scenes: dict[str, dict] = {}
    for path in options.scenes:
        made = {"conceal": conceal_scene, "packets": packets_of}[options.task](path, options)
        scenes[path.name] = made
        result: dict[str, object] = {"scenes": scenes}
        if options.task == "conceal":
            names = next(iter(scenes.values()))["rows"]
            gains = {n: [s["rows"][n]["psnr"] - s["rows"]["drop"]["psnr"] for s in scenes.values()] for n in names}
            result["gain over drop, mean of scenes"] = {n: sum(g) / len(g) for n, g in gains.items()}
        publish(result, options.output)


if __name__ == "__main__":
    main()
