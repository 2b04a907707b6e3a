import pytest

from splatwire.bitstream import read_stream

pytestmark = [pytest.mark.slow, pytest.mark.needs_torch]


def test_calibrated_weights_are_used_for_concealment(run, journey, tmp_path):
    weights = tmp_path / "w.safetensors"
    words = ("--preset", "compact", "--iterations", 2, "--json")
    content = run("calibrate", "gnn", journey / "tiny.swz", "-o", weights, *words).json
    assert content["num_bytes"] == weights.stat().st_size
    assert content["iterations"] == 2
    assert set(content["errors"]) == set(content["reference"]) == {"feature", "scaling", "offset", "mask"}
    assert not (tmp_path / "w.safetensors.checkpoint").exists()
    outcome = run("decode", journey / "lossy.swz", "-o", tmp_path / "a.scene", "--conceal", f"gnn:{weights}", "--json")
    assert outcome.json["num_lost"] > 0
    other = run("calibrate", "gnn", journey / "tiny.swz", "-o", tmp_path / "o", *words, "--distill-weight", 1).json
    assert (content["distill_weight"], other["distill_weight"]) == (0.25, 1)
    assert (tmp_path / "o").read_bytes() != weights.read_bytes()


def test_calibrate_adds_weights_to_a_stream(run, journey, tmp_path, monkeypatch):
    """Makes the interpolation useless, so that any network improves on it."""
    from splatwire.paper import PriorMean

    monkeypatch.setattr("splatwire.paper.gnn.graph.Kriging", PriorMean)
    target = tmp_path / "calibrated.swz"
    words = ("--preset", "compact", "--iterations", 20, "--json")
    content = run("calibrate", "gnn", journey / "tiny.swz", "-o", target, *words).json
    inspected = run("inspect", target, "--json").json
    plain = run("inspect", journey / "tiny.swz", "--json").json
    assert content["embedded"]
    assert content["attributes_taken"] == ["feature"]
    assert 0 <= content["num_bytes"] - inspected["side_info_parts"]["gnn"] < 10  # the manifest states a larger size
    assert "gnn" not in plain["side_info_parts"]
    assert target.stat().st_size == content["stream_bytes"] == inspected["num_bytes"]
    assert read_stream(target)[0].packets == read_stream(journey / "tiny.swz")[0].packets
    run("transmit", target, "-o", tmp_path / "lossy.swz", "--loss", "bernoulli:0.4", "--seed", 1)
    for name, conceal in (("a", "gnn"), ("b", "kriging")):
        run("decode", tmp_path / "lossy.swz", "-o", tmp_path / name, "--conceal", conceal)
    assert (tmp_path / "a").read_bytes() != (tmp_path / "b").read_bytes()


def test_weights_without_improvement_are_not_added_to_the_stream(run, journey, tmp_path, monkeypatch):
    monkeypatch.setattr("splatwire.paper.gnn.weights.GnnWeights.is_used", property(lambda _: False))
    words = ("--preset", "compact", "--iterations", 2)
    outcome = run("calibrate", "gnn", journey / "tiny.swz", "-o", tmp_path / "c.swz", *words)
    assert outcome.status == 2
    assert "nothing improves" in outcome.err
    assert list(tmp_path.iterdir()) == []


def test_invalid_options_are_refused(run, journey, tmp_path):
    for words, message in (
        ((journey / "lossy.swz", "-o", tmp_path / "w"), "complete"),
        ((journey / "tiny.swz", "-o", tmp_path / "w", "--preset", "magic"), "magic"),
        ((journey / "tiny.swz", "-o", tmp_path / "w", "--render-weight", 1), "cameras"),
        ((journey / "tiny.swz", "-o", tmp_path / "w", "--distill-weight", -1), "--distill-weight is 0 or more"),
        ((journey / "tiny.swz", "-o", tmp_path / "w", "--precision", "int1"), "int1"),
        ((journey / "tiny.swz", "-o", tmp_path / "w", "--device", "tape"), "tape"),
        ((journey / "tiny.swz", "-o", tmp_path / "w", "--resume"), "no such file"),
        ((journey / "tiny.swz", "-o", tmp_path / "w.swz", "--bits", 9), "from 2 to 6"),
        ((journey / "tiny.swz", "-o", tmp_path), "is a folder"),
    ):
        outcome = run("calibrate", "gnn", *words)
        assert outcome.status == 2
        assert message in outcome.err
    for weights in (tmp_path / "absent", journey / "tiny.swz"):
        outcome = run("decode", journey / "lossy.swz", "-o", tmp_path / "a", "--conceal", f"gnn:{weights}")
        assert outcome.status == 2
        assert weights.name in outcome.err


