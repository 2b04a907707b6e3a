"""Tokens of the command line, and private scenes of a running server."""

import json
import subprocess
import sys
import urllib.error
import urllib.request

import pytest

from explicit import ball_of_gaussians, encode_splats
from splatwire.bitstream import PRESETS, write_stream

pytest.importorskip("jwt", reason="PyJWT is not installed")
pytest.importorskip("aioquic", reason="aioquic is not installed")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Two streams and a key."""
    folder = tmp_path_factory.mktemp("access")
    stream = encode_splats(ball_of_gaussians(), PRESETS["datagram"])
    for name in ("room", "garden"):
        write_stream(stream, folder / f"{name}.swz")
    (folder / "key").write_text("ab" * 32)
    return folder


@pytest.mark.slow
def test_a_private_scene_is_served_with_a_token_over_http_and_quic(run, folder):
    token = run("token", "room", "--key", folder / "key", "--json").json["token"]
    words = ["serve", folder / "garden.swz", folder / "room.swz", "--port", 0, "--page", 0, "--private", "room"]
    words += ["--token-key", folder / "key", "--json"]
    command = [sys.executable, "-m", "splatwire", *map(str, words)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        try:
            ready = json.loads(server.stdout.readline())
            page = ready["page"]
            with urllib.request.urlopen(f"{page}private/room.swz?token={token}", timeout=600) as answer:
                assert answer.status == 200
                assert len(answer.read()) > 1000
            with pytest.raises(urllib.error.HTTPError, match="401"):
                urllib.request.urlopen(f"{page}private/room.swz", timeout=600)
            url = f"quic://127.0.0.1:{ready['port']}"
            trust = ("--fingerprint", ready["fingerprint"])
            assert run("receive", f"{url}/garden", "-o", folder / "seen.swz", *trust).status == 0
            assert run("receive", f"{url}/room?token={token}", "-o", folder / "room2.swz", *trust).status == 0
            assert (folder / "room2.swz").stat().st_size > 1000
            named = run("receive", f"{url}/room?token={token}", "-o", folder / "a.scene", "--conceal", "grow", *trust)
            assert (named.status, "is no name for" in named.err, token in named.err) == (2, True, False)
            assert run("receive", url, "-o", folder / "default.swz", *trust).status == 0
            assert (folder / "default.swz").read_bytes() == (folder / "seen.swz").read_bytes()
            other = run("token", "garden", "--key", folder / "key", "--json").json["token"]
            for address in ("room", f"room?token={other}", f"room?token={token}x", "missing"):
                done = run("receive", f"{url}/{address}", "-o", folder / "stolen.swz", *trust)
                assert done.status != 0
                assert "the scene needs a valid token" in done.err
                assert other not in done.err
                assert not (folder / "stolen.swz").exists()
        finally:
            server.terminate()


@pytest.mark.parametrize(
    ("url", "message"),
    [
        ("udp://host/room?token=secret", "tokens are for quic://"),
        ("moq://host/room?token=secret", "tokens are for quic://"),
        ("https://host/private/room.swz?token=secret", "curl downloads files"),
        ("quic://host/room?tokens=secret", "is not an address"),
        ("quic://host/room?token=" + "secret" * 200, "at most 1024 bytes"),
    ],
)
def test_receive_names_what_is_wrong_with_an_address_and_does_not_repeat_its_token(run, tmp_path, url, message):
    done = run("receive", url, "-o", tmp_path / "room.swz")
    assert done.status == 2
    assert message in done.err
    assert "secret" not in done.err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--private", "room", "--page", 0], "--private and --token-key belong together"),
        (["--token-key", "key", "--page", 0], "--token-key is for --private"),
        (["--private", "room", "--token-key", "key"], "--private is for --quic and --page"),
        (["--unlisted", "room"], "--unlisted is for --page"),
        (["--unlisted", "rom", "--page", 0], "no stream is called rom"),
        (["--private", "room", "--token-key", "none", "--page", 0], "none"),
    ],
)
def test_invalid_arguments_are_one_error_line(run, folder, monkeypatch, words, message):
    monkeypatch.chdir(folder)
    done = run("serve", "room.swz", *words)
    assert done.status == 2
    assert message in done.err
    assert len(done.err.splitlines()) == 1
