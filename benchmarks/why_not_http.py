"""PSNR of the view against seconds since the click: SOG and SPZ over HTTP, and a stream over HTTP and as datagrams.

    python benchmarks/why_not_http.py guitar.compressed.ply -o why_not_http.json    # as root, on Linux
    python benchmarks/why_not_http.py a.ply b.spz c.sog --full -o all.json          # every loss, round trip and rate
    python benchmarks/why_not_http.py plot why_not_http.json -o why_not_http.webp

Real stacks run over an emulated link (`emulated_link.py`): kernel TCP with CUBIC and with BBR, HTTP/3 of aioquic, and
splatwire's datagrams with retransmission, with and without parity. Losses go both ways. SOG and SPZ show nothing before
their last byte; received packets of a stream are decoded, concealed with `grow` and rendered. Pictures are those of the
file that was given. Seconds are the network's: decoding and drawing are not among them. A transfer ends after `--limit`
seconds.
"""

import argparse
import itertools
import json
import os
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import torch
from figures import publish

from splatwire.bitstream import SceneStream, packetization_named, read_stream, write_stream
from splatwire.bitstream.container import stream_from_bytes
from splatwire.codec import decode_stream, encode_scene
from splatwire.concealment import conceal
from splatwire.errors import SplatwireError
from splatwire.io.formats import read_splats, write_splats
from splatwire.metrics import psnr
from splatwire.render import iterate_views
from splatwire.render.importance import surrounding_cameras
from splatwire.render.precision import scene_class_offsets
from splatwire.types import SplatScene

LINK = Path(__file__).with_name("emulated_link.py")
WAYS: dict[str, dict[str, Any]] = {
    "SOG, HTTP/1.1, CUBIC": {"scheme": "http1", "congestion": "cubic", "kind": "sog"},
    "SOG, HTTP/1.1, BBR": {"scheme": "http1", "congestion": "bbr", "kind": "sog"},
    "SOG, HTTP/3": {"scheme": "http3", "kind": "sog"},
    "SPZ, HTTP/1.1, CUBIC": {"scheme": "http1", "congestion": "cubic", "kind": "spz"},
    "SPZ, HTTP/1.1, BBR": {"scheme": "http1", "congestion": "bbr", "kind": "spz"},
    "SPZ, HTTP/3": {"scheme": "http3", "kind": "spz"},
    ".swz, HTTP/1.1, CUBIC": {"scheme": "http1", "congestion": "cubic", "kind": "swz"},
    ".swz, HTTP/1.1, BBR": {"scheme": "http1", "congestion": "bbr", "kind": "swz"},
    ".swz, HTTP/3": {"scheme": "http3", "kind": "swz"},
    "datagrams": {"scheme": "datagrams", "parity": 0.0, "kind": "swz"},
    "datagrams, parity 0.3": {"scheme": "datagrams", "parity": 0.3, "kind": "swz"},
}
CAP, GOOD = 60.0, (30.0, 40.0)
SHARES = (0.02, 0.05, 0.1, 0.2, 0.35, 0.5, 0.65, 0.8, 0.9, 0.95, 0.99, 1.0)
"""Rows of a log at which the received packets are rendered."""


class Screen:
    """Reference pictures of a scene from around it, with which other scenes are compared."""

    def __init__(self, scene: SplatScene, views: int, width: int) -> None:
        self._cameras = surrounding_cameras(scene, views, width)
        self._truth = list(iterate_views(scene, self._cameras))

    def psnr(self, scene: SplatScene) -> float:
        """Mean PSNR over the views, at most `CAP`, decibels."""
        pairs = zip(iterate_views(scene, self._cameras), self._truth, strict=True)
        return round(float(np.mean([min(float(psnr(a[None], b[None])[0]), CAP) for a, b in pairs])), 2)


def moments(rows: list) -> list[tuple[float, int]]:
    """Selects some times of a log, each with the number of log rows up to it."""
    ends = sorted({max(1, round(share * len(rows))) for share in SHARES})
    return [(rows[end - 1][0], end) for end in ends]


