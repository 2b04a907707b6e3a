"""Compares the picture of a web viewer in headless Chromium with that of splatwire for a PLY or SPZ, as JSON.

The viewer is Spark (MIT) on three.js, which are not dependencies of splatwire: install them anywhere with

    npm install three @sparkjsdev/spark
    python benchmarks/viewer.py FILE.ply --modules node_modules [--cameras CAMERAS.json] [--view 0] [--picture out.jpg]

Without cameras, views are from around the scene. SPZ has y up, so its Gaussians are turned back for the same view.

Chromium draws in software (SwiftShader). The page sends its picture to the local server. The saved picture has the
viewer on the left and splatwire on the right.
"""

import argparse
import base64
import io
import json
import shutil
import subprocess
import tempfile
import threading
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
from PIL import Image

from splatwire.data import load_cameras
from splatwire.io.formats import read_splats
from splatwire.metrics import psnr
from splatwire.render import render_scene
from splatwire.render.importance import cameras_around
from splatwire.types import Cameras, SplatScene

PAGE = """<!doctype html><meta charset="utf-8"><style>body{margin:0}</style>
<script type="importmap">{"imports": {"three": "/modules/three/build/three.module.js",
 "three/addons/": "/modules/three/examples/jsm/",
 "@sparkjsdev/spark": "/modules/@sparkjsdev/spark/dist/spark.module.js"}}</script>
<script type="module">
const post = (path, body) => fetch(path, {method: "POST", body});
try {
  const THREE = await import("three");
  const {SplatMesh, SparkRenderer} = await import("@sparkjsdev/spark");
  const view = await (await fetch("/view.json")).json();
  const renderer = new THREE.WebGLRenderer({antialias: false, preserveDrawingBuffer: true});
  renderer.setPixelRatio(1);
  renderer.setSize(view.width, view.height);
  renderer.setClearColor(0x000000, 1);
  document.body.appendChild(renderer.domElement);
  const scene = new THREE.Scene();
  scene.add(new SparkRenderer({renderer, preBlurAmount: 0.3, blurAmount: 0.0}));
  const splats = new SplatMesh({url: view.url});
  splats.scale.set(1, ...view.turn);
  scene.add(splats);
  await splats.initialized;
  const camera = new THREE.PerspectiveCamera(view.fov, view.width / view.height, 0.05, 1000);
  camera.matrixAutoUpdate = false;
  camera.matrix.set(...view.pose);
  camera.matrixWorldNeedsUpdate = true;
  scene.add(camera);
  let frames = 0;
  const started = performance.now();
  post("/progress", "loaded");
  renderer.setAnimationLoop(() => {
    renderer.render(scene, camera);
    if (++frames >= view.frames && performance.now() - started > 5000) {
      const gl = renderer.getContext();
      const count = splats.numSplats ?? (splats.packedSplats && splats.packedSplats.numSplats) ?? -1;
      renderer.setAnimationLoop(null);
      post("/done", JSON.stringify({count, driver: gl.getParameter(gl.VERSION),
                                    picture: renderer.domElement.toDataURL("image/png")}));
    }
  });
} catch (error) { post("/failed", String(error && error.stack || error)); }
</script>"""
FLAGS = ("--headless=new", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-first-run",
         "--disable-background-networking", "--disable-component-update", "--disable-sync")  # fmt: skip


class Server(SimpleHTTPRequestHandler):
    """Serves the page, the file and the modules; takes the result."""

    def __init__(self, *arguments, content: dict[str, bytes], modules: Path, results: dict, done, **more) -> None:
        self.content, self.results, self.done = content, results, done
        super().__init__(*arguments, directory=str(modules.parent), **more)

    def do_GET(self) -> None:
        path = self.path.partition("?")[0]
        if path in self.content:
            body = self.content[path]
            self.send_response(200)
            kind = {"/": "text/html", "/view.json": "application/json"}.get(path, "application/octet-stream")
            self.send_header("Content-Type", kind)
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)
        else:
            self.path = self.path.replace("/modules/", "/node_modules/", 1)
            super().do_GET()

    def do_POST(self) -> None:
        body = self.rfile.read(int(self.headers["Content-Length"]))
        self.results[self.path] = body
        self.send_response(204)
        self.end_headers()
        if self.path != "/progress":
            self.done.set()

    def log_message(self, *arguments: object) -> None:
        pass


