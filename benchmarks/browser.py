"""The receiver in a browser, measured in headless Chromium; prints one JSON object.

    python benchmarks/browser.py [scene.swz] [--pages 20] [--rate 4] > benchmarks/results/browser.json
    python benchmarks/browser.py [scene.swz] --minutes 10 > benchmarks/results/browser_open.json
    python benchmarks/browser.py [scene.swz] --elements 100 > benchmarks/results/browser_elements.json
    python benchmarks/browser.py --pictures biker.swz guitar.swz ... > benchmarks/results/browser_pictures.json

The stream is one of explicit Gaussians in datagrams, or the bundled scene's:

    splatwire encode scene.ply -o scene.swz --preset datagram --no-sketch

* `bundle`: bytes of the page's two scripts, plain and compressed with gzip -9. A preview needs the first one only.
* `decode`: processor time per Gaussian or anchor in node, which has Chromium's engine, and in Python on one thread,
  alternating. `view_us` is the time per visible anchor for the Gaussians of one camera.
* `pictures`: PSNR of the page's pictures against `splatwire render` for three orbit views. `concealed` is the same for
  each concealer with 20 % of the packets lost, against `splatwire decode --conceal`.
* `lossy`: a relay loses 20 % with 20 ms each way. Milliseconds from navigation to the preview (part of the page), the
  first packets, and half of the Gaussians on the screen. Each run uses a fresh page of a running browser. The page
  itself is loaded over loopback, not through the relay. `threads_busy` is the load of the machine.
* `pages`: simultaneous pages of one browser: number of pages with every packet, and of lost datagrams.

The second command leaves a page open over a link that is down for 3 of every 10 seconds. The rate is so low that the
transfer takes most of that time. The result has the missing packets, and the megabytes of the page's processes every
half minute.

The third command repeatedly creates an element on a third-party page, waits for its complete picture and removes it.
The result has the megabytes of the page and GPU processes after each tenth of the elements. It also has the objects
alive after the first and the last element. The page counts WebGL contexts (one is its own), workers, blob addresses and
observers. The browser counts nodes, listeners, workers and buffers after a garbage collection.

The fourth command measures `pictures` alone, for packed pages, by stream name.

WebGL runs in software on two cores, so drawing takes longer than on a graphics card.
"""

import argparse
import asyncio
import base64
import gzip
import io
import json
import math
import os
import random
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from splatwire.bitstream import CAUSAL, SceneStream, read_stream, stream_to_bytes
from splatwire.cli._bundled import ASSETS, SPLATS
from splatwire.codec import decode_stream
from splatwire.concealment import conceal
from splatwire.render import render_scene
from splatwire.transport import ServerLimits, make_served_stream
from splatwire.transport.http.content import RENDERER, SCRIPT, PageContent, WebTransportEndpoint, web_file
from splatwire.transport.http.pack import pack_stream
from splatwire.transport.http.server import PageServer
from splatwire.transport.protocol.preview import stream_preview
from splatwire.transport.quic.certificate import self_signed
from splatwire.transport.quic.common import WEBTRANSPORT_PATH, QuicLimits
from splatwire.transport.quic.server import QuicServer
from splatwire.types import Cameras

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))
sys.path.insert(0, str(Path(__file__).parent.parent / "tests" / "transport"))
from chromium import Browser, browser
from network import bernoulli
from relay import Relay

from web.host import hosting

WEB = Path(__file__).resolve().parent.parent / "web"
IDENTITY = self_signed()
ELEMENT = "document.querySelector('splat-wire')"
OVER = f"{ELEMENT}?.status && ({ELEMENT}.status.finished || {ELEMENT}.status.failed)"
SIZE = 400


