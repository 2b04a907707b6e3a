"""Explicit Gaussians through the journey: file to packets, losses, and back to a file."""

import pytest
import torch

from splatwire.codec import add_concealment, decode_stream
from splatwire.errors import BitstreamError
from splatwire.formats import read_splats, write_splats
from splatwire.packets import read_stream
from splatwire.scene.splats import Splats
from splatwire.transport.preview import stream_preview

COUNT = 900


@pytest.fixture(scope="module")
def ply(tmp_path_factory):
    rng = torch.Generator().manual_seed(4)
    quats = torch.nn.functional.normalize(torch.randn(COUNT, 4, generator=rng), dim=1)
    means, scales = torch.rand(COUNT, 3, generator=rng), torch.rand(COUNT, 3, generator=rng) * 0.02 + 0.005
    splats = Splats(means, quats, scales, torch.rand(COUNT, generator=rng) * 0.8 + 0.1,
                    torch.randn(COUNT, 1, 3, generator=rng) * 0.5)  # fmt: skip
    path = tmp_path_factory.mktemp("explicit") / "cloud.ply"
    write_splats([splats], path)
    return path


@pytest.fixture(scope="module")
def stream(ply):
    from splatwire.cli.main import main

    path = ply.with_name("cloud.swz")
    with pytest.raises(SystemExit) as ended:
        main(["encode", str(ply), "-o", str(path), "--preset", "datagram"])
    assert ended.value.code == 0
    return path


def test_what_arrives_whole_is_the_scene(run, ply, stream, tmp_path):
    assert run("decode", stream, "-o", tmp_path / "back.ply").status == 0
    source, back = read_splats(ply), read_splats(tmp_path / "back.ply")
    assert back.num_gaussians == COUNT
    nearest = torch.cdist(source.means, back.means).argmin(dim=1)
    assert len(nearest.unique()) == COUNT
    assert float((source.means - back.means[nearest]).norm(dim=1).max()) < 0.02
    assert float((source.opacities - back.opacities[nearest]).abs().mean()) < 0.05


def test_lost_packets_leave_gaussians_out_and_grow_enlarges_the_others(run, stream, tmp_path):
    assert run("transmit", stream, "-o", tmp_path / "lossy.swz", "--loss", "bernoulli:0.4", "--seed", "1").status == 0
    sizes = {}
    for concealer in ("drop", "grow"):
        done = run(
            "decode", tmp_path / "lossy.swz", "-o", tmp_path / f"{concealer}.ply", "--conceal", concealer, "--json"
        )
        assert done.status == 0
        seen = read_splats(tmp_path / f"{concealer}.ply")
        assert seen.num_gaussians == COUNT - done.json["num_lost"] < COUNT
        sizes[concealer] = float(seen.scales.mean())
    assert sizes["grow"] > 1.05 * sizes["drop"]


def test_what_is_for_anchors_says_so(run, ply, stream, tmp_path):
    assert "works on anchors" in run("decode", stream, "-o", tmp_path / "a.ply", "--conceal", "cari").err
    assert "are for anchors" in run("encode", ply, "-o", tmp_path / "a.swz", "--tiers", "0.1").err
    with pytest.raises(BitstreamError, match="explicit Gaussians, not anchors"):
        decode_stream(read_stream(stream)[0])


def test_side_information_is_told_part_by_part_and_served(run, stream):
    content = run("inspect", stream, "--json").json
    assert content["codec"] == "gaussians"
    assert sum(content["side_info_parts"].values()) == content["parts"]["side_info"]
    whole = read_stream(stream)[0]
    previewed = add_concealment(whole, "preview", b"something to see")
    assert stream_preview(whole.side_info, whole.manifest.codec) == b""
    assert stream_preview(previewed.side_info, previewed.manifest.codec) == b"something to see"
