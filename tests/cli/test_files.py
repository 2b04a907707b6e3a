"""Names and kinds of output files, and the files that remain after an interruption."""

import errno
import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from scenes import tiny_cameras
from splatwire.cli import _run_render
from splatwire.cli._files import refuse_own_input
from splatwire.cli._parsing import settings_of
from splatwire.cli._verbs import VERBS
from splatwire.data import save_cameras
from splatwire.errors import InvalidValueError
from splatwire.files.atomic_write import atomic_output
from splatwire.files.scene_formats import FORMATS


def assert_complains(outcome, *words):
    assert outcome.status == 2
    last = outcome.err.splitlines()[-1]
    assert last.startswith("splatwire: error: ")
    for word in words:
        assert str(word) in last


def test_views_with_similar_names_become_different_files(run, journey, tmp_path):
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
        (("encode",), "a.gltf"),
        (("encode",), "a.parquet"),
        (("encode",), "a.csv"),
        (("export", "spz"), "b.gltf"),
        (("export", "glb"), "b.gltf"),
        (("export", "ply"), "a.usdz"),
    ],
)
def test_output_suffix_of_another_format_is_refused(run, journey, tmp_path, words, name):
    assert_complains(run(*words, journey / "tiny.scene", "-o", tmp_path / name), name, "the name says", "end it in")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("words", "name"), [(("decode",), "a.swz"), (("decode",), "a.splat"), (("transmit",), "a.ply")]
)
def test_decoded_output_suffix_of_another_format_is_refused(run, journey, tmp_path, words, name):
    assert_complains(run(*words, journey / "tiny.swz", "-o", tmp_path / name), name, "the name says")


def test_stream_suffix_is_case_insensitive(run, journey, tmp_path):
    assert run("transmit", journey / "tiny.swz", "-o", tmp_path / "a.SWZ", "--loss", "none").status == 0
    assert (tmp_path / "a.SWZ").read_bytes() == (journey / "tiny.swz").read_bytes()


@pytest.mark.needs_torch
def test_errors_name_the_kind_of_a_wrong_file(run, journey, tmp_path):
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


def test_pictures_appear_together_and_an_interrupted_render_keeps_the_earlier_ones(run, journey, tmp_path, monkeypatch):
    def interrupted(scene, cameras, **options):
        yield next(iterate_views(scene, cameras, **options))
        raise KeyboardInterrupt

    out, iterate_views = tmp_path / "out", _run_render.iterate_views
    words = ("render", journey / "tiny.scene", "--cameras", journey / "cameras.json", "-o", out)
    for there in (False, True):
        if there:
            run(*words)
            (out / "notes.txt").write_text("mine")
            (out / "view_00.png").write_bytes(b"earlier")
        before = {path.name: path.read_bytes() for path in out.iterdir()} if there else {}
        with monkeypatch.context() as patched:
            patched.setattr(_run_render, "iterate_views", interrupted)
            assert run(*words).status == 130
        assert ({path.name: path.read_bytes() for path in out.iterdir()} if out.exists() else {}) == before
    run(*words)
    assert sorted(path.name for path in out.iterdir()) == ["cameras.json", "notes.txt", "view_00.png", "view_01.png"]
    assert (out / "view_00.png").read_bytes() != b"earlier"


def test_pictures_do_not_replace_cameras_of_another_program(run, journey, tmp_path):
    view = {"img_name": "a", "position": [0, 0, -3], "rotation": np.eye(3).tolist(), "fx": 30, "fy": 30}
    text = json.dumps([{"id": 0, "width": 32, "height": 24, **view}])
    (tmp_path / "cameras.json").write_text(text)
    words = ("render", journey / "tiny.scene", "--cameras", tmp_path / "cameras.json", "-o")
    assert_complains(run(*words, tmp_path), "cameras.json was not written by splatwire")
    assert (tmp_path / "cameras.json").read_text() == text
    for _ in range(2):
        assert run(*words, tmp_path / "pictures").status == 0


def test_full_disk_leaves_no_partial_picture(run, journey, tmp_path, monkeypatch):
    def full(descriptor):
        raise OSError(28, os.strerror(28))

    monkeypatch.setattr(os, "fsync", full)
    outcome = run("render", journey / "tiny.scene", "--cameras", journey / "cameras.json", "-o", tmp_path / "out")
    assert_complains(outcome, "No space left", tmp_path / "out")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("number", "status"), [(signal.SIGTERM, 143), (signal.SIGHUP, 129)])
