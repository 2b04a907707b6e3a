"""The verb `train --model gaussians` on photos in the nerfstudio layout."""

import asyncio
import contextlib
import json
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from urllib.request import urlopen

import numpy as np
import pytest

from explicit import ball_of_gaussians
from splatwire.api.following import follow
from splatwire.api.network import receive
from splatwire.api.training import serve_training
from splatwire.bitstream import stream_from_bytes
from splatwire.cli._served_training import ServedTraining, served_training
from splatwire.cli.main import main
from splatwire.cli.train import Train
from splatwire.codec import decode_stream, encode_scene, encode_update
from splatwire.codec.update.apply import describe_update
from splatwire.io import open_scene
from splatwire.neural.training.gaussians import load_gaussian_checkpoint
from splatwire.rate_control.partial_updates import PartialUpdates
from splatwire.transport import Receiver, ReceiverOptions
from splatwire.transport.address import Address
from splatwire.transport.udp import receive_udp
from splatwire.types import SplatScene


def _words(folder: Path, output: Path, *more: object) -> list[str]:
    words = ["train", folder, "-o", output, "--model", "gaussians", "--iterations", 20, "--gaussians", 200, *more]
    return [str(word) for word in words]


def _run(words: list[str]) -> int:
    with pytest.raises(SystemExit) as stopped:
        main(words)
    return int(stopped.value.code or 0)


