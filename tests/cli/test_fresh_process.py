"""A fresh process decodes a stream, so that no state of the encoder can help."""

import json
import subprocess
import sys

import pytest

from splatwire.bitstream import read_stream
from splatwire.codec import decode_stream
from splatwire.types.scene_digest import scene_digest

pytestmark = pytest.mark.slow


def test_bytes_alone_decode_in_a_fresh_interpreter(journey, tmp_path):
    """The new interpreter gets the stream on standard input and starts in an empty folder."""
    data = (journey / "lossy.swz").read_bytes()
    command = [sys.executable, "-m", "splatwire", "decode", "-", "-o", "decoded.scene", "--json"]
    done = subprocess.run(command, input=data, cwd=tmp_path, capture_output=True, check=False)
    assert done.returncode == 0, done.stderr.decode()
    here = decode_stream(read_stream(journey / "lossy.swz")[0])
    there = json.loads(done.stdout)
    assert there["digest"] == scene_digest(here.scene.anchors)
    assert there["num_lost"] == here.loss_mask.num_lost > 0


def test_verbs_work_in_a_shell_pipe(journey, tmp_path):
    """encode | transmit | decode in a shell equals the same verbs with files."""
    program = f"{sys.executable} -m splatwire"
    line = (
        f"{program} encode - -o - --block-size 60 < {journey / 'tiny.scene'} | "
        f"{program} transmit - -o - --loss bernoulli:0.3 --seed 1 | {program} decode - -o decoded.scene --json"
    )
    done = subprocess.run(["bash", "-o", "pipefail", "-c", line], cwd=tmp_path, capture_output=True, check=False)
    assert done.returncode == 0, done.stderr.decode()
    here = decode_stream(read_stream(journey / "lossy.swz")[0])
    assert json.loads(done.stdout)["digest"] == scene_digest(here.scene.anchors)
