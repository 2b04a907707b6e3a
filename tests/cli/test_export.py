import numpy as np
import pytest

from close import unit
from random_numbers import Numbers
from scenes import tiny_cameras
from splatwire.data import save_cameras
from splatwire.io.formats import read_splats, write_splats
from splatwire.types.splats import Splats


@pytest.mark.parametrize("source", ["tiny.scene", "tiny.swz"])
def test_export_ply_reports_the_loss_of_the_fit(run, journey, tmp_path, source):
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


def test_exported_file_is_rendered_and_evaluated(run, journey, tmp_path):
    exported = tmp_path / "a.splat"
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
    assert np.array_equal(read_splats(tmp_path / "c.splat").means, read_splats(exported).means)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--degree", 4], "degree 0 to 3"),
        (["--views", 8], "--views must be 9"),
        (["--data", "x", "--cameras", "y"], "either --data"),
        (["--views", "16", "--cameras", "y"], "either --data"),
    ],
)
def test_invalid_options_are_one_error_line(run, journey, tmp_path, words, message):
    done = run("export", "ply", journey / "tiny.scene", "-o", tmp_path / "a.ply", *words)
    assert done.status == 2
    assert message in done.err
    assert not list(tmp_path.iterdir())


def test_standard_output_is_refused(run, journey):
    done = run("export", "ply", journey / "tiny.scene", "-o", "-")
    assert done.status == 2
    assert "give -o a file" in done.err


@pytest.fixture
def curved(tmp_path):
    """Gaussians of degree 3 with direction-dependent colours."""
    rng = Numbers(2)
    quats = unit(rng.randn(80, 4))
    means, scales = rng.rand(80, 3), rng.rand(80, 3) * 0.05 + 0.01
    harmonics = rng.randn(80, 16, 3) * 0.2
    path = tmp_path / "curved.ply"
    write_splats([Splats(means, quats, scales, np.full((80,), 0.7, np.float32), harmonics)], path)
    return path


@pytest.mark.parametrize("suffix", [".usd", ".usda", ".usdc", ".USDZ"])
def test_export_of_openusd_accepts_each_suffix(run, curved, tmp_path, suffix):
    pytest.importorskip("pxr", reason="usd-core is not installed")
    assert run("export", "usdz", curved, "-o", tmp_path / f"a{suffix}").status == 0
    assert read_splats(tmp_path / f"a{suffix}").num_gaussians == 80


def test_export_writes_the_requested_harmonics_degree(run, curved, tmp_path):
    for degree in (0, 1, 3):
        done = run("export", "ply", curved, "-o", tmp_path / "a.ply", "--degree", degree, "--json")
        assert done.json["degree"] == read_splats(tmp_path / "a.ply").degree == degree
        assert done.err == ""


def test_export_measures_quality_only_on_request(run, curved, journey, tmp_path):
    words = ("export", "spz", curved, "-o", tmp_path / "a.spz")
    assert run(*words, "--json").json["measured"] is None
    seen = run(*words, "--cameras", journey / "cameras.json", "--json").json["measured"]
    assert seen["num_views"] == 2
    assert seen["psnr_to_scene"] > 30
    assert run(*words, "--views", 16, "--json").json["measured"]["num_views"] == 2
    for option in ("--cameras", "--data"):
        done = run(*words, option, tmp_path / "nowhere.json")
        assert (done.status, done.out) == (2, "")
        assert "nowhere.json" in done.err


def test_dropped_harmonics_are_reported(run, curved, tmp_path):
    warning = "one colour for all directions; the scene's harmonics, of degree 3"
    assert warning in run("export", "splat", curved, "-o", tmp_path / "a.splat").err
    assert read_splats(tmp_path / "a.splat").degree == 0
    done = run("export", "splat", curved, "-o", tmp_path / "b.splat", "--degree", 2)
    assert done.status == 2
    assert "one colour for all directions" in done.err
    assert run("encode", curved, "-o", tmp_path / "a.swz").status == 0
    assert warning in run("decode", tmp_path / "a.swz", "-o", tmp_path / "c.splat").err
    assert warning not in run("decode", tmp_path / "a.swz", "-o", tmp_path / "c.ply").err


@pytest.mark.parametrize("name", ["x.ksplat", "x.txt", "-"])
def test_unknown_suffix_is_refused_before_decoding(run, curved, journey, tmp_path, monkeypatch, name):
    def never(*words, **options):
        raise AssertionError("decoded")

    assert run("encode", curved, "-o", tmp_path / "a.swz").status == 0
    monkeypatch.setattr("splatwire.cli._run_decode.decode_stream", never)
    done = run("decode", tmp_path / "a.swz", "-o", tmp_path / name if name != "-" else name)
    assert (done.status, done.out) == (2, "")
    assert "format of explicit Gaussians" in done.err
    done = run("decode", journey / "tiny.swz", "-o", tmp_path / "x.glb")
    assert done.status == 2
    assert "the name says a glTF file" in done.err


def test_spz_bits_reduce_size_and_are_refused_for_other_formats(run, curved, tmp_path):
    sizes = {}
    for name, words in {"full": (), "fewer": ("--harmonic-bits", 5, 4)}.items():
        found = run("export", "spz", curved, "-o", tmp_path / f"{name}.spz", "--json", *words)
        sizes[name] = found.json["num_bytes"]
    assert sizes["fewer"] < 0.9 * sizes["full"]
    for words, reason in (
        (("sog", curved, "-o", tmp_path / "a.sog", "--harmonic-bits", 5, 4), "is for spz"),
        (("spz", curved, "-o", tmp_path / "a.spz", "--harmonic-bits", 0, 9), "from 1 to 8"),
        (("sog", curved, "-o", tmp_path / "a.sog", "--spz-version", 3), "is for spz"),
        (("spz", curved, "-o", tmp_path / "a.spz", "--spz-version", 2), "is 3 or 4"),
    ):
        done = run("export", *words)
        assert done.status == 2
        assert reason in done.err
    assert run("export", "glb", curved, "-o", tmp_path / "a.glb").status == 0
    assert read_splats(tmp_path / "a.glb").degree == 3


def test_spz_defaults_to_version_4(run, curved, tmp_path):
    for name, words, start in (("new", (), b"NGSP\4"), ("old", ("--spz-version", 3), b"\x1f\x8b")):
        assert run("export", "spz", curved, "-o", tmp_path / f"{name}.spz", *words).status == 0
        assert (tmp_path / f"{name}.spz").read_bytes().startswith(start)
