"""All verbs in turn on a model that the official HAC++ code trained."""

import pytest

pytestmark = [pytest.mark.data, pytest.mark.slow]


@pytest.mark.needs_torch
def test_real_model_passes_every_verb(run, data_dir, tmp_path):
    photos, scene, stream = data_dir / "scenes" / "snowmiku_small", tmp_path / "a.scene", tmp_path / "a.swz"
    imported = run("import", "hacpp", data_dir / "hacpp" / "snowmiku_small_2400", "-o", scene, "--json").json
    encoded = run("encode", scene, "-o", stream, "--json").json
    assert imported["num_anchors"] == encoded["num_elements"] == 30_781
    assert encoded["num_bytes"] <= 1_028_327  # total that HAC++ reports for this model, weights included
    sent = run("transmit", stream, "-o", tmp_path / "lossy", "--json").json
    decoded = run("decode", tmp_path / "lossy", "-o", tmp_path / "b.scene", "--conceal", "grow", "--json").json
    assert decoded["num_lost"] == sent["num_lost_elements"] > 0
    words = ("--data", photos, "--json")
    drawn = run("render", tmp_path / "b.scene", "--scale", 0.25, "-o", tmp_path / "pictures", *words).json
    assert drawn["num_views"] == len(list((tmp_path / "pictures").glob("*.png"))) == 7
    for source, low in ((stream, 26.0), (tmp_path / "b.scene", 22.0)):
        rows = run("evaluate", source, "--views", 2, *words).json["rows"]
        assert len(rows) == 1
        assert low < rows[0]["psnr"] < 35