def test_sketch_is_stored_in_the_stream(run, journey, tmp_path):
    target = tmp_path / "sketched.swz"
    words = ("--share", 0.1, "--json")
    content = run("calibrate", "sketch", journey / "tiny.swz", "-o", target, *words).json
    inspected = run("inspect", target, "--json").json
    assert content["views"] == "against the complete scene on a sphere of views"
    assert inspected["num_bytes"] == content["stream_bytes"] == target.stat().st_size
    assert 0 <= content["num_bytes"] - inspected["side_info_parts"]["sketch"] < 10
    assert set(content["psnr_held_out"]) == {"no loss", "drop", "grow", "sketch"}
    run("transmit", target, "-o", tmp_path / "lossy.swz", "--loss", "bernoulli:0.4", "--seed", 1)
    for name, conceal in (("a", "sketch"), ("b", "drop")):
        run("decode", tmp_path / "lossy.swz", "-o", tmp_path / name, "--conceal", conceal)
    assert (tmp_path / "a").read_bytes() != (tmp_path / "b").read_bytes()
    for words, message in (
        (("calibrate", "sketch", journey / "tiny.swz", "-o", tmp_path / "w"), "must end in .swz"),
        (("calibrate", "sketch", journey / "tiny.swz", "-o", target, "--share", 0.9), "share=0.9"),
        (("calibrate", "sketch", journey / "tiny.swz", "-o", target, "--data", "a", "--cameras", "b"), "not both"),
        (("calibrate", "magic", journey / "tiny.swz", "-o", target), "magic"),
        (("decode", journey / "lossy.swz", "-o", tmp_path / "c", "--conceal", "sketch"), "calibrate sketch"),
    ):
        outcome = run(*words)
        assert outcome.status == 2
        assert message in outcome.err


def test_preview_is_stored_in_the_stream(run, journey, tmp_path, monkeypatch):
    from splatwire.bitstream.sections import split_sections
    from splatwire.calibration import preview as fit
    from splatwire.codec.preview import preview_gaussians

    settings = fit.PreviewConfig
    monkeypatch.setattr(
        "splatwire.cli._run_calibrate.PreviewConfig",
        lambda seed: settings(steps=60, num_relocations=2, width=48, seed=seed),
    )
    target, words = tmp_path / "previewed.swz", ("--cameras", journey / "cameras.json")
    content = run("calibrate", "preview", journey / "tiny.swz", "-o", target, *words, "--json").json
    inspected = run("inspect", target, "--json").json
    assert content["scored"] == "the views it was fitted to"
    assert inspected["num_bytes"] == content["stream_bytes"] == target.stat().st_size
    assert 0 <= content["num_bytes"] - inspected["side_info_parts"]["preview"] < 10
    assert set(content["psnr"]) == {"background", "preview", "complete"}
    stream = read_stream(target)[0]
    section = split_sections(stream.side_info, stream.manifest.schema_name)[1]["preview"]
    assert len(section) == content["preview_bytes"]
    assert preview_gaussians(section)[0].num_gaussians == content["num_gaussians"]
    assert stream.packets == read_stream(journey / "tiny.swz")[0].packets
    again = run("calibrate", "preview", target, "-o", tmp_path / "again.swz", *words)
    assert "dB" in again.out
    assert (tmp_path / "again.swz").read_bytes() == target.read_bytes()
    for source, output, message in (("tiny.swz", "w", "must end in .swz"), ("lossy.swz", "w.swz", "packets were lost")):
        outcome = run("calibrate", "preview", journey / source, "-o", tmp_path / output)
        assert outcome.status == 2
        assert message in outcome.err


@pytest.mark.parametrize(
    ("method", "options"),
    [
        ("sketch", ("--preset", "--bits", "--iterations", "--precision", "--resume", "--render-weight")),
        ("preview", ("--preset", "--bits", "--iterations", "--precision", "--resume", "--share", "--drop-rate")),
        ("gnn", ("--data", "--share")),
    ],
)
def test_calibrations_refuse_options_of_other_calibrations(run, journey, tmp_path, method, options):
    for option in options:
        value = () if option == "--resume" else (4,)
        outcome = run("calibrate", method, journey / "tiny.swz", "-o", tmp_path / "a.swz", option, *value)
        assert outcome.status == 2
        assert option in outcome.err
    assert not (tmp_path / "a.swz").exists()


@pytest.mark.parametrize(("present", "message"), [(False, "torch finds no CUDA device"), (True, "--device cpu")])
def test_cuda_requires_a_gpu_and_excludes_the_rendering_loss(run, journey, tmp_path, monkeypatch, present, message):
    monkeypatch.setattr("torch.cuda.is_available", lambda: present)
    words = ("--device", "cuda", "--render-weight", 1, "--cameras", "cameras.json")
    outcome = run("calibrate", "gnn", journey / "tiny.swz", "-o", tmp_path / "w", *words)
    assert outcome.status != 0
    assert message in outcome.err


@pytest.mark.parametrize(
    ("name", "words", "message"),
    [
        ("w.swz", ("--precision", "float32"), "--precision"),
        ("w", ("--cameras", "cameras.json"), "--cameras"),
        ("w", ("--render-width", 100), "--render-width"),
        ("w", ("--background", 1, 1, 1), "--background"),
    ],
)
def test_option_without_effect_is_refused(run, journey, tmp_path, name, words, message):
    outcome = run("calibrate", "gnn", journey / "tiny.swz", "-o", tmp_path / name, *words)
    assert outcome.status == 2
    assert message in outcome.err
    assert list(tmp_path.iterdir()) == []
