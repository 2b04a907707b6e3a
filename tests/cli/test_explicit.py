"""Explicit Gaussians on the command line: from a file to packets, losses, and back to a file."""

import json
import zipfile
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scipy.spatial.distance import cdist

from close import unit
from random_numbers import Numbers
from splat_io.formats.handmade import some_splats
from splatwire.bitstream import read_stream, write_stream
from splatwire.calibration import preview
from splatwire.cli import _run_calibrate
from splatwire.codec import with_section
from splatwire.concealment import concealer_names
from splatwire.io.formats import read_splats, write_splats
from splatwire.transport.protocol.preview import stream_preview
from splatwire.types.splats import Splats

COUNT = 900


@pytest.fixture(scope="module")
def ply(tmp_path_factory):
    rng = Numbers(4)
    quats = unit(rng.randn(COUNT, 4))
    means, scales = (
        rng.rand(COUNT, 3),
        rng.rand(COUNT, 3) * 0.02 + 0.005,
    )
    splats = Splats(means, quats, scales, rng.rand(COUNT) * 0.8 + 0.1,
                    rng.randn(COUNT, 1, 3) * 0.5)  # fmt: skip
    path = tmp_path_factory.mktemp("explicit") / "cloud.ply"
    write_splats([splats], path)
    return path


@pytest.fixture(scope="module")
def stream(ply):
    from splatwire.cli.main import main

    path = ply.with_name("cloud.swz")
    with pytest.raises(SystemExit) as ended:
        main(["encode", str(ply), "-o", str(path), "--preset", "datagram", "--no-sketch"])
    assert ended.value.code == 0
    return path


def test_gaussians_default_to_the_paper_preset(run, ply, tmp_path):
    run("encode", ply, "-o", tmp_path / "a.swz")
    packetization = run("inspect", tmp_path / "a.swz", "--json").json["packetization"]
    assert (packetization["block_size"], packetization["lanes"]) == (3000, 8)


def test_inspect_reports_contents_of_a_gaussian_file(run, ply):
    facts, splats = run("inspect", ply, "--json").json, read_splats(ply)
    assert facts["kind"] == "explicit Gaussians (ply)"
    assert (facts["num_gaussians"], facts["degree"], facts["num_bytes"]) == (COUNT, 0, ply.stat().st_size)
    for number, axis in enumerate("xyz"):
        places = np.sort(splats.means[:, number]).tolist()
        assert facts["bounds"][axis] == [places[0], places[-1]]
        assert places[5] < facts["core"][axis][0] < facts["core"][axis][1] < places[-5]
    assert facts["sizes"]["most"] == float(splats.scales.max())
    assert facts["opacities"]["median"] == pytest.approx(float(np.quantile(splats.opacities.astype(np.float64), 0.5)))
    assert facts["problems"] == []
    shown = run("inspect", ply).out
    assert "num_packets" not in shown
    assert "problems" in shown


def test_inspect_reports_suspicious_gaussians(run, ply, tmp_path):
    splats = read_splats(ply)
    splats.means[7] = 1e6
    splats.scales[8] = 50.0
    splats.scales[9, 0] = 1e-8
    splats.opacities[10:13] = 1e-4
    splats.sh[14, 0, 1] = 40.0
    harmonics = np.concatenate([splats.sh, np.zeros((COUNT, 3, 3), np.float32)], axis=1)
    write_splats([replace(splats, sh=harmonics)], tmp_path / "wrong.ply")
    problems = run("inspect", tmp_path / "wrong.ply", "--json").json["problems"]
    expected = (("farther", 1, 7), ("larger than the core", 1, 8), ("as long as thick", 1, 9), ("transparent", 3, 10),
                ("colour outside", 1, 14))  # fmt: skip
    for problem, (what, count, row) in zip(problems, expected, strict=False):
        assert what in problem
        assert problem.endswith(f": {count} of {COUNT}, first row {row}")
    assert problems[5:] == ["the harmonics of degree 1 are all 0: they cost bytes for nothing"]


def test_decoding_without_loss_restores_the_scene(run, ply, stream, tmp_path):
    assert run("decode", stream, "-o", tmp_path / "back.ply").status == 0
    source, back = read_splats(ply), read_splats(tmp_path / "back.ply")
    assert back.num_gaussians == COUNT
    nearest = cdist(source.means, back.means).argmin(axis=1)
    assert len(set(nearest.tolist())) == COUNT
    assert float(np.linalg.norm(source.means - back.means[nearest], axis=1).max()) < 0.02
    assert float(np.abs(source.opacities - back.opacities[nearest]).mean()) < 0.05


