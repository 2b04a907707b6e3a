"""The page against Spark and SuperSplat's viewer: time to a complete picture, and blocking of the main thread, as JSON.

    npm install three @sparkjsdev/spark @playcanvas/supersplat-viewer esbuild      # anywhere
    splatwire encode biker.spz -o biker.swz
    python benchmarks/page_speed.py biker.swz biker.spz biker.sog --modules node_modules > page_speed.json

All pages show the same scene in the same view, over one link that the local server emulates: 2.5 MB/s for all
connections together, and 40 ms before each response. Scripts are minified, compressed and cross the link, too. The
browser is restarted for each page. Pages alternate, and each figure is the median of the rounds.

`first_s` is the time from navigation to the first picture other than the background. `complete_s` is the time to the
picture after which all pictures are within 30 dB of the last one. `blocked_ms` is the total blocking time of
the main thread: the part of each task beyond 50 ms, by the clock. `blocked_processor_ms` is the same by processor time,
which does not depend on other programs. `main_ms` is the processor time of the main thread, `workers_ms` that of the
page's other threads, and `total_s` that of the browser's processes until the complete picture. `tail_ms` is the
processor time of the page's threads from two seconds after the complete picture on, per second. A page that shows
nothing in `--most` seconds has no figures of that round.

    python benchmarks/page_speed.py biker.swz --threads 1 4

measures decoding alone, without a slow link: seconds from the stream's head to its last Gaussian, and processor time of
the threads. The page sees a device with the given number of cores. Its element is hidden, because drawing by software
uses both cores.
"""

import argparse
import asyncio
import collections
import gzip
import io
import json
import os
import statistics
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from splatwire.bitstream import read_stream
from splatwire.codec import decode_stream
from splatwire.render.importance import cameras_around
from splatwire.transport.http.content import RENDERER, SCRIPT, web_file

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))
sys.path.insert(0, str(Path(__file__).parent.parent / "tests" / "transport"))
from chromium import browser

SIZE = (800, 600)
FOV = 50.0
"""Vertical field of view, degrees."""
EQUAL_DB = 30.0
ALLOWED_MS = 50.0
"""Time that a task may take before it counts as blocking, milliseconds."""
CHUNK = 1 << 13
VISIBLE = 0.02
"""Least standard deviation of the pixels of a picture, 0 to 1."""
OURS = """<!doctype html><meta charset="utf-8"><link rel="icon" href="data:,">
<style>body{margin:0} splat-wire{display:block;width:100vw;height:100vh}</style>
<script type="module" src="splatwire.js"></script>
<splat-wire src="scene.swz" panel="none" viewpoint="VIEWPOINT"></splat-wire>"""
CORES = """<!doctype html><script>
const Plain = Blob, Threads = Worker;
const seen = "Object.defineProperty(navigator, 'hardwareConcurrency', {value: NUMBER});";
let began = 0;
window.Blob = class extends Plain { constructor(parts, ...more) { super([seen, ...parts], ...more); } };
window.Worker = class extends Threads {
  constructor(...given) {
    super(...given);
    this.addEventListener("message", ({data}) => {
      if (data.kind === "info") began = performance.now();
      if (data.kind === "finished") window.decoded = (performance.now() - began) / 1e3;
    });
  }
};</script>"""
"""Start of a page that records the time of decoding and shows its worker a given number of cores."""
SPARK = """<!doctype html><meta charset="utf-8"><link rel="icon" href="data:,">
<style>body{margin:0;background:#000}</style><script type="module" src="spark.js"></script>"""
SPARK_SCRIPT = """
import * as THREE from "three";
import { SparkRenderer, SplatMesh } from "@sparkjsdev/spark";
const view = VIEW;
const renderer = new THREE.WebGLRenderer({ antialias: false });
renderer.setPixelRatio(1);
renderer.setSize(innerWidth, innerHeight);
document.body.appendChild(renderer.domElement);
const scene = new THREE.Scene();
scene.add(new SparkRenderer({ renderer }));
const splats = new SplatMesh({ url: view.url });
scene.add(splats);
const camera = new THREE.PerspectiveCamera(view.fov, innerWidth / innerHeight, 0.05, 1000);
camera.position.set(...view.eye);
camera.up.set(...view.up);
camera.lookAt(...view.target);
renderer.setAnimationLoop(() => renderer.render(scene, camera));
"""


