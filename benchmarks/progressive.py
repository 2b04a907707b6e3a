"""Quality over bytes while a stream arrives, and what an arrival costs; prints one JSON object, draws a plot.

Bundled scene, datagram packets, its own cameras; quality is PSNR against the lossless scene's own renders. The same
anchors are sent in two orders: all alike (`interleaved`), and the most important tenth first (`tiers`).
"""

import argparse
import json
import statistics
import time
from importlib import resources
from pathlib import Path

import torch
from threadpoolctl import threadpool_limits

from splatwire.channel import parse_loss
from splatwire.codec import decode_stream, encode_scene
from splatwire.conceal import conceal
from splatwire.data import load_cameras
from splatwire.metrics import psnr
from splatwire.packets import PRESETS, SceneStream, read_stream
from splatwire.render import render_scene
from splatwire.render.importance import footprint_importance, surrounding_cameras
from splatwire.view import ProgressiveScene, plan_transfer
from splatwire.view.model import Settings, Viewer
from splatwire.view.sources import FileSource

ASSETS = Path(str(resources.files("splatwire").joinpath("assets")))
SHARES = (0.0, 0.01, 0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 1.0)


def make_streams(path: Path, tiers: tuple[float, ...]) -> dict[str, SceneStream]:
    scene = decode_stream(read_stream(path)[0]).scene
    importance = footprint_importance(scene, surrounding_cameras(scene))
    return {
        "interleaved": encode_scene(scene, PRESETS["datagram"]),
        "tiers": encode_scene(scene, PRESETS["datagram"], tiers=importance.tiers(tiers)),
    }


def curve(stream: SceneStream, loss: str, concealer: str, views, references, seed: int) -> list[dict]:
    transfer = plan_transfer(stream, parse_loss(loss), seed=seed)
    scene, before, points = ProgressiveScene(stream.manifest, stream.side_info, concealer), 0, []
    for share in SHARES:
        here = transfer.upto(share)
        scene.add(here[before:])
        before = len(here)
        with scene.reading() as current:
            quality = psnr(render_scene(current, views), references).clamp(max=100).mean()
        sent, seconds = transfer.moment(share)
        points.append(
            {"bytes": sent, "seconds_at_10_mbit": seconds, "anchors": scene.num_known, "psnr": round(float(quality), 3)}
        )
    return points


def costs(stream: SceneStream, concealer: str, share: float, repeat: int) -> dict:
    """CPU milliseconds of one packet's arrival when a share is there already: decode, conceal, and from scratch."""
    transfer = plan_transfer(stream, parse_loss("none"), seed=0)
    here = transfer.upto(share)
    began = time.process_time()
    scene = ProgressiveScene(stream.manifest, stream.side_info, concealer)
    opened = time.process_time() - began
    scene.add(here)
    with scene.reading():
        pass
    later = [arrival.packet for arrival in transfer.arrivals[len(here) : len(here) + repeat]]
    decode, update, rows = [], [], []
    for packet in later:
        began, before = time.process_time(), scene.recomputed
        scene.add([packet])
        middle = time.process_time()
        with scene.reading():
            pass
        decode.append(middle - began)
        update.append(time.process_time() - middle)
        rows.append(scene.recomputed - before)
    there = stream.with_packets([*here, *later])
    began = time.process_time()
    partial = decode_stream(there, threads=1)
    middle = time.process_time()
    conceal(partial, concealer)
    return {
        "concealer": concealer, "share_there": share, "incremental": scene.incremental,
        "anchors_per_packet": statistics.mean(packet.num_anchors for packet in later),
        "rows_per_packet": statistics.mean(rows), "open_ms": opened * 1e3,
        "decode_ms": statistics.median(decode) * 1e3, "conceal_ms": statistics.median(update) * 1e3,
        "decode_from_scratch_ms": (middle - began) * 1e3,
        "conceal_from_scratch_ms": (time.process_time() - middle) * 1e3,
    }  # fmt: skip


