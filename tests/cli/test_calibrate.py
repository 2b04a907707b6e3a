def test_calibrate_then_conceal_with_the_weights(run, journey, tmp_path):
    weights = tmp_path / "w.safetensors"
    words = ("--preset", "compact", "--iterations", 2, "--json")
    content = run("calibrate", journey / "tiny.swz", "-o", weights, *words).json
    assert content["num_bytes"] == weights.stat().st_size
    assert content["iterations"] == 2
    assert set(content["errors"]) == set(content["reference"]) == {"feature", "scaling", "offset", "mask"}
    assert not (tmp_path / "w.safetensors.checkpoint").exists()
    outcome = run("decode", journey / "lossy.swz", "-o", tmp_path / "a.scene", "--conceal", f"gnn:{weights}", "--json")
    assert outcome.json["num_lost"] > 0


def test_mistakes(run, journey, tmp_path):
    for words, told in (
        ((journey / "lossy.swz", "-o", tmp_path / "w"), "complete"),
        ((journey / "tiny.swz", "-o", tmp_path / "w", "--preset", "magic"), "magic"),
        ((journey / "tiny.swz", "-o", tmp_path / "w", "--render-weight", 1), "cameras"),
        ((journey / "tiny.swz", "-o", tmp_path / "w", "--precision", "int1"), "int1"),
        ((journey / "tiny.swz", "-o", tmp_path / "w", "--resume"), "no such file"),
    ):
        outcome = run("calibrate", *words)
        assert outcome.status == 2
        assert told in outcome.err
    for weights in (tmp_path / "absent", journey / "tiny.swz"):
        outcome = run("decode", journey / "lossy.swz", "-o", tmp_path / "a", "--conceal", f"gnn:{weights}")
        assert outcome.status == 2
        assert weights.name in outcome.err