def curve(way: dict, log: dict, path: Path, whole: SceneStream, screen: Screen) -> list[tuple[float, float]]:
    """Times since the click in seconds, and PSNR, at which something new was drawn."""
    rows = log["rows"]
    if way["kind"] != "swz":
        return [(rows[-1][0], screen.psnr(SplatScene(read_splats(path))))] if log["complete"] else []
    found = []
    if way["scheme"] == "datagrams":
        head = next((row for row, (_, event) in enumerate(rows) if event == "head"), len(rows))
        arrivals, packets = rows[head + 1 :], {repr(packet.id): packet for packet in whole.packets}
        for at, _ in moments(arrivals) if arrivals else ():
            there = [packets[name] for seconds, name in arrivals if seconds <= at]
            found.append((at, whole.with_packets(tuple(sorted(there, key=lambda packet: packet.id)))))
    else:
        data = path.read_bytes()
        for at, end in moments(rows) if rows else ():
            try:
                found.append((at, stream_from_bytes(data[: rows[end - 1][1]])[0]))
            except SplatwireError:  # side information is still missing
                continue
    return [(at, screen.psnr(conceal(decode_stream(part), "grow"))) for at, part in found if part.packets]


def summary(points: list[tuple[float, float]], complete: bool, log: dict) -> dict[str, object]:
    """Time until each state in seconds; None if a state was not reached."""
    first = {f"{good:g} dB": next((at for at, level in points if level >= good), None) for good in GOOD}
    return {**first, "complete": log["rows"][-1][0] if complete else None, "curve": points}


def written(source: Path, folder: Path) -> dict[str, Path]:
    """Writes a scene in all formats; its own format is the file itself."""
    splats, files = read_splats(source), {}
    for kind in ("sog", "spz"):
        files[kind] = source if source.suffix == f".{kind}" else folder / f"{source.stem}.{kind}"
        if files[kind] is not source:
            write_splats([splats], files[kind])
    scene, files["swz"] = SplatScene(splats), folder / f"{source.stem}.swz"
    packets = packetization_named("datagram", "gaussians", splats.num_gaussians)
    write_stream(encode_scene(scene, packets, class_offsets=scene_class_offsets(scene)), files["swz"])
    return files


def measure(source: Path, cells: list[dict], options: argparse.Namespace) -> dict[str, object]:
    """All ways over all links."""
    rows: list[dict[str, Any]] = []
    jobs: list[tuple[str, dict, dict]] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        files = written(source, folder)
        whole = read_stream(files["swz"])[0]
        screen = Screen(SplatScene(read_splats(source)), options.views, options.width)
        for number, (cell, way) in enumerate(itertools.product(cells, options.ways)):
            log = folder / f"{number}.log"
            file = str(files[WAYS[way]["kind"]].resolve())
            jobs.append((way, cell, {**WAYS[way], **cell, "file": file, "log": str(log), "limit": options.limit}))

        def cross(job: dict) -> dict:
            command = [sys.executable, str(LINK), json.dumps(job)]
            return json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)

        with ThreadPoolExecutor(options.at_once) as pool:
            for (way, cell, job), link in zip(jobs, pool.map(cross, [job for *_, job in jobs]), strict=True):
                log = json.loads(Path(job["log"]).read_text())
                points = curve(WAYS[way], log, files[WAYS[way]["kind"]], whole, screen)
                rows.append({"way": way, **cell, **summary(points, log["complete"], log), "link": link["link"]})
                facts = {k: v for k, v in rows[-1].items() if k not in ("curve", "link")}
                print(json.dumps(facts), file=sys.stderr, flush=True)
        return {"bytes": {kind: path.stat().st_size for kind, path in files.items()}, "transfers": rows}


