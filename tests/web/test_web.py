"""Unit tests, types and style of the page's code, and bundles that equal their sources."""

import base64
import json
import os
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import splatwire
from close import unit
from explicit import encode_splats
from random_numbers import Numbers
from scenes import tiny_causal_scene
from splatwire.bitstream import Packetization, SceneStream, read_stream, stream_from_bytes
from splatwire.codec import encode_scene
from splatwire.codec.gaussians.quality import Quality
from splatwire.codec.preview import Preview, PreviewQuantisation, write_preview
from splatwire.types.splats import Splats
from web.node import WEB, answers, lacking, write
from web.sketched import with_copies, with_sketch

pytestmark = pytest.mark.slow

BUNDLES = sorted((Path(splatwire.__file__).parent / "web").glob("*.js"))


@pytest.fixture(scope="module", autouse=True)
def workshop() -> None:
    if reason := lacking():
        pytest.skip(reason)


def some_splats(count: int, degree: int, seed: int) -> Splats:
    rng = Numbers(seed)
    directions = unit(rng.randn(count, 3))
    sh = rng.randn(count, (degree + 1) ** 2, 3) * 0.15
    sh[:, 0] += directions
    return Splats(
        40 * directions * (1 + 0.05 * rng.randn(count, 1)),
        unit(rng.randn(count, 4)),
        np.exp(rng.randn(count, 3) - 1),
        rng.rand(count) * 0.98 + 0.01,
        sh,
    )


def streams() -> dict[str, SceneStream]:
    """One stream for each grouping, degree of harmonics and arrangement."""
    datagram = Packetization(block_size=700, lanes=1, grouping="hashed", packet_bytes=600)
    fixed = Packetization(block_size=300, lanes=5, seed=(1 << 64) - 3)
    made = {
        "datagram0": encode_splats(some_splats(1500, 0, 1), datagram, quality=Quality(9.0)),
        "datagram3": encode_splats(some_splats(900, 3, 2), datagram, quality=Quality(7.0)),
        "fixed1": encode_splats(some_splats(700, 1, 3), fixed, quality=Quality(12.0)),
        "contiguous2": encode_splats(
            some_splats(400, 2, 4), replace(fixed, grouping="contiguous"), quality=Quality(8.0)
        ),
    }
    tiers = (np.arange(1000) % 7 != 0).astype(np.int64)
    made["tiers0"] = encode_splats(some_splats(1000, 0, 5), datagram, tiers=tiers, quality=Quality(9.0))
    made |= {"copies0": with_copies(made["tiers0"]), "copies3": with_copies(made["datagram3"])}
    return made | anchors()


def anchors() -> dict[str, SceneStream]:
    """Streams of the causal codec: by size and in lanes, with one tier and two."""
    scene = tiny_causal_scene(seed=6, num_anchors=400)
    packetization = Packetization(block_size=150, lanes=1, grouping="hashed", packet_bytes=900)
    tiers = np.arange(400) % 5 != 0
    smaller = scene.anchors.scalings * np.where(tiers[:, None], np.array([1.0] * 3 + [0.2] * 3, np.float32), 1.0)
    unlike = replace(scene, anchors=replace(scene.anchors, scalings=smaller))
    tiered = encode_scene(unlike, packetization, tiers=tiers.astype(np.uint8))
    return {
        "anchors": encode_scene(scene, packetization),
        "sketched": with_sketch(encode_scene(scene, packetization)),
        "sketched_tiers": with_sketch(tiered, trust=0.0),
        "anchor_tiers": tiered,
        "anchor_lanes": encode_scene(scene, Packetization(block_size=160, lanes=3, seed=(1 << 64) - 3)),
        "anchor_runs": encode_scene(scene, Packetization(block_size=160, lanes=3, grouping="contiguous")),
    }


def preview() -> bytes:
    frame = PreviewQuantisation.fitting((1.0, -2.0, 3.0), 0.7, (-1.0, -1.5, -2.0, -5.0), (1.0, 1.5, 2.0, 1.0))
    rng = np.random.default_rng(0)
    levels = np.stack([rng.integers(0, 1 << bits, 20) for bits in (8, 8, 8, 5, 5, 5, 5, 5, 5, 4)], axis=1)
    return write_preview(Preview(frame, (10, 200, 30), levels.astype(np.int64)))


def test_npm_unit_tests_pass(tmp_path: Path) -> None:
    """Compares integers, tables and Gaussians of several streams with Python; also runs tests without Python."""
    vectors = {}
    for file in ("gaussians", "gaussians_3"):
        golden = json.loads((Path(__file__).parents[1] / "golden" / f"{file}.json").read_text())
        for name, vector in golden.items():
            vectors[f"{file}_{name}"] = stream_from_bytes(base64.b64decode(vector["swz"]))[0]
    vectors["causal"] = read_stream(Path(__file__).parents[1] / "golden" / "tiny_causal.swz")[0]
    files = [write(stream, tmp_path / f"{name}.swz") for name, stream in (streams() | vectors).items()]
    (tmp_path / "expected.json").write_text(answers(files, preview()))
    environment = {
        "STREAMS": ":".join(str(path) for path, _ in files),
        "EXPECTED": str(tmp_path / "expected.json"),
        "CASES": os.environ.get("SPLATWIRE_FUZZ_CASES", "50"),
    }
    done = subprocess.run(
        ["npm", "--silent", "test"], cwd=WEB, env=os.environ | environment, capture_output=True, text=True, timeout=1200
    )
    assert done.returncode == 0, done.stdout + done.stderr
    for count in ("fail 0", "skipped 0"):
        assert count in done.stdout, done.stdout


def test_typescript_types_and_style_pass() -> None:
    done = subprocess.run(["npm", "--silent", "run", "check"], cwd=WEB, capture_output=True, text=True, timeout=1200)
    assert done.returncode == 0, done.stdout + done.stderr


def test_bundles_equal_a_build_from_their_sources(tmp_path: Path) -> None:
    done = subprocess.run(
        ["node", "scripts/build.mjs", str(tmp_path)], cwd=WEB, capture_output=True, text=True, timeout=1200
    )
    assert done.returncode == 0, done.stderr
    assert sorted(file.name for file in tmp_path.iterdir()) == [file.name for file in BUNDLES]
    for bundle in BUNDLES:
        assert (tmp_path / bundle.name).read_bytes() == bundle.read_bytes(), "run: npm run build, in web/"


def test_bundle_sizes_stay_within_limits() -> None:
    """A preview waits for the first script only."""
    import gzip

    first, drawing = (len(gzip.compress(bundle.read_bytes(), 9)) for bundle in reversed(BUNDLES))
    assert first < 112_800
    assert first + drawing < 400_000