@pytest.mark.slow
def test_file_and_stream_hold_the_same_gaussians(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ply, swz, preview = tmp_path / "a.ply", tmp_path / "a.swz", tmp_path / "a.png"
    assert _run(_words(folder, ply, "--json", "--preview", preview)) == 0
    captured = capsys.readouterr()
    result = json.loads(captured.out)
    assert "the first Gaussians get random positions" in captured.err
    assert (result["iterations"], result["degree"], result["recipe"]["gaussians"]) == (20, 3, 200)
    assert result["test_psnr"] > 5
    assert preview.stat().st_size > 0
    assert load_gaussian_checkpoint(tmp_path / "a.ply.checkpoint")[0].num_gaussians == 200
    assert _run(_words(folder, swz, "--json")) == 0
    assert json.loads(capsys.readouterr().out)["stream_bytes"] == swz.stat().st_size
    scene, decoded = open_scene(ply), open_scene(swz)
    assert isinstance(scene, SplatScene)
    assert isinstance(decoded, SplatScene)
    assert scene.num_gaussians == result["num_gaussians"]
    again = decode_stream(encode_scene(scene)).scene
    for name, value in vars(decoded.splats).items():
        np.testing.assert_array_equal(getattr(again.splats, name), value)


@pytest.mark.slow
def test_a_finished_run_resumes_and_keeps_its_recipe(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ply = tmp_path / "a.ply"
    assert _run(_words(folder, ply)) == 0
    first = ply.read_bytes()
    ply.unlink()
    assert _run(_words(folder, ply, "--resume")) == 0
    assert ply.read_bytes() == first
    width = load_gaussian_checkpoint(tmp_path / "a.ply.checkpoint")[0].photo_size[0]
    capsys.readouterr()
    assert _run(_words(folder, ply, "--resume", "--max-width", width // 2)) == 2
    assert f"the checkpoint was made with photos of {width} x " in capsys.readouterr().err
    assert _run(_words(folder, ply, "--resume", "--seed", 3, "--loss", "bernoulli:0.2")) == 2
    assert "--loss, --seed: the checkpoint was made with another value" in capsys.readouterr().err
    words = ["train", str(folder), "-o", str(ply.with_suffix(".scene")), "--resume"]
    ply.with_name("a.scene.checkpoint").write_bytes(ply.with_name("a.ply.checkpoint").read_bytes())
    assert _run(words) == 2
    assert "splatwire-checkpoint" in capsys.readouterr().err


@pytest.mark.slow
def test_training_starts_from_the_gaussians_of_a_file(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert _run(_words(folder, tmp_path / "a.ply", "--json")) == 0
    assert _run(_words(folder, tmp_path / "b.ply", "--json", "--init", tmp_path / "a.ply")) == 0
    captured = capsys.readouterr()
    assert captured.err.count("random positions") == 1


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (("--lmbda", "0.1"), "--lmbda is for anchors"),
        (("--size", "1MB"), "--size is for anchors"),
        (("--loss-share", "0.3"), "--loss-share is for anchors"),
        (("--gaussians", "0"), "1 to 4,000,000 Gaussians, not 0"),
        (("--degree", "5"), "degree 0 to 3, not 5"),
        (("--quality", "fine"), "near-lossless"),
        (("--iterations", "3"), "20 iterations or more, not 3"),
        (("--loss", "bernoulli:0.1", "bernoulli:0.2"), "one --loss"),
        (("--loss", "first:0.2"), "first:0.2"),
        (("--preset", "mip"), "mipnerf360"),
        (("--resume",), "no such file"),
        (("--serve", "70000"), "a port is a number"),
        (("--page", "0"), "--page and --host are for --serve"),
        (("--host", "0.0.0.0"), "--page and --host are for --serve"),
    ],
)
def test_invalid_options_are_one_error_line(
    more: tuple[str, ...], message: str, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    kept = sorted(tmp_path.iterdir())
    assert _run(_words(folder, tmp_path / "a.ply", *more)) == 2
    assert message in capsys.readouterr().err
    assert sorted(tmp_path.iterdir()) == kept


def test_a_name_of_another_kind_of_file_is_refused(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert _run(_words(folder, tmp_path / "a.scene")) == 2
    assert "unknown format of explicit Gaussians" in capsys.readouterr().err


@pytest.mark.parametrize("option", ["--gaussians", "--degree", "--quality", "--serve"])
def test_options_of_gaussians_are_refused_for_anchors(
    option: str, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert _run(["train", str(folder), "-o", str(tmp_path / "a.scene"), option, "1"]) == 2
    assert f"{option} is for --model gaussians" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize("page", [False, True])
def test_a_follower_of_a_training_ends_with_the_last_state(folder: Path, tmp_path: Path, page: bool) -> None:
    pytest.importorskip("raptorq", reason="the package raptorq is not installed")
    if page:
        pytest.importorskip("aioquic", reason="the package aioquic is not installed")
    ply, states = tmp_path / "a.ply", []
    words = [sys.executable, "-m", "splatwire", *_words(folder, ply, "--serve", 0, *(("--page", 0) if page else ()))]
    process = subprocess.Popen(words, stderr=subprocess.PIPE, text=True)

    async def receive(port: int) -> None:
        async def fetch(name: str) -> Receiver:
            return await receive_udp(Address("127.0.0.1", port), ReceiverOptions(name=name))

        async for state in follow(fetch, "scene", lambda warning: None):
            states.append(state)

    async def receive_until_the_end(port: int) -> None:
        receiving = asyncio.ensure_future(receive(port))
        await asyncio.to_thread(process.communicate, timeout=300)
        receiving.cancel()

    try:
        line = next(line for line in process.stderr if line.startswith("watch it: "))
        if page:
            url = line.split()[-1]
            with urlopen(url) as answer:
                assert ' updates=""' in answer.read().decode()
            while process.poll() is None:
                with contextlib.suppress(OSError), urlopen(f"{url}streams/scene.swz") as answer:
                    states.append(stream_from_bytes(answer.read())[0])
                time.sleep(0.05)
        else:
            asyncio.run(receive_until_the_end(int(line.split(":")[-1].split("/")[0])))
        assert process.wait(240) == 0
    finally:
        process.kill()
        process.communicate()
    trained = open_scene(ply)
    assert isinstance(trained, SplatScene)
    last = describe_update(states[-1], encode_update(states[-1], trained))
    assert last == {"num_kept": trained.num_gaussians, "num_removed": 0, "num_new": 0}


@pytest.mark.slow
def test_a_state_that_cannot_be_served_does_not_end_the_training(capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("raptorq", reason="the package raptorq is not installed")
    scene = SplatScene(ball_of_gaussians())
    broken = replace(scene, splats=replace(scene.splats, opacities=np.zeros_like(scene.splats.opacities)))
    with serve_training() as server:
        served = ServedTraining(server)
        served.iterated(lambda: broken)
        served.iterated(lambda: pytest.fail("the interval has not passed"))
        served.finish(scene)
        assert asyncio.run(receive(f"udp://127.0.0.1:{server.port}")).manifest.num_elements == 200
    assert capsys.readouterr().err.count("the scene is not served") == 1


def test_an_unexpected_error_of_the_encoder_does_not_end_the_training(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("raptorq", reason="the package raptorq is not installed")

    def exhausted(*_: object) -> None:
        raise MemoryError("no memory for the blocks")

    monkeypatch.setattr(PartialUpdates, "start", exhausted)
    scene = SplatScene(ball_of_gaussians())
    with serve_training() as server:
        served = ServedTraining(server)
        served.iterated(lambda: scene)
        served.finish(scene)
    assert capsys.readouterr().err.count("not served: MemoryError('no memory for the blocks')") == 1


def test_served_scene_has_the_origin_and_background_of_the_training(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("raptorq", reason="the package raptorq is not installed")
    monkeypatch.setattr("splatwire.api.training.REQUEST_S", 0.0)
    origin, background = (442_000.0, 5_443_000.0, 120.0), (1.0, 1.0, 1.0)
    with served_training(Train("photos", "scene.ply", serve=0), origin, background) as served:
        url = capsys.readouterr().err.split()[-1]
        served.finish(SplatScene(ball_of_gaussians(), background=background, origin=origin))
        received = decode_stream(asyncio.run(receive(url))).scene
    assert (received.origin, received.background) == (origin, background)