def cameras_around_means(means: np.ndarray) -> Cameras:
    """Three cameras around a scene."""
    middle = np.median(means, axis=0)
    radius = float(np.quantile(np.linalg.norm(means - middle, axis=1), 0.9))
    views = []
    for degrees in (20, 140, 260):
        angle = math.radians(degrees)
        back = np.array([0.9 * math.sin(angle), -0.35, 0.9 * math.cos(angle)])
        back /= np.linalg.norm(back)
        z = -back
        x = np.cross([0.0, 1.0, 0.0], z)
        x /= np.linalg.norm(x)
        turn = np.stack([x, np.cross(z, x), z])
        view = np.eye(4)
        view[:3, :3], view[:3, 3] = turn, -turn @ (middle + back * radius * 2.6)
        views.append(view)
    focal = SIZE / 2 / math.tan(math.radians(25))
    lens = np.tile(np.float32([[focal, 0, SIZE / 2], [0, focal, SIZE / 2], [0, 0, 1]]), (3, 1, 1))
    return Cameras(np.stack(views).astype(np.float32), lens, SIZE, SIZE, ("a", "b", "c"))


def opened(page: Browser, url: str) -> dict[str, Any]:
    page.open("about:blank")
    page.open(url)
    page.wait_for(OVER, 300)
    return json.loads(page.evaluate(f"JSON.stringify({ELEMENT}.status)"))


def decode_times(path: Path, stream: SceneStream, rounds: int = 3) -> dict[str, float]:
    count, theirs, ours = stream.manifest.num_elements, [], []
    decode_stream(stream, threads=1)
    views = []
    for _ in range(rounds):
        began = time.process_time()
        decode_stream(stream, threads=1)
        ours.append(1e6 * (time.process_time() - began) / count)
        words = ["node", str(WEB / "scripts" / "time.mjs"), str(path)]
        report = json.loads(subprocess.run(words, capture_output=True, text=True, check=True).stdout)
        theirs.append(report["decode"])
        views.append(report["view"])
    python, node = min(ours), min(theirs)
    found = {"python_us": round(python, 2), "typescript_us": round(node, 2), "ratio": round(node / python, 2)}
    return found | ({"view_us": round(min(views), 2)} if stream.manifest.schema_name == CAUSAL else {})


def pictures(page: Browser, stream: SceneStream, concealer: str = "drop") -> list[float]:
    received = decode_stream(stream)
    cameras, scene = cameras_around_means(received.scene.positions), conceal(received, concealer)
    style = f"position: fixed; inset: auto; left: 0; top: 0; width: {SIZE}px; height: {SIZE}px"
    page.evaluate(f"{ELEMENT}.style.cssText = '{style}'")
    page.evaluate(f"{ELEMENT}.controlPanel.set({{concealer: '{concealer}'}})")
    found = []
    for view, expected in enumerate(render_scene(scene, cameras)):
        camera = {"viewmat": cameras.viewmats[view].tolist(), "focal": float(cameras.Ks[view, 1, 1]), "height": SIZE}
        data = page.resolve(f"{ELEMENT}.picture({json.dumps(camera)})").split(",")[1]
        picture = np.asarray(Image.open(io.BytesIO(base64.b64decode(data))).convert("RGB")) / 255.0
        found.append(round(float(-10 * np.log10(((picture - expected) ** 2).mean())), 2))
    return found


def concealed(page: Browser, url: str, stream: SceneStream) -> dict[str, list[float]]:
    opened(page, url)
    page.wait_for(f"{ELEMENT}.status.gaussians > 0")
    names = json.loads(page.evaluate(f"JSON.stringify({ELEMENT}.controlPanel.concealers)"))
    return {name: pictures(page, stream, name) for name in names}


def lossy(first: Browser, url: str, rounds: int = 7) -> dict[str, float]:
    times: dict[str, list[float]] = {}
    first.open("about:blank")
    for _ in range(rounds):
        time.sleep(2)  # the earlier page must be closed: its drawing took processor time
        page = first.another()
        page.open(url)
        page.wait_for(OVER, 300)
        page.wait_for(f"{ELEMENT}.status.times.half > 0")
        page.resolve("caches.delete('splatwire-1')")  # the next page starts empty
        began = page.evaluate(f"{ELEMENT}.status.began")
        for name, value in json.loads(page.evaluate(f"JSON.stringify({ELEMENT}.status.times)")).items():
            if value is not None:  # never visible alone, because the next state was drawn before it
                times.setdefault(f"{name}_ms", []).append(began + value)
        page.close()
    found = {name: round(statistics.median(values)) for name, values in times.items()}
    return found | {"threads_busy": round(os.getloadavg()[0], 1)}


