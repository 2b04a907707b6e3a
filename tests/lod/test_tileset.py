"""3D Tiles, read by the 3D Tiles Renderer of NASA-AMMOS in node, and by this package's glTF reader."""

import json
import logging
import subprocess
import threading
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer

import numpy as np
import pytest

from random_numbers import Numbers
from splatwire.io.formats import read_splats
from splatwire.lod.tileset import ERROR_SCALE, write_tileset
from splatwire.types import SplatScene
from splatwire.types.metadata import SceneMetadata
from splatwire.types.splats import Splats
from web.node import WEB, lacking

TILE = 100


def cloud(count=2000, degree=1):
    rng = Numbers(7)
    quats = rng.randn(count, 4)
    return Splats(
        rng.randn(count, 3) * np.float32([4, 1, 2]),
        quats / np.linalg.norm(quats, axis=1, keepdims=True),
        0.02 + 0.03 * rng.rand(count, 3),
        0.3 + 0.6 * rng.rand(count),
        0.2 * rng.randn(count, (degree + 1) ** 2, 3),
    )


def walk(tile, parent=None):
    yield tile, parent
    for child in tile.get("children", ()):
        yield from walk(child, tile)


@pytest.fixture(scope="module")
def tileset(tmp_path_factory):
    folder = tmp_path_factory.mktemp("tiles")
    report = write_tileset(SplatScene(cloud()), folder, tile=TILE)
    return folder, report, json.loads((folder / "tileset.json").read_text())


def test_tiles_have_the_copyright_and_antialiasing_gives_a_warning(tmp_path, caplog):
    known = SceneMetadata(title="Quay", author="Ana", license="CC BY 4.0")
    write_tileset(SplatScene(cloud(300), antialiased=True, metadata=known), tmp_path, tile=TILE)
    for path in tmp_path.rglob("*.glb"):
        data = path.read_bytes()
        assert (
            json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")])["asset"]["copyright"] == "Ana, CC BY 4.0"
        )
    assert json.loads((tmp_path / "tileset.json").read_text())["asset"]["extras"]["title"] == "Quay"
    assert "the request for antialiasing is in extras" in caplog.text


def test_the_finest_tiles_hold_every_gaussian_once(tileset):
    folder, report, document = tileset
    leaves = [tile for tile, _ in walk(document["root"]) if "children" not in tile]
    parts = [read_splats(folder / tile["content"]["uri"]) for tile in leaves]
    assert all(part.num_gaussians <= TILE for part in parts)
    means = np.concatenate([part.means for part in parts])
    expected = cloud().means
    np.testing.assert_array_equal(means[np.lexsort(means.T)], expected[np.lexsort(expected.T)])
    assert report.num_gaussians == len(means)
    assert all(tile["geometricError"] == 0 for tile in leaves)


def test_boxes_contain_the_gaussians_and_the_finer_tiles_and_errors_fall(tileset):
    folder, report, document = tileset
    tiles = list(walk(document["root"]))
    assert len([tile for tile, _ in tiles if "content" in tile]) == report.num_tiles
    for tile, parent in tiles:
        box = np.array(tile["boundingVolume"]["box"])
        low, high = box[:3] - box[[3, 7, 11]], box[:3] + box[[3, 7, 11]]
        if "content" in tile:
            x, y, z = read_splats(folder / tile["content"]["uri"]).means.T  # right, down, forward
            in_tile = np.stack([-x, -z, -y], axis=1)  # left, back, up: z is up
            assert (low <= in_tile).all()
            assert (in_tile <= high).all()
        if parent is not None:
            outer = np.array(parent["boundingVolume"]["box"])
            assert (outer[:3] - outer[[3, 7, 11]] <= low + 1e-9).all()
            assert (high - 1e-9 <= outer[:3] + outer[[3, 7, 11]]).all()
            assert tile["geometricError"] <= parent["geometricError"]
    assert document["geometricError"] >= document["root"]["geometricError"] > ERROR_SCALE * 0.01


