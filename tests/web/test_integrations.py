"""Other programs read streams through the package: PlayCanvas, three.js with and without Spark, Babylon.js, and
splat-transform."""

import asyncio
import base64
import io
import json
import re
import time
from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from explicit import encode_splats
from moving_sequences import moving_frames
from random_numbers import Numbers
from scenes import tiny_cameras
from splatwire.bitstream import SceneStream, stream_to_bytes
from splatwire.codec import decode_stream, with_section
from splatwire.codec.antialiasing import SECTION as ANTIALIASED
from splatwire.codec.gaussians.quality import Quality
from splatwire.concealment import conceal
from splatwire.io import open_scene
from splatwire.io.formats import read_splats
from splatwire.io.formats.gltf_writer import write_gltf
from splatwire.io.formats.sog import read_sog
from splatwire.lod.sog_levels import write_sog_levels
from splatwire.render import render_scene
from splatwire.sequence import SequenceOptions, encode_sequence
from splatwire.sequence.decoding import decode_frame
from splatwire.types import Cameras, SplatScene
from transport.chromium import Browser, executable, isolated_page
from web.host import hosting
from web.installed import called, install, package
from web.node import WEB
from web.pictures import half_of
from web.test_page import SMALL, ball, run

pytestmark = [pytest.mark.slow, pytest.mark.extended]

OTHERS = {
    "typescript": "7.0.2", "vite": "8.3.8", "playcanvas": "2.23.3", "three": "0.187.0", "@types/three": "0.187.0",
    "@sparkjsdev/spark": "2.2.0", "@playcanvas/splat-transform": "3.7.0", "@babylonjs/core": "9.35.0",
}  # fmt: skip
VITE = """export default { base: "./", build: { target: "es2022",
  rolldownOptions: { input: ["playcanvas.html", "three.html"], checks: { bundlerTimings: false } } } };
"""
PAGE = """<!doctype html><link rel="icon" href="data:,"><style>body {{ margin: 0; }}</style>
<canvas width="240" height="180"></canvas><script type="module" src="./{name}.ts"></script>"""
PLAYCANVAS = """
import * as pc from "playcanvas";
import { app } from "./example";
declare global { interface Window { draw(pose: number[]): Promise<string>; failed?: string } }
const camera = new pc.Entity("camera"), view = new pc.Mat4(), height = 180, width = 240;
camera.addComponent("camera", { clearColor: new pc.Color(0.2, 0.5, 0.8), nearClip: 0.01, farClip: 100 });
camera.camera!.fov = 2 * Math.atan(height / 2 / width) * pc.math.RAD_TO_DEG;
app.root.addChild(camera);
app.start();
while (!app.root.findComponent("gsplat")) await new Promise((resolve) => setTimeout(resolve, 50));
window.draw = async (pose) => {
  view.set(pose);
  camera.setPosition(view.getTranslation());
  const there = new pc.Quat().setFromMat4(view), frame = () => new Promise((resolve) => app.once("frameend", resolve));
  // it forgets to sort for who moves while it sorts: a nudge
  camera.setRotation(new pc.Quat().setFromEulerAngles(1, 1, 0).mul(there));
  await frame();
  camera.setRotation(there);
  for (let n = 0; n < 5; n++) await frame();
  return app.graphicsDevice.canvas.toDataURL();
};
"""
THREE = """
import * as THREE from "three";
import { SparkRenderer } from "@sparkjsdev/spark";
import { load, scene } from "./example";
declare global { interface Window { draw(pose: number[]): Promise<string>; failed?: string } }
const width = 240, height = 180, canvas = document.querySelector("canvas")!;
const renderer = new THREE.WebGLRenderer({ canvas, preserveDrawingBuffer: true });
renderer.setClearColor(new THREE.Color().setRGB(0.2, 0.5, 0.8, THREE.SRGBColorSpace));
const angle = 2 * Math.atan(height / 2 / width) * 180 / Math.PI;
const camera = new THREE.PerspectiveCamera(angle, width / height, 0.01, 100);
const plane = (left: number, right: number, depth: number, colour: number) => {
  const shape = new THREE.PlaneGeometry((right - left) * depth, 20);
  const mesh = new THREE.Mesh(shape, new THREE.MeshBasicMaterial({ color: colour, side: THREE.DoubleSide }));
  mesh.position.set((left + right) / 2 * depth, 0, -depth);
  camera.add(mesh);
};
plane(-0.5, -0.125, 1, 0xff0000); // before the ball, over the left 45 pixels
plane(0.125, 0.5, 10, 0x00ff00); // behind it, over the right 45
scene.add(camera);
await load(renderer);
for (const spark of scene.children) if (spark instanceof SparkRenderer) spark.sortRadial = false;
window.draw = async (pose) => {
  new THREE.Matrix4().fromArray(pose).decompose(camera.position, camera.quaternion, camera.scale);
  for (let n = 0; n < 5; n++) {
    renderer.render(scene, camera);
    await new Promise((resolve) => setTimeout(resolve, 50));
  }
  return canvas.toDataURL();
};
"""
THREE_CORE = """
import { load, splats } from "./example";
import * as THREE from "three/webgpu";
declare global { interface Window { draw(pose: number[]): Promise<string>; failed?: string } }
const width = 240, height = 180, canvas = document.querySelector("canvas")!;
const renderer = new THREE.WebGPURenderer({ canvas, forceWebGL: true });
await renderer.init();
renderer.outputColorSpace = THREE.LinearSRGBColorSpace;
renderer.setClearColor(new THREE.Color(0.2, 0.5, 0.8));
const angle = 2 * Math.atan(height / 2 / width) * 180 / Math.PI;
const camera = new THREE.PerspectiveCamera(angle, width / height, 0.01, 100), scene = new THREE.Scene();
scene.add(camera, splats);
await load();
window.draw = async (pose) => {
  new THREE.Matrix4().fromArray(pose).decompose(camera.position, camera.quaternion, camera.scale);
  renderer.render(scene, camera);
  return canvas.toDataURL();
};
"""
BABYLON = """
import { FreeCamera } from "@babylonjs/core/Cameras/freeCamera.js";
import { Engine } from "@babylonjs/core/Engines/engine.js";
import { Color4 } from "@babylonjs/core/Maths/math.color.js";
import { Matrix, Quaternion, Vector3 } from "@babylonjs/core/Maths/math.vector.js";
import { Scene } from "@babylonjs/core/scene.js";
import { load } from "./example";
declare global { interface Window { draw(pose: number[]): Promise<string>; failed?: string } }
const engine = new Engine(document.querySelector("canvas"), false, { preserveDrawingBuffer: true });
const scene = new Scene(engine), camera = new FreeCamera("camera", Vector3.Zero(), scene);
scene.clearColor = new Color4(0.2, 0.5, 0.8, 1);
camera.fov = 2 * Math.atan(90 / 240);
camera.minZ = 0.01;
await load(scene);
// from a right-handed world with y down to the left-handed one with y up that the mesh was turned into
const flip = Matrix.Scaling(1, -1, 1), forward = Matrix.Scaling(1, 1, -1);
window.draw = async (pose) => {
  const place = forward.multiply(Matrix.FromArray(pose)).multiply(flip);
  camera.rotationQuaternion = new Quaternion();
  place.decompose(undefined, camera.rotationQuaternion, camera.position);
  for (let n = 0; n < 5; n++) {
    scene.render();
    await new Promise((resolve) => setTimeout(resolve, 50));
  }
  scene.render();
  return engine.getRenderingCanvas()!.toDataURL();
};
"""

