"""A tiny scene on disk and a protocol for it."""

import pytest

from scenes import tiny_cameras, tiny_scene
from splatwire.bitstream import Packetization, write_stream
from splatwire.codec import encode_scene
from splatwire.data import save_cameras

PROTOCOL = """
[protocol]
name = "tiny"
title = "A tiny protocol"
baseline = "drop"
seeds = [0, 3]
metrics = ["psnr", "ssim"]

[[scene]]
name = "made up"
dataset = "made up"
stream = "tiny.swz"
cameras = "cameras.json"

[[loss]]
model = "bernoulli:0.3"

[[row]]
key = "reference"
label = "no loss"
lossless = true

[[row]]
key = "contiguous"
label = "contiguous, none"
grouping = "contiguous"
block_size = 60

[[row]]
key = "drop"
label = "none"
block_size = 60

[[row]]
key = "idw"
label = "IDW"
conceal = "idw"
block_size = 60

[[published]]
row = "drop"
dataset = "Paper scenes"
psnr = 20.0

[[published]]
row = "idw"
dataset = "Paper scenes"
psnr = 22.5
"""


@pytest.fixture(scope="session")
def tiny_folder(tmp_path_factory):
    """`tiny.swz`, `cameras.json` and `protocol.toml`."""
    folder = tmp_path_factory.mktemp("study")
    write_stream(encode_scene(tiny_scene(seed=5, num_anchors=180), Packetization(block_size=60)), folder / "tiny.swz")
    save_cameras(tiny_cameras(2, 48, 36), folder / "cameras.json")
    (folder / "protocol.toml").write_text(PROTOCOL)
    return folder


@pytest.fixture
def edited(tiny_folder, tmp_path):
    """Writes the protocol with changes and returns its path."""

    def write(*changes: tuple[str, str]):
        text = PROTOCOL.replace('"tiny.swz"', f'"{tiny_folder / "tiny.swz"}"')
        text = text.replace('"cameras.json"', f'"{tiny_folder / "cameras.json"}"')
        for old, new in changes:
            assert old in text
            text = text.replace(old, new, 1)
        path = tmp_path / "edited.toml"
        path.write_text(text)
        return path

    return write