def test_a_geocentric_origin_places_the_tileset_on_the_earth(tmp_path):
    origin = (3_928_000.5, 961_000.25, 4_919_000.75)
    report = write_tileset(SplatScene(cloud(50), origin=origin), tmp_path)
    assert report.geocentric
    document = json.loads((tmp_path / "tileset.json").read_text())
    matrix = np.array(document["root"]["transform"]).reshape(4, 4).T
    x, y, z = cloud(50).means.T.astype(float)
    tiles = np.stack([-x, -z, -y, np.ones(50)])
    np.testing.assert_allclose((matrix @ tiles)[:3].T, cloud(50).means + np.array(origin), atol=1e-6)


def test_an_origin_without_reference_system_gives_a_warning(tmp_path, caplog):
    with caplog.at_level(logging.WARNING):
        report = write_tileset(SplatScene(cloud(50), origin=(500_000.0, 4_500_000.0, 100.0)), tmp_path)
    assert not report.geocentric
    assert "no known reference system" in caplog.text
    document = json.loads((tmp_path / "tileset.json").read_text())
    assert "transform" not in document["root"]
    assert document["asset"]["extras"]["origin"] == [500_000.0, 4_500_000.0, 100.0]


CLIENT = """
import { PerspectiveCamera, Vector3, Box3 } from "three";
import { TilesRenderer } from "3d-tiles-renderer";
globalThis.requestAnimationFrame = (call) => setTimeout(call, 1);
globalThis.cancelAnimationFrame = clearTimeout;
const [url, distance] = process.argv.slice(1);
globalThis.location = new URL(url);
globalThis.window = globalThis.self = globalThis;
const tiles = new TilesRenderer(url), camera = new PerspectiveCamera(60, 1, 0.01, 1e6);
const errors = [];
tiles.addEventListener("load-error", ({ error }) => errors.push(String(error)));
camera.position.set(0, -Number(distance), 0);
camera.up.set(0, 0, 1);
camera.lookAt(0, 0, 0);
camera.updateMatrixWorld();
tiles.setCamera(camera);
tiles.setResolution(camera, 1000, 1000);
let calm = 0;
for (let turn = 0; turn < 20000 && calm < 20 && !errors.length; turn++) {
  tiles.update();
  await new Promise((done) => setTimeout(done, 3));
  calm = tiles.stats.downloading + tiles.stats.parsing === 0 && tiles.visibleTiles.size ? calm + 1 : 0;
}
let points = 0;
const attributes = new Set(), box = new Box3();
tiles.group.updateMatrixWorld(true);
tiles.forEachLoadedModel((scene, tile) => {
  if (!tiles.visibleTiles.has(tile)) return;
  scene.updateMatrixWorld(true);
  box.expandByObject(scene);
  scene.traverse((object) => {
    if (!object.isPoints) return;
    points += object.geometry.attributes.position.count;
    for (const name of Object.keys(object.geometry.attributes)) attributes.add(name);
  });
});
console.log(JSON.stringify({ errors, points, tiles: tiles.visibleTiles.size, attributes: [...attributes],
  low: box.min.toArray(), high: box.max.toArray() }));
process.exit(0);
"""
"""A client without drawing: loads the tiles that a camera needs, and prints what would be drawn."""


class Quiet(SimpleHTTPRequestHandler):
    def log_message(self, *_):
        """Logs nothing."""


@pytest.fixture
def address(tileset):
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(tileset[0]))) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_address[1]}/tileset.json"
        server.shutdown()
        thread.join()


@pytest.mark.slow
def test_another_program_loads_finer_tiles_as_the_camera_approaches(address, tileset):
    if reason := lacking():
        pytest.skip(reason)

    def drawn(distance):
        words = ["node", "--input-type=module", "-e", CLIENT, address, str(distance)]
        done = subprocess.run(words, cwd=WEB, capture_output=True, text=True, timeout=300)
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout)

    far, near = drawn(20_000), drawn(6)
    assert far["errors"] == near["errors"] == []
    assert far["points"] < 400
    assert far["tiles"] == 1
    assert near["points"] > 1000
    assert near["tiles"] > 10
    named = {name.lower() for name in near["attributes"]}
    assert any("rotation" in name for name in named)
    assert any("opacity" in name for name in named)
    y = cloud().means[:, 1]
    assert far["low"][2] >= -y.max() - 0.2  # z is up
    assert far["high"][2] <= -y.min() + 0.2