def frames(stream: SceneStream, cameras, concealer: str, repeat: int = 5) -> list[dict]:
    """CPU milliseconds of the viewer's pictures, heads and rasteriser included: median over views."""
    viewer, rows = Viewer(FileSource(stream)), []
    kinds = [("moving", 180, False, 0.0), ("still, without PSNR", 720, False, 0.0),
             ("still, with PSNR", 720, True, 0.0), ("playing, 1 % of the transfer later", 180, False, 0.01),
             ("another seed", 180, False, 0.0)]  # fmt: skip
    for kind, height, score, step in kinds:
        looks, times = cameras.scaled(height / cameras.height), []
        for number in range(repeat + 1):
            seed = number if kind == "another seed" else 0
            settings = Settings(concealer=concealer, seed=seed, progress=0.5 + step * number)
            began = time.process_time()
            viewer.frame(settings, looks.select([number * 3 % looks.num_views]), score=score)
            times.append(time.process_time() - began)
        picture = [looks.width, looks.height]
        rows.append({"kind": kind, "picture": picture, "ms": statistics.median(times[1:]) * 1e3})
    return rows


def plot(curves: list[dict], path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    losses = sorted({c["loss"] for c in curves})
    figure, axes = pyplot.subplots(1, len(losses), figsize=(6 * len(losses), 4), sharey=True, squeeze=False)
    for axis, loss in zip(axes[0], losses, strict=True):
        for c in (c for c in curves if c["loss"] == loss):
            style = "-" if c["order"] == "tiers" else "--"
            points = [p for p in c["points"] if p["psnr"] < 100]
            x, y = [p["bytes"] / 1e3 for p in points], [p["psnr"] for p in points]
            axis.plot(x, y, style, color={"drop": "C3", "grow": "C0", "idw": "C2"}.get(c["concealer"]), marker=".",
                      label=f"{c['concealer']}, {c['order']}")  # fmt: skip
        axis.set(title=f"loss {loss}", xlabel="kB sent, side information included", ylabel="PSNR, dB (lossless = 100)")
        axis.grid(alpha=0.3)
        axis.legend(fontsize=8)
    figure.tight_layout()
    figure.savefig(path, dpi=120)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--stream", type=Path, default=ASSETS / "snowmiku.swz")
    parser.add_argument("--cameras", type=Path, default=ASSETS / "snowmiku_cameras.json")
    parser.add_argument("--views", type=int, default=3)
    parser.add_argument("--scale", type=float, default=0.5)
    parser.add_argument("--concealers", nargs="+", default=["drop", "grow", "idw"])
    parser.add_argument("--losses", nargs="+", default=["none", "bernoulli:0.2"])
    parser.add_argument("--tiers", nargs="+", type=float, default=[0.05, 0.15])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--repeat", type=int, default=40)
    parser.add_argument("--threads", type=int, default=1, help="how many torch and the matrix library may use")
    parser.add_argument("--only-costs", action="store_true", help="what an arrival costs, and nothing else")
    parser.add_argument("--plot", type=Path)
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    threadpool_limits(limits=options.threads)
    print(json.dumps(measure(options), indent=1))


def measure(options: argparse.Namespace) -> dict:
    cameras = load_cameras(options.cameras)
    step = max(1, cameras.num_views // options.views)
    views = cameras.select(list(range(0, cameras.num_views, step))[: options.views]).scaled(options.scale)
    streams, curves, cost = make_streams(options.stream, tuple(options.tiers)), [], []
    references = render_scene(decode_stream(streams["interleaved"]).scene, views)
    for concealer in options.concealers:
        for share in (0.1, 0.5, 0.9):
            cost.append(costs(streams["interleaved"], concealer, share, options.repeat))
        if options.only_costs:
            continue
        for order, stream in streams.items():
            for loss in options.losses:
                points = curve(stream, loss, concealer, views, references, options.seed)
                curves.append({"order": order, "loss": loss, "concealer": concealer, "points": points})
    if options.only_costs:
        return {"anchors": streams["tiers"].manifest.num_anchors, "threads": options.threads, "costs": cost}
    if options.plot:
        plot(curves, options.plot)
    sizes = {order: stream.num_bytes for order, stream in streams.items()}
    anchors = streams["tiers"].manifest.num_anchors
    head = {order: plan_transfer(s, parse_loss("none"), seed=0).head_bytes for order, s in streams.items()}
    return {
        "anchors": anchors, "bytes": sizes, "head_bytes": head, "tiers": options.tiers, "views": views.num_views,
        "picture": [views.width, views.height], "viewer": frames(streams["interleaved"], cameras, "grow"),
        "costs": cost, "curves": curves,
    }  # fmt: skip


if __name__ == "__main__":
    main()