PLAYCANVAS_CLIP = PLAYCANVAS.replace(
    'import { app } from "./example";',
    """import { play } from "./example";
import type { Clip } from "splatwire/clip";
declare global { interface Window { clip: Clip } }
const app = new pc.Application(document.querySelector("canvas")!);""",
).replace("app.start();", "app.start();\nwindow.clip = await play(app);")
THREE_CLIP = """
import * as THREE from "three";
import { SparkRenderer } from "@sparkjsdev/spark";
import type { Clip } from "splatwire/clip";
import { play } from "./example";
declare global { interface Window { draw(pose: number[]): Promise<string>; clip: Clip } }
const width = 240, height = 180, canvas = document.querySelector("canvas")!;
const renderer = new THREE.WebGLRenderer({ canvas, preserveDrawingBuffer: true });
renderer.setClearColor(new THREE.Color().setRGB(0.2, 0.5, 0.8, THREE.SRGBColorSpace));
const angle = 2 * Math.atan(height / 2 / width) * 180 / Math.PI, scene = new THREE.Scene();
const camera = new THREE.PerspectiveCamera(angle, width / height, 0.01, 100);
window.clip = await play(renderer, scene, camera);
for (const spark of scene.children) if (spark instanceof SparkRenderer) spark.sortRadial = false;
window.draw = async (pose) => {
  new THREE.Matrix4().fromArray(pose).decompose(camera.position, camera.quaternion, camera.scale);
  for (let n = 0; n < 5; n++) await new Promise((resolve) => requestAnimationFrame(resolve));
  return canvas.toDataURL();
};
"""

