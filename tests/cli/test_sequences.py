"""Clips on the command line: from a folder of frames to packets, losses and a folder of frames."""

import errno
import json
import shutil
import signal
import subprocess
import sys
import time

import pytest

from moving_sequences import GAUSSIANS, darkened, moving_frames, shuffled, splatv
from splatwire.bitstream import read_stream
from splatwire.cli import _run_serve
from splatwire.cli._received_scenes import write_scene
from splatwire.cli.receive import Receive
from splatwire.cli.serve import Serve
from splatwire.errors import InvalidValueError
from splatwire.io import open_scene
from splatwire.io.formats import write_splats
from splatwire.sequence import frame_writer, open_sequence

pytestmark = pytest.mark.slow

FRAMES = 6


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Folder of frames with names that sort by number, and a file that is not a frame."""
    target = tmp_path_factory.mktemp("frames")
    for number, splats in enumerate(moving_frames(300, FRAMES)):
        write_splats([splats], target / f"frame_{number + 5}.ply")
    (target / "notes.txt").write_text("not a frame")
    return target


@pytest.fixture(scope="module")
def clip(folder, tmp_path_factory):
    target = tmp_path_factory.mktemp("clip") / "clip.swz"
    from splatwire.cli.main import main

    with pytest.raises(SystemExit):
        main(["encode", str(folder), "-o", str(target), "--fps", "12.5", "--group", "3"])
    return target


@pytest.mark.parametrize("source", ["folder", "splatv"])
@pytest.mark.parametrize("words", [("--preset", "datagram"), ("--levels", "auto")], ids=["preset", "levels"])
def test_options_of_still_scenes_are_refused_before_anything_is_loaded(folder, tmp_path, source, words):
    """A separate process shows that the codec is not loaded before the check."""
    if source == "splatv":
        (tmp_path / "a.splatv").write_bytes(splatv())
        folder = tmp_path / "a.splatv"
    code = (
        "import sys\nfrom splatwire.cli.main import main\n"
        f"try: main(['encode', {str(folder)!r}, '-o', 'x.swz', *{words!r}])\n"
        "except SystemExit as end: print(end.code, 'torch' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path, check=False)
    assert done.stdout == "2 False\n"
    assert f"{words[0]} is for a still scene" in done.stderr


def test_encode_reports_frames_and_bytes(run, folder, tmp_path):
    content = run("encode", folder, "-o", tmp_path / "a.swz", "--fps", 25, "--group", 4, "--json").json
    assert content["num_bytes"] == (tmp_path / "a.swz").stat().st_size
    assert (content["frames"], content["frame_rate"], content["group_frames"]) == (FRAMES, 25, 4)
    assert (content["frames_matched"], content["share_matched"]) == (0, 1.0)
    assert content["num_tracks"] > 300 * 0.9
    assert "6 frames of" in run("encode", folder, "-o", tmp_path / "b.swz").out


def test_folder_with_one_file_becomes_a_clip_with_a_warning(run, folder, tmp_path):
    (tmp_path / "one").mkdir()
    shutil.copy(folder / "frame_5.ply", tmp_path / "one")
    done = run("encode", tmp_path / "one", "-o", tmp_path / "clip.swz")
    assert done.status == 0
    assert "has one frame, of which a clip is made: name the file in it for a still" in done.err


def test_encode_reports_shuffled_frames(run, tmp_path):
    for number, splats in enumerate(shuffled(moving_frames(300, 4))):
        write_splats([splats], tmp_path / f"{number}.ply")
    content = run("encode", tmp_path, "-o", tmp_path / "a.swz", "--json").json
    assert content["frames_matched"] == 3
    assert content["share_matched"] > 0.97


def test_inspect_reports_motion(run, clip):
    content = run("inspect", clip, "--json").json
    assert content["format_version"] == 3
    facts = content["clip"]
    assert (facts["frames"], facts["frame_rate"], facts["groups"]) == (FRAMES, 12.5, 2)
    assert facts["base_bytes"] + facts["motion_bytes"] == sum(p.num_bytes for p in read_stream(clip)[0].packets)
    assert 0 < facts["still_share"] < 1
    assert "frame_rate" in run("inspect", clip).out


@pytest.mark.parametrize(("words", "suffix"), [((), ".ply"), (("--format", "spz"), ".spz")])
def test_decode_writes_one_file_per_frame(run, clip, tmp_path, words, suffix):
    content = run("decode", clip, "-o", tmp_path / "out", "--json", *words).json
    files = sorted((tmp_path / "out").iterdir())
    assert [file.name for file in files] == [f"frame_{number}{suffix}" for number in range(FRAMES)]
    assert (content["num_frames"], content["num_concealed"]) == (FRAMES, 0)
    assert open_scene(files[0]).num_elements == 294  # six of 300 appear later


def test_a_full_disk_leaves_no_part_of_received_frames(clip, tmp_path, monkeypatch):
    stream, command = read_stream(clip)[0], Receive("udp://127.0.0.1/clip", str(tmp_path / "frames"), conceal="motion")
    write = frame_writer.write_splats

    def full(parts, path, **facts):
        if path.stem == "frame_3":
            raise OSError(errno.ENOSPC, "No space left on device", str(path))
        return write(parts, path, **facts)

    with monkeypatch.context() as patch:
        patch.setattr(frame_writer, "write_splats", full)
        with pytest.raises(OSError, match="No space left"):
            write_scene(command, stream, tmp_path / "frames", lambda task, share: None)
    assert not list(tmp_path.iterdir())
    write_scene(command, stream, tmp_path / "frames", lambda task, share: None)
    assert len(list((tmp_path / "frames").iterdir())) == FRAMES


def test_received_frames_do_not_go_to_standard_output(clip, tmp_path):
    with pytest.raises(InvalidValueError, match="a folder is written, which standard output cannot be"):
        write_scene(
            Receive("udp://h", "-", conceal="motion"), read_stream(clip)[0], tmp_path / "x", lambda task, share: None
        )
    assert not list(tmp_path.iterdir())


def test_a_stream_that_the_output_cannot_contain_replaces_no_file(clip, tmp_path, monkeypatch):
    """Not even one that has the name of the stream that is written instead."""
    monkeypatch.chdir(tmp_path)
    stream, own = read_stream(clip)[0], tmp_path / "room.swz"
    own.write_bytes(b"own")
    for number in (2, 3):
        with pytest.raises(InvalidValueError, match=rf"what arrived is in .*room_{number}\.swz"):
            write_scene(Receive("udp://h", "room.ply"), stream, tmp_path / "x", lambda task, share: None)
        assert read_stream(tmp_path / f"room_{number}.swz")[0].packets == stream.packets
    assert own.read_bytes() == b"own"


@pytest.mark.parametrize(("most", "words"), [(20_000, ("--max-frames", FRAMES - 1)), (FRAMES - 1, ())])
def test_decode_writes_very_many_frames_only_on_request(run, clip, tmp_path, monkeypatch, most, words):
    """A few bytes may announce 131,072 frames: the error states the number, and no file is written."""
    monkeypatch.setattr("splatwire.sequence.frame_writer.MAX_FILES", most)
    outcome = run("decode", clip, "-o", tmp_path / "out", *words)
    assert outcome.status == 2
    assert f"has {FRAMES} frames, and no more than {FRAMES - 1} files are written: --max-frames of" in outcome.err
    assert not (tmp_path / "out").exists()
    assert run("decode", clip, "-o", tmp_path / "one.ply", "--frame", 4, *words).status == 0
    assert run("decode", clip, "-o", tmp_path / "all", "--max-frames", FRAMES).status == 0
    assert len(list((tmp_path / "all").iterdir())) == FRAMES


def test_one_frame_is_written_to_one_file(run, clip, tmp_path):
    assert run("decode", clip, "-o", tmp_path / "one.ply", "--frame", 4).status == 0
    assert run("decode", clip, "-o", tmp_path / "some", "--frame", 4).status == 0
    (found,) = (tmp_path / "some").iterdir()
    assert (found.name[-5:], found.read_bytes()) == ("4.ply", (tmp_path / "one.ply").read_bytes())
    run("decode", clip, "-o", tmp_path / "all")
    assert (tmp_path / "one.ply").read_bytes() == (tmp_path / "all" / "frame_4.ply").read_bytes()


@pytest.mark.parametrize("number", [-1, FRAMES])
def test_a_frame_that_the_clip_does_not_have_is_refused_before_decoding(run, clip, tmp_path, number):
    done = run("decode", clip, "-o", tmp_path / "one.ply", "--frame", number)
    assert (done.status, "the clip has the frames 0 to 5" in done.err) == (2, True)
    assert "decoding" not in done.err


def test_empty_frames_have_files_and_keep_their_numbers(run, tmp_path):
    frames = tmp_path / "frames"
    frames.mkdir()
    for number, frame in enumerate(darkened(moving_frames(60, 3), [1])):
        write_splats([frame], frames / f"{number}.ply")
    assert run("encode", frames, "-o", tmp_path / "a.swz").status == 0
    for words, name in ((("--format", "spz"), "frame_1.spz"), ((), "frame_1.ply")):
        target = tmp_path / name.replace(".", "_")
        done = run("decode", tmp_path / "a.swz", "-o", target, *words)
        assert done.status == 0, done.err
        assert (
            f"splatwire: warning: {target / name}: the frame is empty: its file has a transparent Gaussian" in done.err
        )
        assert len(list(target.iterdir())) == 3
        assert [frame.drawn.sum() > 0 for frame in open_sequence(target).read()] == [True, False, True]
    assert run("decode", tmp_path / "a.swz", "-o", tmp_path / "b.ply", "--frame", 1).status == 0


def test_losses_are_concealed_and_scored(run, clip, folder, tmp_path):
    run("transmit", clip, "-o", tmp_path / "lossy.swz", "--loss", "bernoulli:0.5", "--seed", 3)
    lost = run("decode", tmp_path / "lossy.swz", "-o", tmp_path / "out", "--json").json["num_concealed"]
    assert lost
    words = ("--reference", folder, "--views", 1, "--conceal", "drop", "motion")
    content = run("evaluate", clip, *words, "--loss", "bernoulli:0.5", "--seeds", 3, "-o", tmp_path, "--json").json
    complete, drop, motion = content["rows"]
    assert complete["method"] == "complete"
    assert len(complete["frames"]) == FRAMES
    assert complete["psnr"] > motion["psnr"] > drop["psnr"]
    assert motion["below_complete"] == pytest.approx(complete["psnr"] - motion["psnr"])
    page = (tmp_path / "report.html").read_text()
    assert page.count("data:image/webp") >= 4 * FRAMES
    assert "complete" in run("evaluate", clip, "--reference", folder, "--views", 1).out


def test_render_writes_a_clip_as_an_animation(run, clip, tmp_path):
    from PIL import Image

    assert run("render", clip, "-o", tmp_path / "clip.webp", "--scale", 0.1).status == 0
    with Image.open(tmp_path / "clip.webp") as picture:
        assert picture.n_frames == FRAMES
        assert picture.size == (51, 51)
        picture.seek(1)
        picture.load()
        assert picture.info["duration"] == 80
    assert "name.webp" in run("render", clip, "-o", tmp_path / "folder").err


def test_pictures_of_a_very_long_clip_are_refused_before_drawing(run, clip, tmp_path, monkeypatch):
    """A stream of 30 kB can announce 131,072 frames, and their pictures would take 103 GB."""
    monkeypatch.setattr("splatwire.evaluation.sequence.moving_picture.MAX_PICTURE_BYTES", 10_000)
    outcome = run("render", clip, "-o", tmp_path / "clip.webp", "--scale", 0.1)
    assert outcome.status == 2
    assert "choose a smaller --scale" in outcome.err
    assert not (tmp_path / "clip.webp").exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("plan", "--feedback"), "--feedback is for a still scene"),
        (("decode", "-o", "x.ply", "--frame", 6), "the frames 0 to 5, not 6"),
        (("decode", "-o", "out", "--conceal", "cari"), "cari"),
        (("decode", "-o", "out", "--format", "obj"), "obj"),
        (("evaluate",), "--reference FOLDER"),
    ],
)
def test_verbs_that_do_not_support_clips_are_refused(run, clip, tmp_path, monkeypatch, words, message):
    monkeypatch.chdir(tmp_path)
    verb, *rest = words
    outcome = run(verb, clip, *rest)
    assert outcome.status == 2
    assert message in outcome.err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--group", 65), "1 to 64"),
        (("--fps", 0), "0.01 to 1000"),
        (("--tiers", 0.1), "--tiers is for a still scene"),
        (("--quality", "best"), "best"),
    ],
)
def test_encode_refuses_meaningless_options(run, folder, tmp_path, words, message):
    outcome = run("encode", folder, "-o", tmp_path / "a.swz", *words)
    assert outcome.status == 2
    assert message in outcome.err
    assert not (tmp_path / "a.swz").exists()


def test_a_damaged_or_different_frame_is_named(run, folder, tmp_path):
    for file in folder.glob("*.ply"):
        (tmp_path / file.name).write_bytes(file.read_bytes())
    whole = (tmp_path / "frame_7.ply").read_bytes()
    (tmp_path / "frame_7.ply").write_bytes(whole[: len(whole) // 2])
    outcome = run("encode", tmp_path, "-o", tmp_path / "a.swz")
    assert outcome.status == 2
    assert "frame_7.ply" in outcome.err
    (tmp_path / "frame_7.ply").unlink()
    outcome = run("evaluate", _encoded(run, folder, tmp_path), "--reference", tmp_path)
    assert outcome.status == 2
    assert "has 6 frames" in outcome.err
    assert "has 5" in outcome.err


def _encoded(run, folder, target):
    run("encode", folder, "-o", target / "a.swz")
    return target / "a.swz"


def test_still_scene_refuses_frame_options(run, folder, tmp_path):
    outcome = run("encode", folder / "frame_5.ply", "-o", tmp_path / "a.swz", "--fps", 30)
    assert outcome.status == 2
    assert "one file per frame" in outcome.err
    assert json.dumps("frame_5") not in outcome.out


def live(*arguments):
    """Process that encodes live frames, from file names or a folder."""
    command = [sys.executable, "-m", "splatwire", "live", *map(str, arguments), "--port", "0", "--json"]
    return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def received(port, target):
    """Process that receives the live stream."""
    command = [sys.executable, "-m", "splatwire", "receive", f"udp://127.0.0.1:{port}", "-o", str(target), "--json"]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


@pytest.mark.parametrize("how", ["pipe", "folder"])
def test_live_frames_are_received_as_files(folder, tmp_path, how):
    names = sorted(folder.glob("*.ply"), key=lambda path: int(path.stem[6:]))
    source, target = tmp_path / "in", tmp_path / "out"
    source.mkdir()
    with live("-" if how == "pipe" else source, "--group", 2, "--fps", 100) as server:

        def give(some):
            for path in some:
                if how == "pipe":
                    server.stdin.write(f"{path}\n")
                    server.stdin.flush()
                else:
                    shutil.copy(path, source / f"{path.name}.part")
                    (source / f"{path.name}.part").rename(source / path.name)

        port = json.loads(server.stdout.readline())["port"]
        with received(port, target) as client:
            give(names[:2])
            until(lambda: target.is_dir() and any(target.iterdir()))
            give(names[2:])
            until(lambda: (target / f"frame_{FRAMES - 1:06}.ply").exists())
            server.stdin.close() if how == "pipe" else server.send_signal(signal.SIGINT)
            content = json.loads(client.stdout.read())
        assert content["finished"] in ("complete", "sent")
        assert client.returncode == (3 if content["packets_missed"] else 0)  # on a busy machine motion is dropped
        assert f"{FRAMES} frames" in server.stderr.read()
    assert server.returncode == 0
    assert open_scene(target / f"frame_{FRAMES - 1:06}.ply").num_elements > 200


def until(fact):
    """Waits until a condition is met."""
    end = time.monotonic() + 600
    while not fact():
        assert time.monotonic() < end
        time.sleep(0.02)


def test_live_requires_a_folder_or_a_pipe(run, tmp_path):
    assert "is not a folder" in run("live", tmp_path / "none").err


def test_a_clip_is_planned_and_served_with_parity_for_each_group(run, clip, tmp_path):
    target = tmp_path / "plan.json"
    words = ("--loss", "bernoulli:0.2", "--budget", 1.5, "--views", 1, "--trials", 20, "-o", target)
    content = run("plan", clip, *words, "--json").json
    assert content["psnr"] >= content["unprotected"]
    serve = Serve((str(clip),), plan=target)
    protection, planned = _run_serve.protection(serve)
    assert [list(pair) for pair in protection.motion] == content["protection"]["motion"]
    (program,) = _run_serve._served_streams(serve, protection, planned).served.values()
    assert program.sizes()["packet_protection"] == content["parity_bytes"]
    printed = run("plan", clip, *words).out
    assert "group 1: parity" in printed
    assert f"splatwire serve {clip} --plan {target}" in printed
    assert "dB, if the finest stream has 45 dB\n" in printed


def test_encode_turns_a_splatv_file_into_a_clip(run, tmp_path):
    source, target = tmp_path / "a.splatv", tmp_path / "a.swz"
    source.write_bytes(splatv([((n / 9, 0, 0), *GAUSSIANS[n % 2][1:]) for n in range(40)]))
    content = run("encode", source, "-o", target, "--frames", 6, "--fps", 10, "--json").json
    assert (content["frames"], content["frame_rate"], content["frames_matched"]) == (6, 10, 0)
    scored = run("evaluate", target, "--reference", source, "--json").json
    assert scored["rows"][0]["psnr"] > 30
    assert "encode` makes a clip of it" in run("render", source, "-o", tmp_path / "pictures").err
    assert "--fps, --group and --frames are for clips" in run("encode", target, "-o", "b.swz", "--frames", 3).err


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("one.ply", "has no such suffix"),
        ("all.mp4", "has no such suffix"),
        ("all.splat4d", "has no such suffix"),
        ("all.usdz", "has no such suffix"),
        ("-", "standard output cannot be"),
    ],
)
def test_frames_are_not_written_to_a_folder_that_looks_like_a_file(run, clip, tmp_path, monkeypatch, name, words):
    monkeypatch.chdir(tmp_path)
    outcome = run("decode", clip, "-o", name)
    assert (outcome.status, words in outcome.err) == (2, True)
    assert not list(tmp_path.iterdir())
