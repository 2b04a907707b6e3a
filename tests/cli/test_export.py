import pytest
import torch

from scenes import tiny_cameras
from splatwire.data import save_cameras
from splatwire.formats import read_splats


@pytest.mark.parametrize("source", ["tiny.scene", "tiny.swz"])
def test_scenes_and_streams_become_a_ply_whose_loss_is_told(run, journey, tmp_path, source):
    save_cameras(tiny_cameras(8, 64, 48), tmp_path / "cameras.json")
    done = run("export", "ply", journey / source, "-o", tmp_path / "a.ply", "--cameras", tmp_path / "cameras.json",
               "--json")  # fmt: skip
    assert done.status == 0, done.err
    result = done.json
    splats = read_splats(tmp_path / "a.ply")
    assert splats.num_gaussians == result["num_gaussians"] > 100
    assert splats.degree == result["degree"] == 3
    assert result["num_bytes"] == (tmp_path / "a.ply").stat().st_size
    assert result["measured"]["num_views"] == 8
    assert result["measured"]["psnr_to_scene"] > 20


def test_an_export_is_drawn_and_compared_with(run, journey, tmp_path):
    exported = tmp_path / "new" / "a.splat"
    done = run("export", "splat", journey / "lossy.swz", "-o", exported, "--views", 16, "--json")
    assert done.status == 0, done.err
    assert done.json["num_lost"] > 0
    assert done.json["measured"]["num_views"] == 2
    assert done.json["degree"] == 0
    count = read_splats(exported).num_gaussians
    drawn = run("render", exported, "-o", tmp_path / "pictures", "--cameras", journey / "cameras.json", "--json")
    assert drawn.status == 0, drawn.err
    assert drawn.json["num_gaussians"] == count
    compared = run("evaluate", journey / "tiny.scene", "--reference", exported, "--cameras", journey / "cameras.json",
                   "--json")  # fmt: skip
    assert compared.status == 0, compared.err
    done = run("import", "splats", exported, "-o", tmp_path / "b.ply", "--json")
    assert done.json["num_gaussians"] == count
    done = run("export", "splat", tmp_path / "b.ply", "-o", tmp_path / "c.splat", "--json")
    assert done.json["measured"] is None
    assert torch.equal(read_splats(tmp_path / "c.splat").means, read_splats(exported).means)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--degree", 4], "degree 0 to 3"),
        (["--views", 8], "--views must be 9"),
        (["--data", "x", "--cameras", "y"], "either --data"),
    ],
)
def test_mistakes_are_told_in_one_line(run, journey, tmp_path, words, message):
    done = run("export", "ply", journey / "tiny.scene", "-o", tmp_path / "a.ply", *words)
    assert done.status == 2
    assert message in done.err
    assert not list(tmp_path.iterdir())


def test_standard_output_is_refused(run, journey):
    done = run("export", "ply", journey / "tiny.scene", "-o", "-")
    assert done.status == 2
    assert "give -o a file" in done.err