def many(url: str, count: int) -> dict[str, Any]:
    with browser() as first:
        pages = [first, *(first.another(alone=True) for _ in range(count - 1))]
        for page in pages:
            page.open(url)
        for page in pages:
            page.wait_for(OVER, 300)
        found = [json.loads(page.evaluate(f"JSON.stringify({ELEMENT}.status)")) for page in pages]
    return {
        "pages": count, "complete": sum(status["complete"] for status in found),
        "by_datagrams": sum("datagrams" in status["transport"] for status in found),
    }  # fmt: skip


async def left_open(stream: SceneStream, minutes: float) -> dict[str, Any]:
    """Measures a page over an intermittent link."""
    served, began, every = make_served_stream(stream), time.monotonic(), 30.0
    limits = ServerLimits(fixed_rate=stream.num_bytes / (0.5 * 60 * minutes))
    server = QuicServer({"scene": served}, "127.0.0.1", 0, identity=IDENTITY, limits=limits)
    await server.start()

    def has_left() -> bool:
        return (time.monotonic() - began) % 10 > 7

    relay = Relay(server.port, has_left, has_left, delay_s=0.02)
    link = WebTransportEndpoint(relay.port, WEBTRANSPORT_PATH, IDENTITY.fingerprint)
    async with PageServer(PageContent({"scene": served}, link)) as pages:

        def drive() -> dict[str, Any]:
            kept, seconds = [], []
            with browser() as page:
                page.open(pages.url)
                for n in range(1, round(60 * minutes / every) + 1):
                    time.sleep(max(began + n * every - time.monotonic(), 0))
                    kept.append(round(page.memory() / 1e6))
                    seconds.append(round(time.monotonic() - began))
                status = json.loads(page.evaluate(f"JSON.stringify({ELEMENT}.status)"))
            lacking = len(stream.packets) - status["packets"]
            return {"minutes": minutes, "ended": status["finished"], "transport": status["transport"],
                    "packets_lacking": lacking, "datagrams_lost": relay.num_lost, "seconds": seconds,
                    "megabytes": kept}  # fmt: skip

        found = await asyncio.to_thread(drive)
    relay.close()
    server.close()
    return found