def test_interrupted_export_leaves_no_file(run, journey, tmp_path, monkeypatch, number, status):
    def slow(parts, path, **facts):
        with atomic_output(path) as unfinished:
            unfinished.write_bytes(b"half")
            os.kill(os.getpid(), number)
            time.sleep(60)

    monkeypatch.setitem(FORMATS._entries, "ply", replace(FORMATS["ply"], write=slow))
    words = ("export", "ply", journey / "tiny.scene", "-o", tmp_path / "a.ply", "--views", 9)
    outside = signal.signal(number, signal.SIG_DFL)  # under nohup these tests would inherit an ignored signal
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
        (["encode", "--help"], ">&-", 0, ""),
        (["inspect", "/nowhere"], "2>&-", 2, ""),
        (["inspect", "-"], "</dev/zero", 2, "standard input is neither stream nor scene"),
    ],
)
def test_closed_standard_streams_end_without_traceback(journey, words, redirect, status, said):
    done = splatwire([word.format(journey=journey) for word in words], redirect)
    assert done.returncode == status, done.stderr
    assert said in done.stderr
    assert "Traceback" not in done.stderr
    assert not done.stdout


def test_public_functions_name_the_reader_when_given_a_path():
    """Runs in a separate process, because the test suite checks argument types and user programs do not."""
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


MIN_WORDS = {
    "demo": [], "train": ["x"], "calibrate": ["sketch", "x"], "import": ["hacpp", "x"], "export": ["ply", "x"],
    "encode": ["x"], "transmit": ["x"], "plan": ["x"], "receive": ["udp://127.0.0.1:9"], "pack": ["x"],
    "decode": ["x"], "render": ["x"], "evaluate": ["x"], "compare": ["x", "y"],
    "apply": ["x", "y"],
    "convert": ["x"],
    "publish": ["x"],
    "thumb": ["x"],
    "study": ["x.toml"],
}  # fmt: skip
"""Words with which a verb would begin to work; `x` does not exist, which is found out later."""


def test_every_verb_with_an_output_is_covered_by_the_tests():
    without = {"inspect", "serve", "token", "live", "view", "verify"}
    assert {*MIN_WORDS, *without} == set(VERBS)
    for verb in without:
        assert not hasattr(settings_of(verb), "output")


@pytest.mark.parametrize("verb", MIN_WORDS)
def test_an_output_that_cannot_be_written_is_refused_before_the_work(run, tmp_path, verb):
    (tmp_path / "file").touch()
    (tmp_path / "loop").symlink_to("loop")
    for output, words in (
        ("/proc/out", ["nothing can be written into /proc"]),
        (tmp_path / "file" / "out", [tmp_path / "file", "not a folder"]),
        (tmp_path / "none" / "out", [tmp_path / "none", "no such folder"]),
        (tmp_path / "loop" / "out", ["loop"]),
        (tmp_path / ("x" * 300), ["File name too long"]),
    ):
        assert_complains(run(verb, *MIN_WORDS[verb], "-o", output), *words)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "loop"]


@pytest.mark.parametrize("verb", MIN_WORDS)
def test_a_folder_of_another_user_is_refused_before_the_work(run, tmp_path, monkeypatch, verb):
    made = Path.mkdir

    def mkdir(path, *rest, **more):
        if path.parent == tmp_path:
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))
        made(path, *rest, **more)

    monkeypatch.setattr(Path, "mkdir", mkdir)
    outcome = run(verb, *MIN_WORDS[verb], "-o", tmp_path / "out")
    assert_complains(outcome, f"nothing can be written into {tmp_path}: Permission denied")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("verb", ["render", "evaluate", "publish", "study"])