WHOLE = """
import {{ SparkRenderer, SplatMesh }} from "@sparkjsdev/spark";
import {{ loadSplats }} from "splatwire/three";
import * as THREE from "three";

export const scene = new THREE.Scene();
export async function load(renderer: THREE.WebGLRenderer): Promise<void> {{
  const spark = new SparkRenderer({{ renderer, preBlurAmount: 0.3, blurAmount: 0 }});
  scene.add(spark, {added});
}}
"""
"""The three.js example that adds the whole stream, from the README of the package."""

GLTF = """
import * as pc from "playcanvas";
export const app = new pc.Application(document.querySelector("canvas")!);
const asset = new pc.Asset("scene", "container", { url: "./scene.glb" });
asset.once("load", () => {
  const scene = (asset.resource as pc.ContainerResource).instantiateRenderEntity();
  scene.setLocalEulerAngles(0, 0, 180); // glTF has y up
  app.root.addChild(scene);
});
app.assets.add(asset);
app.assets.load(asset);
"""


def example(word: str) -> str:
    """The block of the package's README that contains a word."""
    blocks = re.findall(r"```ts\n(.*?)```", (WEB / "PACKAGE.md").read_text(), re.DOTALL)
    [found] = [block for block in blocks if word in block]
    return found.replace("/scene.swz", "./scene.swz").replace("/clip.swz", "./clip.swz")


def added_whole() -> str:
    """Code from the package's README that adds a whole stream at once."""
    [added] = re.findall(r"`(new SplatMesh\(.*?loadSplats.*?)`", (WEB / "PACKAGE.md").read_text())
    return WHOLE.format(added=added.replace("/scene.swz", "./scene.swz"))


@pytest.fixture(scope="module")
def stream() -> SceneStream:
    """Half of the packets of a ball."""
    return half_of(encode_splats(ball(degree=3), SMALL, background=(0.2, 0.5, 0.8), quality=Quality(10.0)))


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("theirs")
    install(folder, package(tmp_path_factory), OTHERS)
    return folder


def small_gaussians() -> SceneStream:
    """Half of the packets of Gaussians that are smaller than a pixel."""
    small = ball(degree=3)
    small = replace(small, scales=small.scales * 0.1)
    return half_of(encode_splats(small, SMALL, background=(0.2, 0.5, 0.8), quality=Quality(10.0)))


def antialiased_stream() -> SceneStream:
    """The same Gaussians, antialiased."""
    return with_section(small_gaussians(), ANTIALIASED, b"")


def built(project: Path, name: str, script: str, code: str) -> tuple[dict[str, str], dict[str, str]]:
    """Pages and scripts of a project; its page runs this script and, as `example`, this code."""
    (project / "example.ts").write_text(code)
    (project / f"{name}.ts").write_text(script)
    (project / f"{name}.html").write_text(PAGE.format(name=name))
    (project / "vite.config.js").write_text(VITE.replace('"playcanvas.html", "three.html"', f'"{name}.html"'))
    (project / "tsconfig.json").write_text(
        json.dumps(
            json.loads((project / "tsconfig.json").read_text()) | {"include": [f"{name}.ts", "example.ts"]}
        ).replace('"skipLibCheck": false', '"skipLibCheck": true')  # third-party libraries
    )
    called(["node_modules/.bin/tsc"], project)
    called(["node_modules/.bin/vite", "build", "--logLevel", "error"], project)
    scripts = {f"assets/{path.name}": path.read_text() for path in (project / "dist" / "assets").iterdir()}
    return {path.name: path.read_text() for path in (project / "dist").glob("*.html")}, scripts


