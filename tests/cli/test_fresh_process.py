"""A fresh process decodes a stream, so that no state of the encoder can help."""

import json
import os
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


@pytest.mark.parametrize("words", [("verify",), ("verify", "--json"), ("inspect",), ("inspect", "--json")])
def test_damaged_input_fails_even_if_the_output_is_not_read(journey, tmp_path, words):
    content = (journey / "tiny.swz").read_bytes()
    (tmp_path / "cut.swz").write_bytes(content[: len(content) * 3 // 4])
    line = f"{sys.executable} -m splatwire {' '.join(words)} cut.swz | true; exit ${{PIPESTATUS[0]}}"
    assert subprocess.run(["bash", "-c", line], cwd=tmp_path, capture_output=True, check=False).returncode == 3


@pytest.mark.parametrize("errors", ["2>&1", "2>/dev/full"])
@pytest.mark.parametrize(("name", "status"), [("cut.swz", 3), ("none.swz", 2)])
def test_bad_input_fails_even_if_the_errors_are_not_read(journey, tmp_path, name, status, errors):
    content = (journey / "tiny.swz").read_bytes()
    (tmp_path / "cut.swz").write_bytes(content[: len(content) * 3 // 4])
    line = f"{sys.executable} -m splatwire verify {name} {errors} | true; exit ${{PIPESTATUS[0]}}"
    assert subprocess.run(["bash", "-c", line], cwd=tmp_path, capture_output=True, check=False).returncode == status


def test_commands_continue_if_their_progress_is_not_read(journey, tmp_path):
    line = (
        f"{sys.executable} -m splatwire convert {journey / 'tiny.swz'} -o copy.swz 2>&1 | true; exit ${{PIPESTATUS[0]}}"
    )
    assert subprocess.run(["bash", "-c", line], cwd=tmp_path, capture_output=True, check=False).returncode == 0
    assert (tmp_path / "copy.swz").exists()


@pytest.mark.parametrize("encoding", ["ascii", "latin-1", "ascii:surrogateescape"])
def test_characters_that_a_terminal_lacks_are_escaped(journey, tmp_path, encoding):
    (tmp_path / "\u540d.swz").write_bytes((journey / "tiny.swz").read_bytes())
    command = [sys.executable, "-m", "splatwire", "inspect", "\u540d.swz"]
    done = subprocess.run(
        command, cwd=tmp_path, capture_output=True, check=False, env={**os.environ, "PYTHONIOENCODING": encoding}
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(b"\\u540d.swz (stream)")