async def come_and_go(stream: SceneStream, count: int) -> dict[str, Any]:
    """Measures elements on a third-party page, one after another."""
    script = '<script type="module" src="splatwire.js"></script><canvas></canvas>'
    gone: dict[str, list[float]] = {"after": [], "pages_mb": [], "gpu_mb": [], "heap_mb": []}
    alive: dict[str, dict[str, int]] = {}
    make = "{const made = document.createElement('splat-wire'); made.src = 'scene.swz'; \
made.style.height = '20rem'; document.body.append(made)}"
    async with hosting({"page": script}, {"scene.swz": stream_to_bytes(stream)}) as host:

        def drive() -> dict[str, Any]:
            with browser() as page:
                page.open(f"{host.url}page")
                page.wait_for("customElements.get('splat-wire')", 120)
                page.evaluate("window.theirs = document.querySelector('canvas').getContext('webgl2'); 0")
                for n in range(1, count + 1):
                    page.evaluate(make)
                    page.wait_for(f"{ELEMENT}.view && {ELEMENT}.status.verified !== null", 300)
                    page.resolve(f"{ELEMENT}.view.sorted()")
                    page.evaluate(f"{ELEMENT}.remove(); events.length = 0")
                    page.wait_for("workers === 0", 60)
                    if n in (1, count):
                        report = page.alive()
                        del report["JSHeapUsedSize"]
                        alive[f"alive_after_{n}"] = page.evaluate("alive()") | report
                    if n % max(count // 10, 1) == 0:
                        gone["after"].append(n)
                        gone["pages_mb"].append(round(page.memory() / 1e6))
                        gone["gpu_mb"].append(round(page.memory("GPU") / 1e6))
                        gone["heap_mb"].append(round(page.alive()["JSHeapUsedSize"] / 1e6, 2))
                        print({name: values[-1] for name, values in gone.items()}, file=sys.stderr)
                lost = page.evaluate("theirs.isContextLost()")
            scene = {"elements": count, "gaussians": stream.manifest.num_elements}
            return {**scene, **gone, **alive, "host_context_lost": lost}

        return await asyncio.to_thread(drive)


def packed_pictures(paths: list[Path]) -> dict[str, list[float]]:
    """PSNR of the pictures of packed pages against the renderer's, by name."""
    found = {}
    with browser() as page, tempfile.TemporaryDirectory() as folder:
        for path in paths:
            stream, _ = read_stream(path)
            packed = Path(folder) / f"{path.stem}.html"
            packed.write_bytes(pack_stream(stream, path.stem))
            opened(page, packed.as_uri())
            page.wait_for(f"{ELEMENT}.status.gaussians > 0 && {ELEMENT}.status.verified")
            found[path.stem] = pictures(page, stream)
    return found


async def measure(stream: SceneStream, rate: float, count: int) -> dict[str, Any]:
    served = make_served_stream(stream, preview=stream_preview(stream.side_info, stream.manifest.schema_name))

    def server(limits: ServerLimits) -> QuicServer:
        ours = QuicLimits(128, 128)
        return QuicServer({"scene": served}, "127.0.0.1", 0, identity=IDENTITY, limits=limits, quic_limits=ours)

    plain = server(ServerLimits(64, 64))
    slow = server(ServerLimits(64, 64, fixed_rate=rate * 1e6 / 8))
    for each in (plain, slow):
        await each.start()
    rng = random.Random(3)
    relay = Relay(slow.port, bernoulli(0.2, rng), bernoulli(0.2, rng), delay_s=0.02, jitter=0.1)

    def content(port: int) -> PageContent:
        return PageContent({"scene": served}, WebTransportEndpoint(port, WEBTRANSPORT_PATH, IDENTITY.fingerprint))

    rough_copy = random.Random(4)
    part = stream.with_packets([packet for packet in stream.packets if rough_copy.random() >= 0.2])
    held = PageContent({"part": stream_to_bytes(part)})
    async with (
        PageServer(content(plain.port)) as clean, PageServer(content(relay.port)) as rough, PageServer(held) as gaps,
    ):  # fmt: skip

        def drive() -> dict[str, Any]:
            with browser() as page:
                found: dict[str, Any] = {}
                opened(page, clean.url)
                found["digest_equal"] = page.resolve(f"{ELEMENT}.verify()")
                found["pictures_db"] = pictures(page, stream)
                found["concealed_db"] = concealed(page, gaps.url, part)
                found["lossy"] = {"rate_mbit": rate, "preview": bool(served.preview), **lossy(page, rough.url)}
            return found | {"pages": many(clean.url, count)}

        found = await asyncio.to_thread(drive)
    relay.close()
    plain.close()
    slow.close()
    return found


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("stream", type=Path, nargs="?", default=ASSETS / SPLATS)
    parser.add_argument("--pages", type=int, default=20)
    parser.add_argument("--rate", type=float, default=4.0)
    parser.add_argument("--minutes", type=float, default=0.0)
    parser.add_argument("--elements", type=int, default=0)
    parser.add_argument("--pictures", type=Path, nargs="+", default=[])
    options = parser.parse_args()
    found: dict[str, Any]
    if options.pictures:
        found = {"pictures_db": packed_pictures(options.pictures)}
    elif options.elements:
        found = asyncio.run(come_and_go(read_stream(options.stream)[0], options.elements))
    elif options.minutes:
        found = asyncio.run(left_open(read_stream(options.stream)[0], options.minutes))
    else:
        found = measured(options.stream, options.rate, options.pages)
    print(json.dumps(found, indent=1))


def measured(path: Path, rate: float, pages: int) -> dict[str, Any]:
    stream, _ = read_stream(path)
    scripts = {name: web_file(name).encode() for name in (SCRIPT, RENDERER)}
    found = asyncio.run(measure(stream, rate, pages))
    bundle = {name: {"bytes": len(text), "gzip": len(gzip.compress(text, 9))} for name, text in scripts.items()}
    scene = {stream.manifest.elements.lower(): stream.manifest.num_elements, "bytes": stream.num_bytes}
    decode = decode_times(path.resolve(), stream)
    return {"scene": {"name": path.stem, **scene}, "bundle": bundle, "decode": decode, **found}


if __name__ == "__main__":
    main()