def draws(
    project: Path,
    name: str,
    script: str,
    code: str,
    scene: tuple[str, bytes],
    cameras: Cameras,
    expected: Sequence[np.ndarray],
    decibels: float,
    frames: Sequence[int] = (),
) -> None:
    """A page of the project renders a scene as expected, or these frames of a clip, which then plays to its end.

    Other viewers sort in a worker without a completion event, so pictures are taken until one agrees.
    """  # fmt: skip
    pages, scripts = built(project, name, script, code)

    def drive(url: str) -> None:
        with isolated_page() as page:
            page.open(f"{url}{name}.html")
            page.wait_for("Boolean(window.draw)")
            for n, (pose, ours) in enumerate(zip(poses_of(cameras), expected, strict=True)):
                end = time.monotonic() + 60
                if frames:
                    page.evaluate(f"clip.pause(), clip.currentTime = {frames[n]} / clip.rate")
                while (agreement := psnr(ours, taken(page, pose))) <= decibels:
                    assert time.monotonic() < end, f"the last picture agrees by {agreement:.1f} dB only"
            if frames:
                page.evaluate("clip.addEventListener('ended', () => window.ended = true), clip.currentTime = 0")
                page.evaluate("clip.loop = false, clip.play()")
                page.wait_for("window.ended && clip.ended && clip.paused")
                assert page.evaluate("clip.currentTime * clip.rate") == pytest.approx(CLIP_FRAMES - 1)

    async def work() -> None:
        async with hosting(pages, dict([scene]), scripts) as host:
            await asyncio.to_thread(drive, host.url)

    run(work())


def taken(page: Browser, pose: list[float]) -> np.ndarray:
    picture = page.resolve(f"draw({json.dumps(pose)})").split(",")[1]
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(picture))).convert("RGB")) / 255.0


def poses_of(cameras: Cameras) -> list[list[float]]:
    """Camera to world, column by column, for cameras that face -z with y up."""
    return [(np.linalg.inv(view) @ np.diag([1.0, -1.0, -1.0, 1.0])).T.ravel().tolist() for view in cameras.viewmats]


def psnr(first: np.ndarray, second: np.ndarray) -> float:
    return float(-10 * np.log10(((first - second) ** 2).mean()))


@pytest.mark.skipif(executable() is None, reason="Chromium is not installed")
def test_playcanvas_draws_an_asset_that_is_a_stream(project: Path) -> None:
    """Antialiasing is respected as well: Gaussians are smaller than a pixel."""
    plain, cameras = small_gaussians(), tiny_cameras(2, 240, 180)
    asking = antialiased_stream()
    expected, other = (render_scene(conceal(decode_stream(each), "grow"), cameras) for each in (asking, plain))
    assert all(psnr(*pair) < 34 for pair in zip(expected, other, strict=True))
    code, scene = example("SwzParser"), ("scene.swz", stream_to_bytes(asking))
    draws(project, "playcanvas", PLAYCANVAS, code, scene, cameras, expected, 36)


@pytest.mark.skipif(executable() is None, reason="Chromium is not installed")
def test_playcanvas_draws_the_fallback_of_a_gltf_file_with_a_stream(project: Path, stream: SceneStream) -> None:
    """PlayCanvas reads KHR_gaussian_splatting and ignores EXT_splatwire."""
    cameras, fallback = tiny_cameras(2, 240, 180), ball(300, degree=0)
    expected = render_scene(SplatScene(fallback), cameras, background=np.array([0.2, 0.5, 0.8], np.float32))
    file = project / "scene.glb"
    write_gltf([fallback], file, stream=stream_to_bytes(stream))
    scene = ("scene.glb", file.read_bytes())
    draws(project, "playcanvas", PLAYCANVAS, GLTF, scene, cameras, list(expected), 36)


@pytest.mark.skipif(executable() is None, reason="Chromium is not installed")
@pytest.mark.parametrize("code", [example("splatsOf"), added_whole()], ids=["as it arrives", "whole"])
def test_spark_draws_a_stream_between_meshes(project: Path, stream: SceneStream, code: str) -> None:
    """A mesh in front hides Gaussians; one behind shows through them like a background of its colour."""
    cameras = tiny_cameras(2, 240, 180)
    grown = conceal(decode_stream(stream), "grow")
    over = list(render_scene(grown, cameras))
    green = list(render_scene(grown, cameras, background=(0.0, 1.0, 0.0)))
    scene = ("scene.swz", stream_to_bytes(stream))
    for picture, shining in zip(over, green, strict=True):
        picture[:, :90] = (1.0, 0.0, 0.0)
        picture[:, 150:] = shining[:, 150:]
    draws(project, "three", THREE, code, scene, cameras, over, 37)


@pytest.mark.skipif(executable() is None, reason="Chromium is not installed")
def test_mesh_of_threejs_draws_a_stream(project: Path) -> None:
    """Its mesh draws all Gaussians antialiased; colours, opacities and harmonics have 8 bits."""
    asking, cameras = antialiased_stream(), tiny_cameras(2, 240, 180)
    expected = render_scene(conceal(decode_stream(asking), "grow"), cameras)
    code, scene = example("splatwire/three-core"), ("scene.swz", stream_to_bytes(asking))
    draws(project, "three-core", THREE_CORE, code, scene, cameras, list(expected), 45)