def test_lost_packets_remove_gaussians_and_grow_enlarges_the_others(run, stream, tmp_path):
    assert run("transmit", stream, "-o", tmp_path / "lossy.swz", "--loss", "bernoulli:0.4", "--seed", "1").status == 0
    sizes = {}
    for concealer in ("drop", "grow"):
        done = run(
            "decode", tmp_path / "lossy.swz", "-o", tmp_path / f"{concealer}.ply", "--conceal", concealer, "--json"
        )
        assert done.status == 0
        seen = read_splats(tmp_path / f"{concealer}.ply")
        assert seen.num_gaussians == COUNT - done.json["num_lost"] < COUNT
        sizes[concealer] = float(seen.scales.mean()), float(seen.opacities.mean())
    (small, thin), (large, opaque) = sizes["drop"], sizes["grow"]
    assert large > 1.02 * small
    assert opaque > 1.05 * thin


@pytest.fixture(scope="module")
def lossy(stream):
    from splatwire.cli.main import main

    path = stream.with_name("lossy.swz")
    with pytest.raises(SystemExit) as ended:
        main(["transmit", str(stream), "-o", str(path), "--loss", "bernoulli:0.3", "--seed", "2"])
    assert ended.value.code == 0
    return path


def test_export_states_lost_gaussians(run, lossy, tmp_path):
    said = run("export", "ply", lossy, "-o", tmp_path / "a.ply")
    assert (
        f"{COUNT - read_splats(tmp_path / 'a.ply').num_gaussians} lost Gaussians were concealed by 'drop'" in said.out
    )


def test_orbit_views_are_rendered_without_cameras(run, ply, lossy, tmp_path):
    done = run("render", ply, "-o", tmp_path / "whole", "--scale", "0.1", "--json")
    assert done.json["num_gaussians"] == COUNT
    assert done.json["num_views"] == len(list((tmp_path / "whole").glob("*.png"))) == 12
    words = ("--cameras", tmp_path / "whole" / "cameras.json", "--conceal", "grow", "--json")
    assert run("render", lossy, "-o", tmp_path / "lossy", *words).json["num_lost"] > 0


@pytest.mark.slow
def test_evaluate_applies_the_same_losses_to_every_concealer(run, ply, stream, tmp_path):
    words = ("--reference", ply, "--loss", "bernoulli:0.3", "--seeds", "0", "1", "--views", "3", "--lpips-views", "1")
    rows = {row["method"]: row for row in run("evaluate", stream, *words, "--json").json["rows"]}
    assert set(rows) == {"no loss", *concealer_names((), {Splats})}
    assert rows["no loss"]["psnr"] > rows["drop"]["psnr"] + 3
    assert rows["drop"]["num_lost_packets"] == rows["grow"]["num_lost_packets"] > 0
    encoded = run("evaluate", ply, *words, "--conceal", "drop", "-o", tmp_path / "report", "--json")
    assert encoded.json["rows"][0]["psnr"] > 30
    assert "900 Gaussians" in (tmp_path / "report" / "report.html").read_text()


@pytest.mark.parametrize("change", [{"shift": 50.0}, {"factor": 10.0}])
def test_evaluate_warns_of_a_reference_that_is_another_scene(run, ply, stream, tmp_path, change):
    """In the views of the reference, a scene elsewhere or of another size gives nothing but a low PSNR."""
    splats, shift = read_splats(ply), np.float32(change.get("shift", 0))
    factor = np.float32(change.get("factor", 1))
    write_splats([replace(splats, means=splats.means * factor + shift)], tmp_path / "other.ply")
    words = ("--views", "1", "--lpips-views", "1", "--json")
    assert "another scene" not in run("evaluate", stream, "--reference", ply, *words).err
    stderr = run("evaluate", stream, "--reference", tmp_path / "other.ply", *words).err
    assert f"splatwire: warning: {stream} is of another scene than {tmp_path / 'other.ply'}: centre (" in stderr


def test_evaluate_of_a_stream_without_received_gaussians_has_a_table(run, ply, stream, tmp_path):
    run("transmit", stream, "-o", tmp_path / "nothing.swz", "--loss", "bernoulli:1", "--seed", "0")
    words = ("--reference", ply, "--views", "1", "--lpips-views", "1", "--json")
    done = run("evaluate", tmp_path / "nothing.swz", *words)
    assert done.status == 0, done.err
    assert {row["method"]: row["num_lost_packets"] > 0 for row in done.json["rows"]}["drop"]