def view_description(cameras: Cameras, view: int, kind: str, frames: int) -> dict:
    """A camera in the words of three.js: its pose (y up, z backward), and its vertical field of view in degrees."""
    pose = np.linalg.inv(cameras.viewmats[view].astype(np.float64)) @ np.diag([1.0, -1.0, -1.0, 1.0])
    focal = float(cameras.Ks[view, 1, 1])
    fov = 2 * np.degrees(np.arctan(cameras.height / 2 / focal))
    return {"width": cameras.width, "height": cameras.height, "fov": fov, "pose": pose.flatten().tolist(),
            "frames": frames, "url": f"/file{kind}", "turn": [-1, -1] if kind == ".spz" else [1, 1]}  # fmt: skip


def photograph(file: Path, cameras: Cameras, view: int, modules: Path, browser: str, seconds: float) -> dict:
    """Lets the viewer render a view; returns the data sent by the page."""
    description = json.dumps(view_description(cameras, view, file.suffix, frames=8)).encode()
    content = {"/": PAGE.encode(), f"/file{file.suffix}": file.read_bytes(), "/view.json": description}
    results: dict[str, bytes] = {}
    done = threading.Event()
    server = ThreadingHTTPServer(
        ("127.0.0.1", 0), partial(Server, content=content, modules=modules, results=results, done=done)
    )
    threading.Thread(target=server.serve_forever, daemon=True).start()
    with tempfile.TemporaryDirectory() as profile:
        address = f"http://127.0.0.1:{server.server_port}/"
        size = f"--window-size={cameras.width},{cameras.height}"
        process = subprocess.Popen(
            [browser, *FLAGS, size, f"--user-data-dir={profile}", "--remote-debugging-port=0", address],
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        finished = done.wait(seconds)
        process.terminate()
        process.wait(20)
        server.shutdown()
    if "/failed" in results:
        raise SystemExit(f"the page failed: {results['/failed'].decode()}")
    if not finished:
        loaded = "after it had loaded the file" if "/progress" in results else "and did not load the file"
        raise SystemExit(f"the page drew nothing in {seconds:.0f} s, {loaded}")
    return json.loads(results["/done"])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("file", type=Path)
    parser.add_argument("--cameras", type=Path)
    parser.add_argument("--modules", type=Path, default=Path("node_modules"), help="npm's folder node_modules")
    parser.add_argument("--view", type=int, default=0)
    parser.add_argument("--picture", type=Path, help="JPEG to write: the viewer's picture and ours")
    parser.add_argument("--seconds", type=float, default=300.0, help="how long to wait for the viewer")
    arguments = parser.parse_args()
    browser = shutil.which("chromium") or shutil.which("google-chrome")
    if browser is None or not (arguments.modules / "@sparkjsdev" / "spark").is_dir():
        raise SystemExit("needs chromium on PATH, and --modules with three and @sparkjsdev/spark")
    splats = read_splats(arguments.file)
    cameras = load_cameras(arguments.cameras) if arguments.cameras else cameras_around(splats.means, 8, 512)
    posted = photograph(
        arguments.file, cameras, arguments.view, arguments.modules.resolve(), browser, arguments.seconds
    )
    png = base64.b64decode(posted["picture"].partition(",")[2])
    theirs = np.asarray(Image.open(io.BytesIO(png)).convert("RGB"), dtype=np.float32) / 255
    ours = render_scene(SplatScene(splats), cameras.select([arguments.view]))[0]
    if arguments.picture:
        both = np.concatenate([theirs, ours], axis=1)
        Image.fromarray(np.rint(both * 255).astype(np.uint8)).save(arguments.picture, quality=85)
    versions = {
        name: json.loads((arguments.modules / name / "package.json").read_text())["version"]
        for name in ("three", "@sparkjsdev/spark")
    }
    print(
        json.dumps(
            {
                "gaussians_in_file": splats.num_gaussians,
                "gaussians_in_viewer": posted["count"],
                "psnr_viewer_to_ours": float(psnr(theirs[None], ours[None])[0]),
                "mean_viewer": float(theirs.mean()),
                "mean_ours": float(ours.mean()),
                "driver": posted["driver"],
                "versions": versions,
            },
            indent=1,
        )
    )


if __name__ == "__main__":
    main()