def test_a_folder_is_not_written_to_standard_output(run, journey, tmp_path, monkeypatch, verb):
    monkeypatch.chdir(tmp_path)
    protocol = tmp_path.parent / "small.toml"
    protocol.write_text('[protocol]\nname = "x"\ntitle = "x"\n[[scene]]\nname = "a"\nstream = "a.swz"\n')
    scene = protocol if verb == "study" else journey / "tiny.scene"
    more = ("--reference", journey / "tiny.scene") if verb == "evaluate" else ()
    outcome = run(verb, scene, "-o", "-", *more)
    assert outcome.status == 2
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("words", "name"),
    [
        (("render", "{scene}"), "picture.png"),
        (("render", "{scene}"), "picture.webp"),
        (("render", "{scene}"), "turn.mp4"),
        (("render", "{scene}"), "turn.AVI"),
        (("render", "{scene}"), "picture.tif"),
        (("compare", "{scene}", "{scene}"), "report.csv"),
        (("compare", "{scene}", "{scene}"), "report.parquet"),
        (("publish", "{scene}"), "scene.gltf"),
        (("evaluate", "{scene}", "--reference", "{scene}"), "report.html"),
        (("compare", "{scene}", "{scene}"), "report.html"),
        (("publish", "{scene}"), "page.html"),
        (("demo",), "report.html"),
        (("convert", "{scene}", "--to", "ply"), "scene.ply"),
    ],
)
def test_a_new_folder_is_not_named_like_a_file(run, journey, tmp_path, words, name):
    done = run(*(word.format(scene=journey / "tiny.scene") for word in words), "-o", tmp_path / name)
    assert_complains(done, name, "but a folder is written")
    assert ("`thumb` draws one picture, and a clip, which `encode` makes of files of Gaussians" in done.err) is (
        words[0] == "render"
    )
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("named", ["a", "link", "./b/../a"])
@pytest.mark.parametrize(
    ("words", "name"),
    [
        (("transmit", "{a}.swz", "--loss", "bernoulli:0.5", "-o", "{o}.swz"), "a.swz"),
        (("encode", "{a}.swz", "-o", "{o}.swz"), "a.swz"),
        (("encode", "{a}.ply", "--update", "{a}.swz", "-o", "{o}.swz"), "a.swz"),
        (("convert", "{a}.ply", "{o}.ply"), "a.ply"),
        (("convert", "{a}.swz", "{o}.swz"), "a.swz"),
        (("export", "ply", "{a}.ply", "-o", "{o}.ply"), "a.ply"),
        (("apply", "{x}.swz", "{a}.swz", "-o", "{o}.swz"), "a.swz"),
        (("pack", "{a}.glb", "-o", "{o}.glb"), "a.glb"),
        (("import", "splats", "{a}.ply", "-o", "{o}.ply"), "a.ply"),
    ],
)
def test_an_output_that_is_an_input_is_refused(run, tmp_path, words, name, named):
    (tmp_path / "b").mkdir()
    for path in ("a.ply", "a.swz", "a.glb", "x.swz"):
        (tmp_path / path).write_bytes(b"the only copy")
    (tmp_path / f"link{Path(name).suffix}").symlink_to(tmp_path / name)
    names = {"a": tmp_path / "a", "x": tmp_path / "x", "o": f"{tmp_path}/{named}"}
    assert_complains(run(*(word.format(**names) for word in words)), f"is the input {tmp_path / name}", "would be lost")
    assert (tmp_path / name).read_bytes() == b"the only copy"


def test_an_output_that_is_redirected_to_standard_input_is_refused(tmp_path, monkeypatch):
    (tmp_path / "a").write_bytes(b"the only copy")
    (tmp_path / "b").write_bytes(b"")
    with (tmp_path / "a").open() as file:
        monkeypatch.setattr(sys, "stdin", file)
        refuse_own_input(tmp_path / "b", "-")
        refuse_own_input("-", "-")
        with pytest.raises(InvalidValueError, match="is the input standard input, which would be lost"):
            refuse_own_input(tmp_path / "a", "-")


def test_a_decoded_scene_does_not_replace_its_stream(run, journey, tmp_path):
    path = tmp_path / "a"
    path.write_bytes((journey / "tiny.swz").read_bytes())
    assert_complains(run("decode", path, "-o", path), "would be lost")
    assert path.read_bytes() == (journey / "tiny.swz").read_bytes()


@pytest.mark.parametrize("verb", ["pack", "evaluate", "verify", "publish", "serve"])
def test_a_link_to_itself_is_no_input(run, journey, tmp_path, verb):
    link = tmp_path / "loop.swz"
    link.symlink_to("loop.swz")
    more = {"evaluate": ("--reference", journey / "tiny.scene"), "pack": ("-o", tmp_path / "x.html"),
            "publish": ("-o", tmp_path / "x")}.get(verb, ())  # fmt: skip
    assert_complains(run(verb, link, *more), "loop.swz")


def test_names_that_are_not_utf8_are_evaluated_and_not_published(run, journey, tmp_path):
    name = tmp_path / os.fsdecode(b"bad\xff.swz")
    name.write_bytes((journey / "tiny.swz").read_bytes())
    done = run("evaluate", name, "--reference", journey / "tiny.scene", "--views", 1, "-o", tmp_path / "report")
    assert done.status == 0, done.err
    assert "bad\\udcff.swz" in (tmp_path / "report" / "report.html").read_text(encoding="utf-8")
    for verb, *more in (("publish", "-o", tmp_path / "site"), ("pack", "-o", tmp_path / "a.html"), ("serve",)):
        assert_complains(run(verb, name, *more), "not valid UTF-8: rename it")
