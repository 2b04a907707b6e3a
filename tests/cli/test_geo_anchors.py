"""Verbs keep the world coordinates of geo-referenced scenes of anchors."""

from dataclasses import replace

import numpy as np
import pytest

from cli.test_geo import places, psnr
from scenes import tiny_cameras, tiny_causal_scene, tiny_scene
from splat_io.formats.test_origin import UTM
from splatwire.anchors.scene_file import load_scene, save_scene
from splatwire.bitstream import read_stream
from splatwire.codec import decode_stream
from splatwire.concealment import conceal
from splatwire.data import save_cameras
from splatwire.render.importance import footprint_importance, surrounding_cameras

pytestmark = pytest.mark.slow

SCENES = {"hacpp": tiny_scene, "causal": tiny_causal_scene}


@pytest.fixture(scope="module", params=SCENES)
def files(request, tmp_path_factory):
    """The same anchors and cameras in map coordinates and around 0."""
    folder, scene = tmp_path_factory.mktemp("geo"), SCENES[request.param](num_anchors=240)
    cameras = tiny_cameras(9, 64, 48)
    save_scene(scene, folder / "local.scene")
    save_cameras(cameras, folder / "local.json")
    save_scene(replace(scene, origin=UTM), folder / "world.scene")
    save_cameras(replace(cameras, origin=UTM), folder / "world.json")
    return folder


def test_scene_file_keeps_the_origin(files, run):
    scene = load_scene(files / "world.scene")
    assert scene.origin == UTM
    assert np.array_equal(scene.positions, load_scene(files / "local.scene").positions)
    assert run("inspect", files / "world.scene", "--json").json["origin"] == list(UTM)


def test_streams_are_encoded_decoded_and_rendered_relative_to_the_origin(files, run, tmp_path):
    for name in ("world", "local"):
        stream = tmp_path / f"{name}.swz"
        assert run("encode", files / f"{name}.scene", "-o", stream, "--cameras", files / f"{name}.json").status == 0
        assert run("decode", stream, "-o", tmp_path / f"{name}.scene").status == 0
        for kind, source in (("stream", stream), ("scene", files / f"{name}.scene")):
            out = tmp_path / f"{name}_{kind}"
            assert run("render", source, "--cameras", files / f"{name}.json", "-o", out).status == 0
    assert run("inspect", tmp_path / "world.swz", "--json").json["origin"] == list(UTM)
    assert load_scene(tmp_path / "world.scene").origin == UTM
    for kind in ("stream", "scene"):
        for view in range(9):
            pictures = [tmp_path / f"{name}_{kind}" / f"view_{view:02d}.png" for name in ("world", "local")]
            assert psnr(*pictures) > 45


def test_default_cameras_are_around_the_scene(files):
    scenes = [load_scene(files / f"{name}.scene") for name in ("world", "local")]
    world, local = (surrounding_cameras(scene, 4, 64) for scene in scenes)
    assert world.origin == UTM
    assert np.array_equal(world.viewmats, local.viewmats)
    found, expected = (footprint_importance(scene, seen) for scene, seen in zip(scenes, (world, local), strict=True))
    assert np.array_equal(found.share, expected.share)
    assert found.share.any()


def test_losses_keep_the_origin(files, run, tmp_path):
    words = ("--block-size", "60")
    assert run("encode", files / "world.scene", "-o", tmp_path / "a.swz", *words).status == 0
    lost = run("transmit", tmp_path / "a.swz", "-o", tmp_path / "b.swz", "--loss", "bernoulli:0.5", "--seed", 1)
    assert lost.status == 0
    received = decode_stream(read_stream(tmp_path / "b.swz")[0])
    assert received.loss_mask.num_lost
    assert received.scene.origin == conceal(received, "idw").origin == UTM
    assert run("decode", tmp_path / "b.swz", "-o", tmp_path / "b.scene", "--conceal", "idw").status == 0
    assert load_scene(tmp_path / "b.scene").origin == UTM


def test_exports_are_in_world_coordinates(files, run, tmp_path):
    for name in ("world", "local"):
        done = run(
            "export", "ply", files / f"{name}.scene", "-o", tmp_path / f"{name}.ply",
            "--cameras", files / f"{name}.json", "--json",
        )  # fmt: skip
        assert done.status == 0
        assert done.json["measured"]["psnr_to_scene"] > 20
    found, local = places(tmp_path / "world.ply"), places(tmp_path / "local.ply")
    assert len(found) == pytest.approx(len(local), abs=3)
    assert np.median(found, axis=0) == pytest.approx(np.median(local, axis=0) + UTM, abs=0.05)


def test_a_damaged_origin_of_a_scene_file_is_refused(files, run, tmp_path):
    content = (files / "world.scene").read_bytes()
    for wrong in (b"x12345.0", b"1e999999", b"null    "):
        number = f"{UTM[0]}".encode()
        assert content.count(number) == 1
        (tmp_path / "a.scene").write_bytes(content.replace(number, wrong[: len(number)].ljust(len(number))))
        refused = run("inspect", tmp_path / "a.scene")
        assert refused.status == 2
