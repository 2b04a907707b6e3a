"""The npm package: packed, installed into a project, type-checked, built without a warning, and rendered."""

import asyncio
import json
import re
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import splatwire
from codec.gaussians.test_gaussians import some_splats
from explicit import encode_splats
from moving_sequences import moving_frames
from splatwire.bitstream import Packetization, SceneStream, stream_to_bytes
from splatwire.codec import decode_stream, with_section
from splatwire.codec.antialiasing import SECTION as ANTIALIASED
from splatwire.codec.gaussians.quality import Quality
from splatwire.lod import encode_levels
from splatwire.sequence import SequenceOptions, encode_sequence
from splatwire.sequence.decoding import decode_frames
from splatwire.types import SplatScene
from splatwire.types.lod_scene import Levels
from transport.chromium import Browser, executable, isolated_page
from web.host import hosting
from web.installed import called, install, package
from web.node import WEB
from web.pictures import ELEMENT, half_of
from web.test_page import SMALL, ball, run

pytestmark = pytest.mark.slow

PAGE = '<!doctype html><link rel="icon" href="data:,">{element}<script type="module" src="./{script}.ts"></script>'
VITE = """export default {
  base: "./",
  build: {
    rolldownOptions: { input: ["index.html", "strict.html"], checks: { bundlerTimings: false } },
  },
};
"""
"""Disables warnings about plug-in times, which depend on the machine."""
PARTS = ("decoder", "index", "view", "engine")
POLICY = "default-src 'none'; script-src 'self'; worker-src 'self'; connect-src 'self'; style-src 'unsafe-inline'"
DECODE = """
import { readFileSync } from "node:fs";
import { decode, receive } from "splatwire/decoder";
const [file, half, asking, url] = process.argv.slice(2), results = {};
for (const [name, path, options] of [["whole", file, {}], ["half", half, {}], ["grown", asking, {concealer: "grow"}]]) {
  const { gaussians, ...rest } = await decode(new Uint8Array(readFileSync(path)), options);
  const { count, antialiased, centres, scales } = gaussians;
  results[name] = { ...rest, count, antialiased, centres: [...centres], scales: [...scales] };
}
results.arrived = [];
results.lost = 0;
for await (const { gaussians, packets, replaces } of receive(url, { lost: () => results.lost++ }))
  results.arrived.push([gaussians.count, packets, replaces]);
console.log(JSON.stringify(results));
"""

FRAMES = """
import { readFileSync } from "node:fs";
import { decode, decodeClip } from "splatwire/decoder";
const [levels, clip] = process.argv.slice(2).map((path) => new Uint8Array(readFileSync(path)));
const whole = await decodeClip(clip), frames = [];
for (let n = 0; n < whole.clip.numFrames; n++) frames.push([...whole.frame(n).centres]);
const { gaussians, verified } = await decode(levels, { concealer: "grow" });
console.log(JSON.stringify({ finest: [...gaussians.centres], verified, frames, clip: whole.clip }));
"""


def examples() -> list[str]:
    """Code blocks of the package's README."""
    return re.findall(r"```(?:html|ts)\n(.*?)```", (WEB / "PACKAGE.md").read_text(), re.DOTALL)


@pytest.fixture(scope="module")
def stream() -> SceneStream:
    return encode_splats(ball(), SMALL, background=(0.2, 0.5, 0.8), quality=Quality(10.0))


@pytest.fixture(scope="module")
def packed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The file that `npm publish` would upload."""
    return package(tmp_path_factory)


@pytest.fixture(scope="module")
def alone(packed: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A project with the installed package and no other."""
    folder = tmp_path_factory.mktemp("alone")
    install(folder, packed, {})
    return folder


