"""Streamed SOG, read by PlayCanvas and by this package (tests/web/test_integrations.py: by splat-transform)."""

import itertools
import json
import logging
import subprocess
import sys

import numpy as np
import pytest

from lod.test_tileset import cloud, walk
from splatwire.io.formats import read_splats
from splatwire.io.formats.sog import read_sog
from splatwire.lod.sog_levels import LEAVES_PER_CHUNK, write_sog_levels
from splatwire.types import SplatScene
from web.node import WEB, lacking

LEAF = 100
STEP = 1e-3
"""Maximum rounding of positions by SOG in this scene, world units."""


@pytest.fixture(scope="module")
def levels(tmp_path_factory):
    folder = tmp_path_factory.mktemp("levels")
    report = write_sog_levels(SplatScene(cloud(), antialiased=True), folder, leaf=LEAF)
    return folder, report, json.loads((folder / "lod-meta.json").read_text())


def leaves_of(document):
    return [node for node, _ in walk(document["tree"]) if "lods" in node]


def test_the_finest_level_holds_every_gaussian_once(levels):
    folder, report, _ = levels
    found = read_splats(folder).means
    expected = cloud().means
    assert len(found) == len(expected) == report.num_gaussians
    distances = np.abs(found[:, None] - expected).max(axis=2)
    assert sorted(distances.argmin(axis=1)) == list(range(len(expected)))
    assert distances.min(axis=1).max() < STEP


def test_each_level_has_a_quarter_of_the_gaussians_in_runs_that_fill_the_chunks(levels):
    folder, report, document = levels
    leaves, counts = leaves_of(document), document["counts"]
    assert document["lodLevels"] == len(counts) == report.num_levels == 5
    assert document["count"] == sum(counts)
    assert all(4 * coarse <= fine + 4 * len(leaves) for fine, coarse in itertools.pairwise(counts))
    assert report.num_chunks == len(document["filenames"]) == 5 * -(-len(leaves) // LEAVES_PER_CHUNK)
    for number, name in enumerate(document["filenames"]):
        runs = [run for leaf in leaves for run in leaf["lods"].values() if run["file"] == number]
        ends = np.cumsum([run["count"] for run in runs])
        assert [run["offset"] for run in runs] == [0, *ends[:-1]]
        assert ends[-1] == json.loads((folder / name).read_text())["count"]


def test_bounds_contain_the_gaussians_of_all_levels_and_the_nodes_below(levels):
    folder, _, document = levels
    chunks = [read_sog((folder / name).parent).splats.means for name in document["filenames"]]
    for node, parent in walk(document["tree"]):
        low, high = np.array(node["bound"]["min"]), np.array(node["bound"]["max"])
        for run in node.get("lods", {}).values():
            means = chunks[run["file"]][run["offset"] : run["offset"] + run["count"]]
            assert (low <= means).all()
            assert (means <= high).all()
        if parent is not None:
            assert (np.array(parent["bound"]["min"]) <= low).all()
            assert (high <= np.array(parent["bound"]["max"])).all()


def test_an_origin_gives_a_warning(tmp_path, caplog):
    with caplog.at_level(logging.WARNING):
        write_sog_levels(SplatScene(cloud(3), origin=(500_000.0, 4_500_000.0, 100.0)), tmp_path)
    assert "500000" in caplog.text
    assert read_splats(tmp_path).num_gaussians == 3


ENGINE = """
import { readFileSync } from "node:fs";
const source = "./node_modules/playcanvas/build/playcanvas/src/scene/gsplat-unified/";
const { GSplatOctree } = await import(source + "gsplat-octree.js");
const path = process.argv[1], octree = new GSplatOctree(path, JSON.parse(readFileSync(path, "utf8")));
const nodes = octree.nodes.map(({ lods, bounds }) => [lods.map(({ count }) => count), bounds.getMin().x]);
console.log(JSON.stringify({ levels: octree.files.map(({ lodLevel }) => lodLevel), nodes }));
"""


@pytest.mark.slow
def test_the_engine_of_playcanvas_reads_the_tree(levels):
    if reason := lacking():
        pytest.skip(reason)
    folder, _, document = levels
    words = ["node", "--input-type=module", "-e", ENGINE]
    done = subprocess.run([*words, str(folder / "lod-meta.json")], cwd=WEB, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    found, leaves = json.loads(done.stdout), leaves_of(document)
    assert found["levels"] == [int(name.split("_")[0]) for name in document["filenames"]]
    assert [counts for counts, _ in found["nodes"]] == [
        [run["count"] for _, run in sorted(leaf["lods"].items())] for leaf in leaves
    ]
    np.testing.assert_allclose(
        [low for _, low in found["nodes"]], [leaf["bound"]["min"][0] for leaf in leaves], atol=1e-4
    )


@pytest.mark.slow
def test_a_real_scene_is_drawn_as_before(data_dir, tmp_path):
    source, target = data_dir / "splats" / "luigi_lgm_3dgs.ply", tmp_path / "levels"
    verbs = (["convert", source, target, "--to", "streamed-sog"], ["compare", source, target / "lod-meta.json"])
    for words in verbs:
        command = [sys.executable, "-m", "splatwire", *map(str, words), "--json"]
        done = subprocess.run(command, capture_output=True, text=True, timeout=900)
        assert done.returncode == 0, done.stderr
    row = json.loads(done.stdout)["rows"][1]
    assert row["num_gaussians"] == 14_526
    assert row["worst_psnr"] > 55
