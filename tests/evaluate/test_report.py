import json
import re

import pytest

from scenes import tiny_cameras, tiny_scene
from splatwire.channel import parse_loss
from splatwire.codec import decode_stream, encode_scene
from splatwire.evaluate import Protocol, concealment_methods, evaluate_streams, rendered_views, write_report
from splatwire.packets import Packetization


@pytest.fixture(scope="module")
def evaluation(tmp_path_factory):
    stream = encode_scene(tiny_scene(seed=6, num_anchors=120), Packetization(block_size=60))
    scene = decode_stream(stream).scene
    views = rendered_views(scene, tiny_cameras(2, 48, 36), tmp_path_factory.mktemp("references"))
    protocol = Protocol(concealment_methods(("drop", "idw")), parse_loss("bernoulli:0.3"), (0, 1))
    return evaluate_streams(protocol, {"stream": stream}, views)


def test_a_report_is_complete_and_needs_nothing_from_elsewhere(evaluation, tmp_path):
    path = write_report(evaluation, tmp_path / "out", title="A <title>", notes=("One note.",), extra={"more": 1})
    text = path.read_text(encoding="utf-8")
    assert "A &lt;title&gt;" in text
    assert "One note." in text
    for row in evaluation.rows():
        assert f"<td>{row['method']}</td>" in text
        assert row["psnr"] is None or f"{row['psnr']:.2f}" in text
    assert "equal to the reference" in text
    assert "weights absent" in text
    assert text.count("data:image/jpeg;base64,") == 2 * (1 + 3 + 3) + 1  # reference, pictures, errors; loss map
    assert text.count("<svg") == 2
    addresses = set(re.findall(r"https?://[^\s\"'<)]+", text))
    assert all(
        "w3.org" in a or "purl.org" in a or "creativecommons.org" in a or "matplotlib.org" in a for a in addresses
    )
    assert not re.search(r"<(script|img|link)[^>]+(src|href)=\"(?!data:)", text)


def test_results_are_plain_json(evaluation, tmp_path):
    write_report(evaluation, tmp_path, title="t", extra={"more": 1})
    content = json.loads((tmp_path / "results.json").read_text(encoding="utf-8"), parse_constant=pytest.fail)
    assert content["rows"] == evaluation.rows()
    assert content["more"] == 1


def test_a_report_replaces_the_one_before(evaluation, tmp_path):
    for title in ("first", "second"):
        write_report(evaluation, tmp_path, title=title)
    assert "second" in (tmp_path / "report.html").read_text(encoding="utf-8")
    assert not [path for path in tmp_path.iterdir() if path.name.endswith(".part")]


def test_names_of_views_cannot_leave_the_folder(evaluation, tmp_path):
    import dataclasses

    sly = dataclasses.replace(evaluation, view_names=("../../sly", "/etc/passwd"))
    write_report(sly, tmp_path / "a" / "b", title="t")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a"]
    assert sorted(path.name for path in (tmp_path / "a").iterdir()) == ["b"]