def plot(results: dict, output: Path) -> None:
    """Curves of the first file and seed: a row for each rate, a column for each loss."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
    from PIL import Image

    rows = next(iter(results["files"].values()))["transfers"]
    kept = {key: rows[0][key] for key in ("seed", "round_trip", "bursts")}
    rows = [row for row in rows if all(row[key] == value for key, value in kept.items())]
    rates, losses = (sorted({row[key] for row in rows}) for key in ("mbit", "loss"))
    figure, axes = plt.subplots(
        len(rates), len(losses), figsize=(11, 5), sharex=True, sharey=True, squeeze=False, layout="constrained"
    )
    ways = [way for way in WAYS if any(row["way"] == way for row in rows) and not way.startswith("SPZ")]
    for row in rows:
        if row["way"] not in ways or not row["curve"]:
            continue
        axis = axes[rates.index(row["mbit"])][losses.index(row["loss"])]
        seconds, levels = zip(*row["curve"], strict=True)
        dashed = "--" if "HTTP/1.1, C" in row["way"] else ":" if "HTTP/3" in row["way"] else "-"
        color = f"C{0 if 'SOG' in row['way'] else 1 if 'swz' in row['way'] else 2 + ('parity' in row['way'])}"
        values = [
            max(levels[: end + 1]) if "datagrams" not in row["way"] else levels[end] for end in range(len(levels))
        ]
        axis.step([seconds[0], *seconds, results["limit"]], [0, *values, values[-1]], where="post", ls=dashed,
                  color=color, label=row["way"], lw=1.3)  # fmt: skip
    for (r, rate), (c, loss) in itertools.product(enumerate(rates), enumerate(losses)):
        axes[r][c].set(xscale="log", xlim=(0.2, results["limit"]), ylim=(10, 62))
        axes[r][c].set_title(f"{rate:g} Mbit/s, {loss:.0%} lost", fontsize=9)
        axes[r][c].grid(alpha=0.3)
    figure.supxlabel("seconds since the click", fontsize=9)
    figure.supylabel("PSNR, dB", fontsize=9)
    shown = {text: line for axis in axes.flat for line, text in zip(*axis.get_legend_handles_labels(), strict=True)}
    figure.legend([shown[w] for w in ways if w in shown], [w for w in ways if w in shown], fontsize=8,
                  loc="outside upper center", ncols=4)  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        figure.savefig(Path(folder) / "plot.png", dpi=80)
        Image.open(Path(folder) / "plot.png").convert("RGB").save(output, "WEBP", quality=70, method=6)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", nargs="+", type=Path, help="files of explicit Gaussians; or: plot RESULTS")
    parser.add_argument("--full", action="store_true", help="the whole grid: 60 links a file")
    parser.add_argument("--losses", nargs="*", type=float, default=[0.0, 0.01, 0.05, 0.2])
    parser.add_argument("--patterns", nargs="*", choices=["random", "bursts"], default=["random"])
    parser.add_argument("--round-trips", nargs="*", type=float, default=[0.1], help="seconds")
    parser.add_argument("--rates", nargs="*", type=float, default=[5.0, 20.0], help="Mbit/s")
    parser.add_argument("--seeds", nargs="*", type=int, default=[1])
    parser.add_argument("--ways", nargs="*", choices=list(WAYS), default=list(WAYS))
    parser.add_argument("--limit", type=float, default=60.0)
    parser.add_argument("--at-once", type=int, default=4, help="transfers at a time, each over a link of its own")
    parser.add_argument("--views", type=int, default=2)
    parser.add_argument("--width", type=int, default=224)
    parser.add_argument("-o", "--output", type=Path)
    options = parser.parse_args()
    if str(options.files[0]) == "plot":
        plot(json.loads(options.files[1].read_text()), options.output)
        return
    torch.set_num_threads(1)
    if options.full:
        options.losses, options.patterns = [0.0, 0.01, 0.05, 0.1, 0.2], ["random", "bursts"]
        options.round_trips, options.rates = [0.02, 0.1, 0.25], [5.0, 20.0]
    grid = itertools.product(options.losses, options.patterns, options.round_trips, options.rates, options.seeds)
    cells = [
        {"loss": loss, "bursts": pattern == "bursts", "round_trip": trip, "mbit": rate, "seed": seed}
        for loss, pattern, trip, rate, seed in grid
        if loss or pattern == options.patterns[0]
    ]
    facts = {"kernel": os.uname().release, "limit": options.limit, "views": options.views}
    files: dict[str, object] = {}
    for path in options.files:
        files[path.name] = measure(path, cells, options)
        publish({**facts, "load_average": os.getloadavg(), "files": files}, options.output)


if __name__ == "__main__":
    main()