def test_cameras_too_near_to_draw_a_scene_give_a_warning(run, ply, tmp_path):
    splats, factor = read_splats(ply), np.float32(0.01)
    small = replace(splats, means=splats.means * factor, scales=splats.scales * factor)
    write_splats([small], tmp_path / "small.ply")
    run("render", tmp_path / "small.ply", "-o", tmp_path / "own", "--scale", "0.1")
    content = json.loads((tmp_path / "own" / "cameras.json").read_text())
    words = ("--cameras", tmp_path / "cameras.json", "--views", "2", "--lpips-views", "1", "--json")
    for near, warned in ((content.pop("near_depth"), False), (0.2, True)):
        (tmp_path / "cameras.json").write_text(json.dumps(content | {"near_depth": near}))
        done = run("evaluate", ply.parent / "cloud.ply", "--reference", tmp_path / "small.ply", *words)
        assert ("splatwire: warning: 100 % of the Gaussians in the pictures are nearer than 0.2" in done.err) == warned
        done = run("encode", tmp_path / "small.ply", "-o", tmp_path / "a.swz", "--cameras", tmp_path / "cameras.json")
        assert done.status == 0, done.err
        assert ("splatwire: warning: 100 % of the Gaussians in the pictures are nearer than 0.2" in done.err) == warned
    frames = [
        {
            "file_path": f"own/{view['name']}.png",
            "transform_matrix": (np.linalg.inv(view["viewmat"]) @ np.diag([1.0, -1.0, -1.0, 1.0])).tolist(),
        }
        for view in content["cameras"]
    ]
    focal = content["cameras"][0]["K"][0][0]
    (tmp_path / "transforms.json").write_text(json.dumps({"fl_x": focal, "frames": frames}))
    done = run("evaluate", tmp_path / "small.ply", "--data", tmp_path, "--lpips-views", "1", "--json")
    assert done.status == 0, done.err
    assert done.err.count("splatwire: warning: 100 % of the Gaussians in the pictures are nearer than 0.2") == 1


