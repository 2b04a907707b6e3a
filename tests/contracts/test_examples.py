"""Examples of the repository run as they stand."""

import runpy
from pathlib import Path

from scenes import tiny_cameras, tiny_scene
from splatwire.codec import encode_scene
from splatwire.conceal import concealer_names
from splatwire.data import save_cameras
from splatwire.packets import Packetization, write_stream

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


def test_lose_and_conceal(tmp_path, capsys):
    write_stream(encode_scene(tiny_scene(num_anchors=120), Packetization(block_size=60)), tmp_path / "a.swz")
    save_cameras(tiny_cameras(1, 32, 24), tmp_path / "cameras.json")
    main = runpy.run_path(str(EXAMPLES / "lose_and_conceal.py"))["main"]
    main(str(tmp_path / "a.swz"), str(tmp_path / "cameras.json"), "bernoulli:0.4")
    lines = capsys.readouterr().out.splitlines()
    assert "packets (pak) lost" in lines[0]
    assert [line.split()[0] for line in lines[1:]] == list(concealer_names())