@pytest.fixture(scope="module")
def project(packed: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A Vite project with the installed package and the README's examples as its code."""
    folder = tmp_path_factory.mktemp("theirs")
    (folder / "vite.config.js").write_text(VITE)
    viewer, events, decoder = (text.replace("https://example.org/", "./") for text in examples()[:3])
    element = re.search(r"<splat-wire.*</splat-wire>", viewer)
    assert element
    for name, script in (("index", "main"), ("strict", "strict")):
        placed = element[0].replace('src="/', 'src="./')
        (folder / f"{name}.html").write_text(PAGE.format(element=placed, script=script))
    (folder / "main.ts").write_text(f"{events}\nimport './decoded.ts';\n")
    (folder / "strict.ts").write_text('import "splatwire/strict";\n')
    (folder / "decoded.ts").write_text(decoder)
    install(folder, packed, {"typescript": "7.0.2", "vite": "8.3.8"})
    return folder


def test_package_metadata_and_size_are_as_documented(packed: Path) -> None:
    import gzip

    folder = packed.parent / "splatwire"
    manifest = json.loads((folder / "package.json").read_text())
    assert (manifest["name"], manifest["version"], manifest["license"]) == (
        "splatwire",
        splatwire.__version__,
        "Apache-2.0",
    )
    assert "private" not in manifest
    for entry in manifest["exports"].values():
        for path in entry.values() if isinstance(entry, dict) else [entry]:
            assert (folder / path).is_file(), path
    for file in ("LICENSE", "LICENSES.txt", "README.md", "index.js.map"):
        assert (folder / file).is_file(), file
    size = {name: len(gzip.compress((folder / f"{name}.js").read_bytes(), 9)) for name in PARTS}
    assert size["decoder"] <= 82_200
    assert size["index"] <= 114_300
    assert size["index"] + size["view"] + size["engine"] <= 400_000


def test_node_decoder_gives_the_gaussians_of_python(alone: Path, stream: SceneStream, tmp_path: Path) -> None:
    """Reads bytes, half of the packets, and a server with a broken connection."""
    half, file = half_of(stream), stream_to_bytes(stream)
    (tmp_path / "whole.swz").write_bytes(file)
    (tmp_path / "half.swz").write_bytes(stream_to_bytes(half))
    (tmp_path / "asking.swz").write_bytes(stream_to_bytes(with_section(half, ANTIALIASED, b"")))
    (alone / "decode.mjs").write_text(DECODE)

    async def work() -> dict[str, Any]:
        async with hosting({}, {"ball.swz": file}) as host:
            host.cut.set()
            host.deliver = lambda request, body: len(file) // 2 if len(host.asked) == 1 else None
            words = [
                "node",
                "decode.mjs",
                str(tmp_path / "whole.swz"),
                str(tmp_path / "half.swz"),
                str(tmp_path / "asking.swz"),
                f"{host.url}ball.swz",
            ]
            return json.loads(await asyncio.to_thread(called, words, alone))

    results = asyncio.run(asyncio.wait_for(work(), 1800))
    assert results["whole"]["digest"] == stream.manifest.symbols_digest
    assert results["whole"]["verified"] is results["whole"]["complete"] is True
    assert results["half"]["verified"] is results["half"]["complete"] is False
    assert [results[name]["antialiased"] for name in ("whole", "half", "grown")] == [False, False, True]
    for name, python in (("whole", decode_stream(stream)), ("half", decode_stream(half))):
        known = python.loss_mask.fully_received
        theirs = np.asarray(results[name]["centres"], dtype=np.float32).reshape(-1, 3)
        ours = python.scene.positions[known]
        assert results[name]["count"] == len(ours)
        assert np.array_equal(np.sort(theirs, axis=0), np.sort(ours, axis=0))
    assert np.mean(results["grown"]["scales"]) > np.mean(results["half"]["scales"])
    assert sum(count for count, _, _ in results["arrived"]) == len(ball().means)
    assert results["arrived"][-1][1] == len(stream.packets)
    assert [replaces for _, _, replaces in results["arrived"]] == [True] + [False] * (len(results["arrived"]) - 1)
    assert results["lost"] >= 1


def test_node_decoder_gives_levels_and_frames_of_python(alone: Path, tmp_path: Path) -> None:
    splats = some_splats(5000)
    levels = encode_levels(SplatScene(splats), Packetization(block_size=400, lanes=2))
    clip, _ = encode_sequence(moving_frames(200, 7), SequenceOptions(Fraction(8), 3))
    paths = [str(tmp_path / f"{name}.swz") for name in ("levels", "clip")]
    for path, stream in zip(paths, (levels, clip), strict=True):
        Path(path).write_bytes(stream_to_bytes(stream))
    (alone / "frames.mjs").write_text(FRAMES)
    results = json.loads(called(["node", "frames.mjs", *paths], alone))
    received = decode_stream(levels)
    finest = received.scene.splats.means[received[Levels].lod_level == 0]
    assert results["verified"] is True
    assert len(finest) == len(splats.means)
    check_centres(results["finest"], finest)
    assert results["clip"] == {"rate": 8, "numFrames": 7}
    for theirs, frame in zip(results["frames"], decode_frames(decode_stream(clip).scene), strict=True):
        check_centres(theirs, frame.scene.splats.means)


def check_centres(theirs: list[float], ours: np.ndarray) -> None:
    """The same positions in any order."""
    found = np.asarray(theirs, dtype=np.float32).reshape(-1, 3)
    assert np.allclose(np.sort(found, axis=0), np.sort(ours, axis=0), rtol=1e-5, atol=1e-6)


@pytest.mark.extended
@pytest.mark.skipif(executable() is None, reason="Chromium is not installed")
def test_vite_project_with_the_package_builds_and_renders(project: Path, stream: SceneStream) -> None:
    called(["node_modules/.bin/tsc"], project)
    built = called(["node_modules/.bin/vite", "build", "--logLevel", "warn"], project)
    assert built.strip() == "", built
    files = {f"assets/{path.name}": path.read_text() for path in (project / "dist" / "assets").iterdir()}
    pages = {path.name: path.read_text() for path in (project / "dist").glob("*.html")}

    def drive(url: str, page: Browser) -> None:
        for name in ("index", "strict"):
            page.open(f"{url}{name}.html")
            page.wait_for(f"{ELEMENT}?.status?.verified && {ELEMENT}.view")
            page.resolve(f"{ELEMENT}.view.sorted()")
            wait = "{viewmat: [[1,0,0,0],[0,1,0,0],[0,0,1,3],[0,0,0,1]], focal: 300, height: 300}"
            assert len(page.resolve(f"{ELEMENT}.picture({wait})")) > 10_000, "an empty picture"
        assert page.evaluate("document.querySelector('meta[http-equiv]').content") == POLICY

    async def work() -> None:
        meta = f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">'
        pages["strict.html"] = pages["strict.html"].replace("<link", f"{meta}<link", 1)
        async with hosting(pages, {"scene.swz": stream_to_bytes(stream)}, files) as host:
            with isolated_page() as page:
                await asyncio.to_thread(drive, host.url, page)

    run(work())