def test_keep_prunes_the_least_important_gaussians(run, ply, tmp_path):
    done = run("encode", ply, "-o", tmp_path / "half.swz", "--keep", "0.5", "--tiers", "0.1", "--json")
    assert done.json["num_elements"] == COUNT // 2
    assert 20 < done.json["kept_psnr"] < 100
    assert [tier["num_elements"] for tier in done.json["tiers"].values()] == [COUNT // 20, COUNT // 2 - COUNT // 20]
    assert run("decode", tmp_path / "half.swz", "-o", tmp_path / "half.ply").status == 0
    kept, all_of_them = read_splats(tmp_path / "half.ply"), read_splats(ply)
    assert float(kept.opacities.mean()) > float(all_of_them.opacities.mean())
    assert "--keep" in run("encode", ply, "-o", tmp_path / "a.swz", "--keep", "0").err


def test_plan_adds_redundancy_for_gaussians(run, stream, tmp_path):
    words = ("--views", "2", "--trials", "20", "--drawn", "1", "--conceal", "drop")
    done = run("plan", stream, "-o", tmp_path / "plan.json", *words)
    assert "Gaussians lost, tier by tier" in done.out
    assert (tmp_path / "plan.json").is_file()


@pytest.mark.needs_torch
def test_anchor_features_are_refused_for_gaussians(run, ply, stream, tmp_path):
    assert (
        "this stream of Gaussians does not have"
        in run("decode", stream, "-o", tmp_path / "a.ply", "--conceal", "cari").err
    )
    assert "do not have" in run("encode", ply, "-o", tmp_path / "a.swz", "--refine", "10").err
    assert "this stream of Gaussians has none" in run("calibrate", "gnn", stream, "-o", tmp_path / "gnn.swz").err


def test_cameras_set_the_initial_viewpoint(run, journey, ply, stream, tmp_path):
    from scenes import tiny_cameras
    from splatwire.bitstream.sections import sections_of
    from splatwire.codec.initial_view import SECTION, initial_view_section
    from splatwire.data import load_cameras, save_cameras

    save_cameras(tiny_cameras(), tmp_path / "cameras.json")
    words = ("-o", tmp_path / "seen.swz", "--cameras", tmp_path / "cameras.json")
    expected = initial_view_section(load_cameras(tmp_path / "cameras.json"))
    for source in (ply, journey / "tiny.scene"):
        assert run("encode", source, *words).status == 0
        assert sections_of(read_stream(tmp_path / "seen.swz")[0])[SECTION] == expected
    assert SECTION not in sections_of(read_stream(stream)[0])


def test_parts_of_side_information_are_reported_and_served(run, stream):
    content = run("inspect", stream, "--json").json
    assert content["codec"] == "gaussians"
    assert sum(content["side_info_parts"].values()) == content["parts"]["side_info"]
    whole = read_stream(stream)[0]
    previewed = with_section(whole, "preview", b"something to see")
    assert stream_preview(whole.side_info, whole.manifest.schema_name) == b""
    assert stream_preview(previewed.side_info, previewed.manifest.schema_name) == b"something to see"


@pytest.mark.slow
def test_sketch_is_stored_in_the_stream(run, stream, tmp_path):
    target = tmp_path / "sketched.swz"
    content = run("calibrate", "sketch", stream, "-o", target, "--share", 0.05, "--json").json
    assert content["elements"] == "Gaussians"
    assert 0 < content["num_sketched"] < content["num_elements"] == COUNT
    assert content["psnr_held_out"]["sketch"] > content["psnr_held_out"]["drop"]
    run("transmit", target, "-o", tmp_path / "lossy.swz", "--loss", "bernoulli:0.4", "--seed", 1)
    left = {}
    for name in ("drop", "sketch"):
        run("decode", tmp_path / "lossy.swz", "-o", tmp_path / f"{name}.ply", "--conceal", name)
        left[name] = read_splats(tmp_path / f"{name}.ply").num_gaussians
    assert left["drop"] < left["sketch"] < COUNT
    plain = run("inspect", stream, "--json").json
    assert run("inspect", target, "--json").json["side_info_parts"].keys() - plain["side_info_parts"] == {"sketch"}


@pytest.mark.slow
def test_datagram_streams_include_a_sketch(run, journey, ply, stream, tmp_path):
    """The sketch takes a hundredth of the bytes in unchanged packets; a share that is too small is reported."""
    target = tmp_path / "sketched.swz"
    content = run("encode", ply, "-o", target, "--preset", "datagram", "--json").json
    assert content["parts"]["side_info"] - run("inspect", stream, "--json").json["parts"]["side_info"] > 0
    assert content["num_bytes"] <= 1.011 * stream.stat().st_size
    assert read_stream(target)[0].packets == read_stream(stream)[0].packets
    assert "sketch" in run("inspect", target, "--json").json["side_info_parts"]
    assert run("encode", ply, "-o", tmp_path / "a.swz", "--no-sketch").status == 2
    tiny = run("encode", journey / "tiny.scene", "-o", tmp_path / "b.swz", "--preset", "datagram")
    assert tiny.status == 0
    assert "without a sketch: no sketch fits" in tiny.err


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "more"),
    [
        (("inspect",), ()),
        (("encode",), ("-o", "{out}/a.swz")),
        (("render",), ("-o", "{out}/p", "--cameras", "{journey}/cameras.json", "--scale", 0.2)),
        (("export", "spz"), ("-o", "{out}/a.spz")),
        (("export", "splat"), ("-o", "{out}/a.splat")),
        (("import", "splats"), ("-o", "{out}/a.ply")),
        (("evaluate",), ("--reference", "{folder}", "--cameras", "{journey}/cameras.json", "--views", 1)),
        (("calibrate", "preview"), ("-o", "{out}/b.swz", "--cameras", "{journey}/cameras.json")),
    ],
)
def test_every_verb_accepts_a_sog_folder(run, journey, tmp_path, monkeypatch, words, more):
    monkeypatch.setattr(_run_calibrate, "PreviewConfig", partial(preview.PreviewConfig, steps=20, num_relocations=1))
    write_splats([some_splats(40, 1)], tmp_path / "a.sog")
    with zipfile.ZipFile(tmp_path / "a.sog") as bundle:
        bundle.extractall(tmp_path / "sog")
    (tmp_path / "out").mkdir()
    places = {"out": tmp_path / "out", "journey": journey, "folder": tmp_path / "sog"}
    rest = [str(word).format(**places) for word in more]
    outcome = run(words[0], *words[1:], tmp_path / "sog", *rest, "--json")
    assert outcome.status == 0, outcome.err
    assert outcome.json


@pytest.mark.parametrize("end", ["ply", "compressed.ply", "spz", "sog", "splat"])
@pytest.mark.parametrize("more", [(), ("--conceal", "grow")])
def test_stream_without_packets_is_one_error_line(run, stream, tmp_path, end, more):
    write_stream(read_stream(stream)[0].with_packets(()), tmp_path / "none.swz")
    outcome = run("decode", tmp_path / "none.swz", "-o", tmp_path / f"x.{end}", *more)
    assert outcome.status == 2
    assert outcome.err.splitlines()[-1].endswith("there is no Gaussian to write")
    assert not (tmp_path / f"x.{end}").exists()