CLIP_FRAMES = 10
CLIP_PAGES = {
    "playcanvas": (PLAYCANVAS_CLIP, "ClipEntity(app", 36),
    "three": (THREE_CLIP, "new ClipMesh", 37),
}


@pytest.mark.skipif(executable() is None, reason="Chromium is not installed")
@pytest.mark.parametrize("name", CLIP_PAGES)
@pytest.mark.parametrize("degree", [0, 3])
def test_other_renderers_play_clips(project: Path, name: str, degree: int) -> None:
    """Frames are shown in any order, and the number of Gaussians changes between them."""
    script, word, decibels = CLIP_PAGES[name]
    harmonics = Numbers(1).randn(600, (degree + 1) ** 2 - 1, 3) * 0.1
    moving = [
        replace(splats, sh=np.concatenate([splats.sh, harmonics], axis=1)) for splats in moving_frames(600, CLIP_FRAMES)
    ]
    stream, _ = encode_sequence(moving, SequenceOptions(Fraction(8), 4))
    scene, numbers = decode_stream(stream).scene, (0, 9, 5)
    cameras = tiny_cameras(len(numbers), 240, 180)
    background = np.array([0.2, 0.5, 0.8], np.float32)
    expected = [
        render_scene(decode_frame(scene, number).scene, cameras, background=background)[n]
        for n, number in enumerate(numbers)
    ]
    still = render_scene(decode_frame(scene, 0).scene, cameras, background=background)
    assert all(psnr(still[n], expected[n]) < decibels - 3 for n in (1, 2))
    clip = ("clip.swz", stream_to_bytes(stream))
    draws(project, f"{name}-clip", script, example(word), clip, cameras, expected, decibels, numbers)


@pytest.mark.skipif(executable() is None, reason="Chromium is not installed")
@pytest.mark.parametrize("antialiased", [False, True])
def test_babylonjs_draws_a_stream(project: Path, stream: SceneStream, antialiased: bool) -> None:
    shown, cameras = antialiased_stream() if antialiased else stream, tiny_cameras(2, 240, 180)
    expected = render_scene(conceal(decode_stream(shown), "grow"), cameras)
    code, scene = example("splatwire/babylon"), ("scene.swz", stream_to_bytes(shown))
    draws(project, "babylon", BABYLON, code, scene, cameras, list(expected), 40)


def test_splat_transform_reads_a_stream(project: Path, stream: SceneStream, tmp_path: Path) -> None:
    (tmp_path / "scene.swz").write_bytes(stream_to_bytes(stream))
    tool, door = "node_modules/.bin/splat-transform", "node_modules/splatwire/splat-transform.mjs"
    asked = f"file={tmp_path / 'scene.swz'},concealer=drop"
    called([tool, door, "-p", asked, str(tmp_path / "scene.ply")], project)
    cameras = tiny_cameras(2, 240, 180)
    ours = render_scene(conceal(decode_stream(stream), "drop"), cameras)
    theirs = render_scene(open_scene(tmp_path / "scene.ply"), cameras, background=np.array([0.2, 0.5, 0.8], np.float32))
    assert psnr(ours, theirs) > 60
    [shown] = re.findall(r"```bash\nsplat-transform (.*)\n```", (WEB / "PACKAGE.md").read_text())
    (project / "scene.swz").write_bytes(stream_to_bytes(stream))
    called([tool, *shown.split()], project)
    assert (project / "scene.spz").stat().st_size > 10_000


def test_splat_transform_reads_each_level_of_streamed_sog(project: Path, tmp_path: Path) -> None:
    report = write_sog_levels(SplatScene(ball(3000, degree=1)), tmp_path, leaf=100)
    index = json.loads((tmp_path / "lod-meta.json").read_text())
    assert report.num_levels > 2
    for level, count in enumerate(index["counts"]):
        target = tmp_path / f"{level}.ply"
        words = ["node_modules/.bin/splat-transform", str(tmp_path / "lod-meta.json"), "-L", str(level), str(target)]
        called(words, project)
        theirs = read_splats(target).means
        names = [name for name in index["filenames"] if name.startswith(f"{level}_")]
        ours = np.concatenate([read_sog((tmp_path / name).parent).splats.means for name in names])
        assert len(theirs) == len(ours) == count
        np.testing.assert_allclose(np.sort(theirs, axis=0), np.sort(ours, axis=0), atol=1e-4)
