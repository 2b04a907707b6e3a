"""Names, kinds and ends: what is written under which name, and what is left when a verb is ended."""

import os
import signal
import subprocess
import sys
import time

import pytest

from scenes import tiny_cameras
from splatwire.data import save_cameras
from splatwire.files.whole import written_whole
from splatwire.formats.kinds import WRITERS


def assert_complains(outcome, *words):
    assert outcome.status == 2
    last = outcome.err.splitlines()[-1]
    assert last.startswith("splatwire: error: ")
    for word in words:
        assert str(word) in last


def test_views_whose_names_look_alike_become_different_files(run, journey, tmp_path):
    cameras = tiny_cameras(4, 32, 24)
    object.__setattr__(cameras, "names", ("a b", "a_b", "A_B", "../" + "x" * 400))
    save_cameras(cameras, tmp_path / "c.json")
    words = ("render", journey / "tiny.scene", "--cameras", tmp_path / "c.json", "-o", tmp_path / "out", "--json")
    pictures = run(*words).json["pictures"]
    assert pictures == ["a_b.png", "a_b_2.png", "A_B_3.png", "x" * 80 + ".png"]
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == sorted([*pictures, "cameras.json"])


@pytest.mark.parametrize(
    ("words", "name"),
    [
        (("export", "ply"), "a.spz"),
        (("export", "splat"), "a.ply"),
        (("export", "ply"), "a.SPLAT"),
        (("encode",), "a.ply"),
        (("encode",), "a.png"),
    ],
)
def test_a_name_that_says_another_format_is_refused(run, journey, tmp_path, words, name):
    assert_complains(run(*words, journey / "tiny.scene", "-o", tmp_path / name), name, "the name says", "end it in")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("words", "name"), [(("decode",), "a.swz"), (("decode",), "a.splat"), (("transmit",), "a.ply")]
)
def test_so_it_is_for_what_streams_become(run, journey, tmp_path, words, name):
    assert_complains(run(*words, journey / "tiny.swz", "-o", tmp_path / name), name, "the name says")


def test_a_stream_is_one_file_however_its_suffix_is_written(run, journey, tmp_path):
    assert run("transmit", journey / "tiny.swz", "-o", tmp_path / "a.SWZ", "--loss", "none").status == 0
    assert (tmp_path / "a.SWZ").read_bytes() == (journey / "tiny.swz").read_bytes()


def test_files_of_another_kind_are_called_by_their_name(run, journey, tmp_path):
    exported = run("export", "splat", journey / "tiny.scene", "-o", tmp_path / "a.splat", "--views", 9)
    assert exported.status == 0, exported.err
    assert run("import", "splats", tmp_path / "a.splat", "-o", tmp_path / "a.ply").status == 0
    outcome = run("encode", journey / "cameras.json", "-o", tmp_path / "b.swz")
    assert_complains(outcome, "cameras.json", "not a scene file", "a cameras file")
    assert_complains(run("decode", tmp_path / "a.ply", "-o", tmp_path / "b"), "a.ply", "stream", "a 3DGS PLY")
    words = ("render", journey / "cameras.json", "--cameras", journey / "cameras.json", "-o", tmp_path / "p")
    assert_complains(run(*words), "cameras.json", "a cameras file", "--cameras")
    assert_complains(run("import", "hacpp", journey / "tiny.swz", "-o", tmp_path / "c"), "tiny.swz", "a stream")
    assert_complains(run("render", journey / "tiny.scene", "--data", journey, "-o", tmp_path / "p"), "not a dataset")


def test_a_full_disk_leaves_no_half_picture(run, journey, tmp_path, monkeypatch):
    def full(descriptor):
        raise OSError(28, os.strerror(28))

    monkeypatch.setattr(os, "fsync", full)
    outcome = run("render", journey / "tiny.scene", "--cameras", journey / "cameras.json", "-o", tmp_path / "out")
    assert_complains(outcome, "No space left", tmp_path / "out" / "view_00.png")
    assert not list((tmp_path / "out").iterdir())


@pytest.mark.parametrize(("number", "status"), [(signal.SIGTERM, 143), (signal.SIGHUP, 129)])
def test_an_export_that_is_ended_leaves_nothing(run, journey, tmp_path, monkeypatch, number, status):
    def slow(parts, path):
        with written_whole(path) as unfinished:
            unfinished.write_bytes(b"half")
            os.kill(os.getpid(), number)
            time.sleep(60)

    monkeypatch.setitem(WRITERS, "ply", slow)
    words = ("export", "ply", journey / "tiny.scene", "-o", tmp_path / "a.ply", "--views", 9)
    outside = signal.signal(number, signal.SIG_DFL)  # under nohup these tests would inherit that it is ignored
    try:
        assert run(*words).status == status
        assert signal.getsignal(number) is signal.SIG_DFL
    finally:
        signal.signal(number, outside)
    assert not list(tmp_path.iterdir())


def splatwire(words, redirect):
    command = " ".join([sys.executable, "-m", "splatwire", *map(str, words), redirect])
    return subprocess.run(["/bin/sh", "-c", command], capture_output=True, text=True, check=False)


@pytest.mark.parametrize(
    ("words", "redirect", "status", "said"),
    [
        (["inspect", "-"], "<&-", 2, "standard input is closed"),
        (["transmit", "{journey}/tiny.swz", "-o", "-"], ">&-", 2, "standard output is closed"),
        (["inspect", "{journey}/tiny.swz", "--json"], ">&-", 2, "standard output is closed"),
        (["--version"], ">&-", 0, ""),
        (["inspect", "/nowhere"], "2>&-", 2, ""),
        (["inspect", "-"], "</dev/zero", 2, "standard input is neither stream nor scene"),
    ],
)
def test_closed_streams(journey, words, redirect, status, said):
    done = splatwire([word.format(journey=journey) for word in words], redirect)
    assert done.returncode == status, done.stderr
    assert said in done.stderr
    assert "Traceback" not in done.stderr
    assert not done.stdout


def test_a_public_function_that_gets_a_path_says_what_reads_it():
    """In a process of its own: the suite checks the types of arguments, a user's program does not."""
    code = (
        "import splatwire\n"
        "for call in (splatwire.encode_scene, splatwire.decode_stream, lambda x: splatwire.write_stream(x, 'y'),\n"
        "             lambda x: splatwire.transmit(x, None, seed=0)):\n"
        "    try:\n"
        "        call('x.ply')\n"
        "    except splatwire.SplatwireError as error:\n"
        "        print(error)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stdout.splitlines() == [
        "expected a scene (`open_scene` reads one from a file), not str",
        *["expected SceneStream (`read_stream` reads one from a file), not str"] * 3,
    ], done.stderr