class Link:
    """A slow link to a server of files: a shared rate, and a delay before each response."""

    def __init__(self, files: dict[str, tuple[str, bytes]], rate: float, delay: float) -> None:
        self.files, self.rate, self.delay = files, rate, delay
        self.free_at = 0.0
        self.port = 0
        self.loop = asyncio.new_event_loop()
        started = threading.Event()
        threading.Thread(target=self._run, args=(started,), daemon=True).start()
        started.wait()

    def _run(self, started: threading.Event) -> None:
        async def serve() -> None:
            server = await asyncio.start_server(self._connection, "127.0.0.1", 0)
            self.port = server.sockets[0].getsockname()[1]
            started.set()
            await server.serve_forever()

        asyncio.set_event_loop(self.loop)
        self.loop.run_until_complete(serve())

    async def _connection(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            while True:
                request = (await reader.readuntil(b"\r\n\r\n")).decode().split("\r\n")
                await self._answer(request, writer)
        except (asyncio.IncompleteReadError, ConnectionError):
            pass
        finally:
            writer.close()

    async def _answer(self, request: list[str], writer: asyncio.StreamWriter) -> None:
        name = request[0].split(" ")[1].partition("?")[0]
        kind, body = self.files.get(name, ("text/plain", b""))
        status = "200 OK" if name in self.files else "404 Not Found"
        first, end, more = 0, len(body), ""
        for line in request[1:]:
            key, _, value = line.partition(": ")
            if key.lower() == "range" and name in self.files:
                low, _, high = value.removeprefix("bytes=").partition("-")
                first, end = int(low), min(int(high) + 1 if high else len(body), len(body))
                status, more = "206 Partial Content", f"Content-Range: bytes {first}-{end - 1}/{len(body)}\r\n"
        body = body[first:end]
        if kind.startswith("text/"):
            body, more = gzip.compress(body, 9), f"{more}Content-Encoding: gzip\r\n"
        head = f"HTTP/1.1 {status}\r\nContent-Type: {kind}\r\nContent-Length: {len(body)}\r\nAccept-Ranges: bytes\r\n"
        await asyncio.sleep(self.delay)
        writer.write(f"{head}Cache-Control: no-store\r\n{more}\r\n".encode())
        for at in range(0, len(body), CHUNK):
            part, now = body[at : at + CHUNK], self.loop.time()
            self.free_at = max(self.free_at, now) + len(part) / self.rate
            if self.free_at > now:
                await asyncio.sleep(self.free_at - now)
            writer.write(part)
            await writer.drain()


def script(path: str, modules: Path, view: dict[str, Any]) -> bytes:
    """Bundles Spark's page with the packages of a folder."""
    words = [str(modules / ".bin" / "esbuild"), "--bundle", "--minify", "--format=esm", "--log-level=error"]
    text = path.replace("VIEW", json.dumps(view))
    done = subprocess.run(words, input=text.encode(), capture_output=True, check=True, cwd=modules.parent)
    return done.stdout


def pages(given: argparse.Namespace) -> dict[str, dict[str, tuple[str, bytes]]]:
    """Files of each page by URL path."""
    stream, _ = read_stream(given.stream)
    cameras = cameras_around(decode_stream(stream).scene.positions)
    pose = np.linalg.inv(cameras.viewmats[given.view].astype(np.float64))
    eye, forward, down = pose[:3, 3], pose[:3, 2], pose[:3, 1]
    eye = eye - given.back * forward
    target, up = eye + forward, -down
    html, js, binary = "text/html; charset=utf-8", "text/javascript", "application/octet-stream"
    viewpoint = " ".join(str(round(float(v), 5)) for v in (*eye, *target, *up))
    scripts = {f"/{name}": (js, web_file(name).encode()) for name in (SCRIPT, RENDERER)}
    swz = {
        "/": (html, OURS.replace("VIEWPOINT", viewpoint).encode()),
        "/scene.swz": (binary, given.stream.read_bytes()),
    }
    found = {"splatwire": swz | scripts}
    for file in given.others:
        view = {"url": f"scene{file.suffix}", "fov": FOV, "eye": eye.tolist(), "target": target.tolist(),
                "up": up.tolist()}  # fmt: skip
        found[f"spark{file.suffix}"] = {
            "/": (html, SPARK.encode()), "/spark.js": (js, script(SPARK_SCRIPT, given.modules, view)),
            f"/scene{file.suffix}": (binary, file.read_bytes()),
        }  # fmt: skip
        if file.suffix != ".spz":
            found[f"supersplat{file.suffix}"] = supersplat(file, given.modules, eye, target)
    return found


def supersplat(file: Path, modules: Path, eye: np.ndarray, target: np.ndarray) -> dict[str, tuple[str, bytes]]:
    """Files of SuperSplat's viewer, which turns the scene by 180 degrees about z."""
    folder = modules / "@playcanvas" / "supersplat-viewer" / "public"
    turn = np.array([-1.0, -1.0, 1.0])
    across = 2 * np.degrees(np.arctan(np.tan(np.radians(FOV / 2)) * SIZE[0] / SIZE[1]))  # it takes the larger angle
    initial = {"position": (turn * eye).tolist(), "target": (turn * target).tolist(), "fov": across}
    off = {"enabled": False}
    effects = {"sharpness": off | {"amount": 0}, "bloom": off | {"intensity": 1, "blurLevel": 2},
               "grading": off | {"brightness": 1, "contrast": 1, "saturation": 1, "tint": [1, 1, 1]},
               "vignette": off | {"intensity": 0.5, "inner": 0.3, "outer": 0.75, "curvature": 1},
               "fringing": off | {"intensity": 0.5}}  # fmt: skip
    settings = {"version": 2, "tonemapping": "none", "highPrecisionRendering": False,
                "background": {"color": [0, 0, 0]}, "postEffectSettings": effects, "animTracks": [],
                "cameras": [{"initial": initial}], "annotations": [], "startMode": "default"}  # fmt: skip
    page = (folder / "index.html").read_text().replace("./scene.compressed.ply", f"./scene{file.suffix}")
    return {
        "/": ("text/html; charset=utf-8", page.encode()),
        "/settings.json": ("text/json", json.dumps(settings).encode()),
        "/index.css": ("text/css", (folder / "index.css").read_bytes()),
        "/index.js": ("text/javascript", (folder / "index.js").read_bytes()),
        f"/scene{file.suffix}": ("application/octet-stream", file.read_bytes()),
    }  # fmt: skip


def measured(name: str, files: dict[str, tuple[str, bytes]], given: argparse.Namespace, number: int) -> dict[str, Any]:
    """Opens a page in a new browser; returns its figures."""
    link = Link(files, given.rate * 1e6, given.delay / 1e3)
    query = "?webgl&noui&noanim" if name.startswith("supersplat") else ""
    with browser() as page:
        page.patience = 120.0
        page.emulate(*SIZE)
        page.start_trace()
        began = time.time()
        address = f"http://127.0.0.1:{link.port}/{query}"
        frames = page.timed_frames(address, given.quiet, given.least, given.most)
        events = page.trace_events()
    if given.trace:
        given.trace.mkdir(parents=True, exist_ok=True)
        (given.trace / f"{name}-{number}.json").write_text(json.dumps(events))
    return figures(name, frames, events, began, given, number)


def decoding(files: dict[str, tuple[str, bytes]], threads: int) -> dict[str, float]:
    """Time of decoding with a number of cores, seconds, and processor time of the page's workers, milliseconds."""
    kind, page = files["/"]
    hidden = page.replace(b"display:block", b"display:none")
    seen = CORES.replace("NUMBER", str(threads)).encode() + hidden
    link = Link(files | {"/": (kind, seen)}, 1e9, 0.0)
    with browser() as opened:
        opened.emulate(*SIZE)
        opened.start_trace()
        opened.open(f"http://127.0.0.1:{link.port}/")
        seconds = opened.wait_for("window.decoded", 120)
        events = opened.trace_events()
    _, workers = threads_of(events)
    tasks = [e for e in events if (e["pid"], e["tid"]) in workers and e["name"].endswith("RunTask")]
    return {"decode_s": round(seconds, 3), "workers_ms": round(sum(e.get("tdur", 0) for e in tasks) / 1e3)}


def figures(name: str, frames: list[tuple[float, float, bytes]], events: list[dict[str, Any]], began: float,
            given: argparse.Namespace, number: int) -> dict[str, Any]:  # fmt: skip
    """Figures of a page from its pictures and its trace."""
    times = [at - began for at, *_ in frames]
    images = [np.asarray(Image.open(io.BytesIO(data)).convert("RGB"), np.float32) / 255 for *_, data in frames]
    if not images or images[-1].std() < VISIBLE:
        return {}
    if given.pictures:
        given.pictures.mkdir(parents=True, exist_ok=True)
        (given.pictures / f"{name}-{number}.jpg").write_bytes(frames[-1][2])
    ok = [float(((image - images[-1]) ** 2).mean()) <= 10 ** (-EQUAL_DB / 10) for image in images]
    last_bad = max((n for n, fine in enumerate(ok) if not fine), default=-1)
    first = next((at for at, image in zip(times, images, strict=True) if image.std() > VISIBLE), None)
    complete, total, _ = frames[min(last_bad + 1, len(times) - 1)]
    complete -= began
    main, others = threads_of(events)
    tasks = [e for e in events if e.get("ph") == "X" and e["name"].endswith("RunTask") and "dur" in e]
    mine = [e for e in tasks if (e["pid"], e["tid"]) in main]
    theirs = [e for e in tasks if (e["pid"], e["tid"]) in others]

    def over(key: str) -> float:
        return round(sum(max(e.get(key, 0) / 1e3 - ALLOWED_MS, 0) for e in mine))

    def processor(some: list[dict[str, Any]]) -> float:
        return round(sum(e.get("tdur", 0) for e in some) / 1e3)

    start = min((e["ts"] for e in mine), default=0)
    tail = start + (complete + 2) * 1e6
    seconds = max(max(e["ts"] + e.get("dur", 0) for e in events if "ts" in e) / 1e6 - tail / 1e6, 1)
    after = [e for e in (*mine, *theirs) if e["ts"] > tail]
    return {
        "first_s": round(first or complete, 2), "complete_s": round(complete, 2), "frames": len(frames),
        "blocked_ms": over("dur"), "blocked_processor_ms": over("tdur"),
        "longest_ms": round(max((e["dur"] / 1e3 for e in mine), default=0)), "main_ms": processor(mine),
        "workers_ms": processor(theirs), "total_s": round(total, 2),
        "tail_ms": round(processor(after) / seconds, 1),
    }  # fmt: skip


def threads_of(events: list[dict[str, Any]]) -> tuple[set[tuple[int, int]], set[tuple[int, int]]]:
    """The page's main thread and its workers; pages of the browser itself have other processes."""
    renderers = {e["pid"] for e in events if e["name"] == "process_name" and e["args"]["name"] == "Renderer"}
    calls = [e for e in events if e["name"] == "FunctionCall" and e["pid"] in renderers]
    ours = collections.Counter(e["pid"] for e in calls if "//127.0.0.1:" in json.dumps(e.get("args", {})))
    page = {pid for pid, _ in ours.most_common(1)}
    names = [e for e in events if e["name"] == "thread_name" and e["pid"] in page]
    main = {(e["pid"], e["tid"]) for e in names if e["args"]["name"] == "CrRendererMain"}
    workers = {(e["pid"], e["tid"]) for e in names if e["args"]["name"] == "DedicatedWorker thread"}
    return main, workers


def decoded_by(given: argparse.Namespace) -> dict[str, Any]:
    """Decoding times by number of cores."""
    files = pages(given)["splatwire"]
    rounds: dict[str, list[dict[str, float]]] = {str(threads): [] for threads in given.threads}
    for _ in range(given.rounds):
        for threads in given.threads:
            rounds[str(threads)].append(decoding(files, threads))
            print(threads, rounds[str(threads)][-1], f"load {os.getloadavg()[0]:.1f}", file=sys.stderr, flush=True)
    median = {
        threads: {key: statistics.median(one[key] for one in some) for key in some[0]}
        for threads, some in rounds.items()
    }
    return {"scene": given.stream.stem, "cores": os.cpu_count(), "median": median, "rounds": rounds}


def main() -> None:
    """Prints one JSON object."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("stream", type=Path)
    parser.add_argument("others", type=Path, nargs="*", help="the same scene for the other viewers: .spz, .sog")
    parser.add_argument("--modules", type=Path, help="folder `node_modules` with the other viewers")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--quiet", type=float, default=4.0, help="seconds without a new picture that end a page")
    parser.add_argument("--least", type=float, default=10.0, help="seconds for a page, at least")
    parser.add_argument("--most", type=float, default=25.0, help="seconds for a page, at most")
    parser.add_argument("--rate", type=float, default=2.5, help="of the link, MB/s")
    parser.add_argument("--delay", type=float, default=40.0, help="of the link, milliseconds")
    parser.add_argument("--view", type=int, default=5, help="number of the view around the scene")
    parser.add_argument("--back", type=float, default=0.0, help="distance by which the camera moves back")
    parser.add_argument("--pictures", type=Path, help="folder for the last pictures")
    parser.add_argument("--trace", type=Path, help="folder for the traces")
    parser.add_argument("--only", nargs="+", help="names of pages")
    parser.add_argument("--threads", type=int, nargs="+", help="measure decoding with so many cores instead")
    given = parser.parse_args()
    if given.modules:
        given.modules = given.modules.resolve()
    if given.threads:
        print(json.dumps(decoded_by(given), indent=1))
        return
    every = {name: files for name, files in pages(given).items() if not given.only or name in given.only}
    rounds: dict[str, list[dict[str, Any]]] = {name: [] for name in every}
    for number in range(given.rounds):
        for name, files in every.items():
            rounds[name].append(measured(name, files, given, number))
            print(name, rounds[name][-1], f"load {os.getloadavg()[0]:.1f}", file=sys.stderr, flush=True)
    medians = {
        name: {key: statistics.median(one[key] for one in some if one) for key in next(filter(None, some), {})}
        for name, some in rounds.items()
    }
    print(json.dumps({"scene": given.stream.stem, "median": medians, "rounds": rounds}, indent=1))


if __name__ == "__main__":
    main()
