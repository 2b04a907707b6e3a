"""Verbs fail on a damaged stream unless damage is allowed, and `verify` names damaged packets."""

import hashlib
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from explicit import ball_of_gaussians
from splatwire.bitstream import make_packet, packet_from_bytes, read_stream, write_stream
from splatwire.io.formats import write_splats

DAMAGES = ("flipped", "cut", "cut within a size", "longer", "foreign packet", "empty packet")


@pytest.fixture(params=DAMAGES)
def damaged(request: pytest.FixtureRequest, journey: Path, tmp_path: Path) -> Path:
    """A stream with a few damaged bytes."""
    if "packet" in request.param:
        folder = tmp_path / "damaged"
        shutil.copytree(journey / "packets", folder)
        file = folder / "pak_lane1_s0.pak"
        packet = packet_from_bytes(file.read_bytes(), None)
        other = make_packet(packet.id, packet.num_elements, packet.payload, stream_id=7).data
        file.write_bytes(other if request.param == "foreign packet" else b"")
        return folder
    data = bytearray((journey / "tiny.swz").read_bytes())
    size = len(data)
    data[-5] ^= 4 * (request.param == "flipped")
    path = tmp_path / "damaged.swz"
    last = next(n for n in range(4, size) if int.from_bytes(data[size - n - 4 : size - n], "little") == n)
    ends = {"cut": -5, "cut within a size": size - last - 2}
    path.write_bytes(bytes(data[: ends.get(request.param, size)]) + b"what is this" * (request.param == "longer"))
    return path


def test_verbs_fail_on_damage_unless_it_is_allowed(run, damaged, journey, tmp_path):
    for words in (
        ("inspect", damaged, "--json"),
        ("decode", damaged, "-o", tmp_path / "x.scene"),
        ("transmit", damaged, "-o", tmp_path / "y.swz", "--loss", "none"),
        ("render", damaged, "-o", tmp_path / "pictures", "--cameras", journey / "cameras.json", "--scale", "0.1"),
    ):
        done = run(*words)
        assert done.status == 3, words
        assert str(damaged) in done.err, words
        assert "--accept-damage" in done.err, words
        assert run(*words, "--accept-damage").status == 0, words


def test_packets_lost_by_a_channel_are_no_damage(run, journey, tmp_path):
    assert run("inspect", journey / "lossy.swz").status == 0
    assert run("decode", journey / "lossy.swz", "-o", tmp_path / "x.scene").status == 0


def test_verify_fails_on_damage_and_reports_its_position(run, damaged):
    done = run("verify", damaged)
    assert done.status == 3
    assert "damaged" in done.out
    facts = run("verify", damaged, "--accept-losses", "--json")
    assert (facts.status, facts.json["ok"], len(facts.json["streams"][str(damaged)]["problems"])) == (3, False, 1)
    place = "pak_lane1_s0.pak" if damaged.is_dir() else "byte "
    assert place in facts.json["streams"][str(damaged)]["problems"][0]


def test_verify_accepts_intact_streams_and_checks_every_argument(run, journey):
    both = run("verify", journey / "tiny.swz", journey / "packets", "--json")
    assert (both.status, both.json["ok"], len(both.json["streams"])) == (0, True, 2)
    assert "ok" in run("verify", journey / "tiny.swz").out
    one_bad = run("verify", journey / "tiny.swz", journey / "cameras.json", journey / "packets", "--json")
    assert (one_bad.status, [facts["ok"] for facts in one_bad.json["streams"].values()]) == (3, [True, False, True])


@pytest.mark.slow
def test_standard_input_named_twice_is_read_once(journey):
    command = [sys.executable, "-m", "splatwire", "verify", "-", "-"]
    done = subprocess.run(command, input=(journey / "tiny.swz").read_bytes(), capture_output=True, check=False)
    assert (done.returncode, done.stdout.count(b"ok: ")) == (0, 1), done.stderr


def test_verify_fails_on_missing_packets_unless_loss_is_allowed(run, journey):
    done = run("verify", journey / "lossy.swz")
    assert done.status == 3
    assert "incomplete" in done.out
    assert run("verify", journey / "lossy.swz", "--accept-losses").status == 0


def test_verify_finds_duplicate_packets(run, journey, tmp_path):
    data = (journey / "tiny.swz").read_bytes()
    last = next(n for n in range(4, len(data)) if int.from_bytes(data[-n - 4 : -n], "little") == n)
    (tmp_path / "copied.swz").write_bytes(data + data[-last - 4 :])
    done = run("verify", tmp_path / "copied.swz")
    assert done.status == 3
    assert "1 duplicate" in done.out


@pytest.mark.parametrize("place", [6, 40, 900])
def test_verify_finds_damaged_manifest_and_side_information(run, journey, tmp_path, place):
    data = bytearray((journey / "tiny.swz").read_bytes())
    data[place] ^= 1
    (tmp_path / "x.swz").write_bytes(data)
    done = run("verify", tmp_path / "x.swz")
    assert done.status == 3
    assert "x.swz" in done.out


@pytest.mark.parametrize(("name", "place"), [("tiny_levels", -1), ("tiny_clip", 1), ("tiny_causal", 1)])
def test_verify_finds_impossible_side_information_with_a_correct_digest(run, tmp_path, name, place):
    """Changes the last error in an index of tiles, or a version."""
    golden = Path(__file__).parents[1] / "golden" / f"{name}.swz"
    assert run("verify", golden).status == 0
    stream = read_stream(golden)[0]
    side_info = bytearray(stream.side_info)
    side_info[place] = 255
    side_info = bytes(side_info)
    manifest = replace(stream.manifest, side_info_digest=hashlib.sha256(side_info).hexdigest())
    write_stream(replace(stream, manifest=manifest, side_info=side_info), tmp_path / "a.swz")
    done = run("verify", tmp_path / "a.swz")
    assert (done.status, run("decode", tmp_path / "a.swz", "-o", tmp_path / "a.ply").status) == (3, 2)
    assert "not ok" in done.out


def test_verify_names_a_file_of_another_format_once(run, tmp_path):
    write_splats([ball_of_gaussians()], tmp_path / "cloud.ply")
    done = run("verify", tmp_path / "cloud.ply")
    assert done.status == 3
    assert "cloud.ply: not ok: not a splatwire stream; it" in done.out
    assert "a 3DGS PLY: `encode` makes a stream of it" in done.out
