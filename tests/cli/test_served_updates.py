"""`serve --updates` sends the updates of a folder, and `receive --follow` and `view` take them."""

import asyncio
import json
import os
import subprocess
import sys
import threading
import time
from pathlib import Path
from types import SimpleNamespace
from urllib.error import HTTPError
from urllib.request import urlopen

import numpy as np
import pytest

from codec.gaussians.test_gaussians import DATAGRAM, SMALL, some_splats
from codec.update.test_chain import edits
from codec.update.test_updates import moved, recoloured
from explicit import encode_splats
from processes import server_process
from splatwire.bitstream import SceneStream, read_stream, stream_from_bytes, write_stream
from splatwire.bitstream.sections import sections_of
from splatwire.cli import _run_serve
from splatwire.cli._run_view import newest_updates
from splatwire.cli._served_updates import PATIENCE_S, UpdateFolder, chains_of
from splatwire.cli.serve import Serve
from splatwire.codec import apply_update, decode_stream, encode_update
from splatwire.codec.update.chain import MAX_UPDATES
from splatwire.codec.update.section import SECTION, manifest_digest, read_update, update_name
from splatwire.errors import InvalidValueError
from splatwire.transport import Protection, make_served_stream
from splatwire.transport.http.content import served_stream_file

pytest.importorskip("raptorq", reason="the package raptorq is not installed")


def folder_of(tmp_path: Path, source: SceneStream) -> UpdateFolder:
    return UpdateFolder(tmp_path / "updates", chains_of({"room": (source, source)}), make_served_stream)


def test_updates_are_applied_in_the_order_of_the_states_and_not_of_their_names(tmp_path: Path) -> None:
    base = encode_splats(some_splats(), DATAGRAM)
    updates, folder = edits(base), folder_of(tmp_path, base)
    assert folder.poll() == {}
    (tmp_path / "updates").mkdir()
    write_stream(updates[1], tmp_path / "updates" / "a.swz")
    assert folder.poll() == {}
    assert list(folder.updates.values()) == [None]
    write_stream(updates[0], tmp_path / "updates" / "b.swz")
    write_stream(updates[2], tmp_path / "updates" / "c.swz")
    (served,) = folder.poll().values()
    newest = base
    for update in updates:
        newest = apply_update(newest, update)
    assert stream_from_bytes(served_stream_file(served))[0].manifest == newest.manifest
    assert [each is None for each in folder.updates.values()] == [False, False, False, True]
    assert folder.poll() == {}


def test_cut_and_foreign_files_are_reported_once(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    base = encode_splats(some_splats(), DATAGRAM)
    folder, place = folder_of(tmp_path, base), tmp_path / "updates"
    place.mkdir()
    write_stream(edits(base)[0], place / "whole.swz")
    (place / "cut.swz").write_bytes((place / "whole.swz").read_bytes()[:-9])
    (place / "whole.swz").unlink()
    write_stream(base, place / "scene.swz")
    with caplog.at_level("ERROR"):
        for now in (0.0, 1.0, PATIENCE_S, 2 * PATIENCE_S, 3 * PATIENCE_S):
            assert folder.poll(now) == {}
    assert len(caplog.records) == 2
    assert "it is not an update" in caplog.text
    write_stream(edits(base)[0], place / "cut.swz")
    assert list(folder.poll(100.0)) == ["room"]


def test_an_unexpected_error_is_logged_once_and_later_updates_are_served(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(_run_serve, "UPDATE_POLL_S", 0)
    answers = iter([ZeroDivisionError("a fault"), ZeroDivisionError("a fault"), {"room": "changed"}])

    def poll() -> dict[str, str]:
        answer = next(answers)
        if isinstance(answer, Exception):
            raise answer
        return answer

    async def watch() -> dict[str, str]:
        published: asyncio.Future[dict[str, str]] = asyncio.get_running_loop().create_future()
        scenes = SimpleNamespace(served={"room": "before"}, folder=SimpleNamespace(poll=poll), updates={})
        opened = SimpleNamespace(publish=lambda served, updates: published.done() or published.set_result(served))
        watching = asyncio.ensure_future(_run_serve._watch_updates(scenes, opened))
        try:
            return await asyncio.wait_for(published, 60)
        finally:
            watching.cancel()

    assert asyncio.run(watch()) == {"room": "changed"}
    assert [(record.message, "a fault" in str(record.exc_info[1])) for record in caplog.records] == [
        ("updates failed", True)
    ]


def test_a_version_that_a_scene_reaches_twice_offers_its_newest_update(tmp_path: Path) -> None:
    """An edit that is undone leads back: followers would otherwise get the first edit again and again."""
    base = encode_splats(some_splats(), DATAGRAM)
    first, folder, place = decode_stream(base).scene.splats, folder_of(tmp_path, base), tmp_path / "updates"
    place.mkdir()
    states = [base]
    for number, splats in enumerate((moved(first), first, moved(first), first)):
        update = encode_update(states[-1], splats)
        states.append(apply_update(states[-1], update))
        write_stream(update, place / f"{number}.swz")
        assert list(folder.poll(float(number))) == ["room"]
    assert states[4].manifest == states[2].manifest
    assert folder.updates[update_name(manifest_digest(states[4].manifest))] is None
    write_stream(encode_update(states[4], recoloured(first)), place / "5.swz")
    folder.poll(9.0)
    served = folder.updates[update_name(manifest_digest(states[4].manifest))]
    assert stream_from_bytes(served_stream_file(served))[0] == read_stream(place / "5.swz")[0]


def test_updates_that_no_scene_can_take_are_reported_once(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    base = encode_splats(some_splats(), DATAGRAM)
    updates, folder, place = edits(base), folder_of(tmp_path, base), tmp_path / "updates"
    place.mkdir()
    for number, update in enumerate(updates[1:]):
        write_stream(update, place / f"{number}.swz")
    for now in (0.0, 1.0):
        assert folder.poll(now) == {}
    assert not caplog.records
    for now in (PATIENCE_S, 2 * PATIENCE_S):
        assert folder.poll(now) == {}
    (record,) = caplog.records
    assert "updates wait" in record.getMessage()
    write_stream(updates[0], place / "first.swz")
    assert list(folder.poll(100.0)) == ["room"]


def test_removed_files_are_forgotten(tmp_path: Path) -> None:
    base = encode_splats(some_splats(), DATAGRAM)
    updates, folder, place = edits(base), folder_of(tmp_path, base), tmp_path / "updates"
    place.mkdir()
    for number, update in enumerate(updates[1:]):
        write_stream(update, place / f"{number}.swz")
    (place / "cut.swz").write_bytes(b"cut")
    assert folder.poll(0.0) == {}
    assert list(folder._waiting.values()) == [read_update(sections_of(one)[SECTION]).base_digest for one in updates[1:]]
    for path in place.iterdir():
        path.unlink()
    assert folder.poll(1.0) == {}
    assert not folder._waiting
    assert not folder._seen
    assert not folder._read
    write_stream(updates[0], place / "first.swz")
    assert list(folder.poll(2.0)) == ["room"]
    assert folder.poll(3.0) == {}


def test_scenes_of_equal_content_change_together(tmp_path: Path) -> None:
    base = encode_splats(some_splats(), DATAGRAM)
    chains = chains_of({"one": (base, base), "other": (base, base)})
    folder, place, updates = UpdateFolder(tmp_path, chains, make_served_stream), tmp_path, edits(base)
    for number, update in enumerate(updates):
        write_stream(update, place / f"{number}.swz")
    served = folder.poll()
    assert list(served) == ["one", "other"]
    newest = [stream_from_bytes(served_stream_file(each))[0].manifest for each in served.values()]
    assert newest[0] == newest[1]
    assert [each is None for each in folder.updates.values()] == [False, False, False, True]


def test_a_scene_that_reaches_a_former_version_of_another_one_is_refused(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """A request for the next update names only the version, not the scene."""
    first = encode_splats(some_splats(), DATAGRAM)
    forth, after, _ = edits(first)
    back = encode_update(apply_update(first, forth), decode_stream(first).scene.splats)
    middle = apply_update(first, forth)
    returned = apply_update(middle, back)  # the same Gaussians in another order are another version
    third = encode_update(returned, recoloured(decode_stream(returned).scene.splats))
    folder = UpdateFolder(tmp_path, chains_of({"a": (returned, returned), "b": (middle, middle)}), make_served_stream)
    write_stream(third, tmp_path / "1.swz")
    assert list(folder.poll(0.0)) == ["a"]
    write_stream(back, tmp_path / "2.swz")
    assert folder.poll(1.0) == {}
    assert "b would have the content that 'a' had before" in caplog.text
    write_stream(after, tmp_path / "3.swz")
    assert list(folder.poll(2.0)) == ["b"]


def test_a_server_applies_the_updates_before_it_serves(tmp_path: Path) -> None:
    """After SIGHUP, the scene would otherwise be the first version until the folder is read."""
    base = encode_splats(some_splats(), SMALL)
    write_stream(base, tmp_path / "room.swz")
    (tmp_path / "updates").mkdir()
    newest = base
    for number, update in enumerate(edits(base)):
        write_stream(update, tmp_path / "updates" / f"{number}.swz")
        newest = apply_update(newest, update)
    command = Serve(streams=(str(tmp_path / "room.swz"),), updates=tmp_path / "updates")
    scenes = _run_serve._served_streams(command, Protection())
    (stream,) = scenes.served.values()
    assert stream_from_bytes(served_stream_file(stream))[0].manifest.num_elements == newest.manifest.num_elements == 460
    assert [each is None for each in scenes.updates.values()] == [False, False, False, True]


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no named pipes")
def test_pipes_in_the_folder_do_not_stop_the_server(tmp_path: Path) -> None:
    base = encode_splats(some_splats(), DATAGRAM)
    folder, place = folder_of(tmp_path, base), tmp_path / "updates"
    place.mkdir()
    os.mkfifo(place / "0.swz")
    write_stream(edits(base)[0], place / "1.swz")
    polling = threading.Thread(target=folder.poll, daemon=True)
    polling.start()
    polling.join(120)
    assert not polling.is_alive()


def test_view_keeps_the_newest_updates_of_a_server_that_sends_them_without_end() -> None:
    updates: dict[str, bytes] = {}
    for number in range(MAX_UPDATES + 9):
        updates = newest_updates(updates, f"{number}", b"update")
    assert list(updates) == [f"{number}" for number in range(9, MAX_UPDATES + 9)]
    assert list(newest_updates({"a": b"1", "b": b"2"}, "a", b"3").items()) == [("b", b"2"), ("a", b"3")]


def test_view_bounds_the_bytes_of_updates(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("splatwire.cli._run_view.MAX_BYTES", 10)
    assert list(newest_updates({"a": bytes(5), "b": bytes(5)}, "c", bytes(5))) == ["b", "c"]
    assert list(newest_updates({"a": bytes(5)}, "c", bytes(11))) == ["c"]


def test_scenes_without_updates_are_refused() -> None:
    tiered = encode_splats(some_splats(), SMALL, tiers=np.arange(500) % 2)
    plain = encode_splats(some_splats(), SMALL)
    with pytest.raises(InvalidValueError, match="importance tiers"):
        chains_of({"tiered": (tiered, tiered)})
    assert list(chains_of({"tiered": (tiered, tiered), "plain": (plain, plain)})) == ["plain"]


@pytest.mark.parametrize("option", [("--moq", "https://localhost/x"), ("--quic", "--private", "room")])
def test_updates_are_for_public_scenes(tmp_path: Path, run, option) -> None:
    outcome = run("serve", "--updates", str(tmp_path), *option)
    assert (outcome.status, "--updates is for public scenes" in outcome.err) == (2, True)


@pytest.mark.slow
@pytest.mark.parametrize("quic", [False, True])
def test_a_server_swaps_updates_in_for_receivers_and_pages(tmp_path: Path, quic: bool) -> None:
    base = encode_splats(some_splats(), SMALL)  # its packets do not fit datagrams: the server encodes its own updates
    updates = edits(base)
    write_stream(base, tmp_path / "room.swz")
    (tmp_path / "updates").mkdir()
    words = ["--quic", "--page", "0"] if quic else []
    serve = ["serve", str(tmp_path / "room.swz"), "--updates", str(tmp_path / "updates"), "--port", "0", "--json"]
    with server_process([sys.executable, "-m", "splatwire", *serve, *words]) as facts:
        url = f"{'quic' if quic else 'udp'}://127.0.0.1:{facts['port']}/room"
        trust = ["--insecure"] if quic else []
        follow = ["receive", url, "--follow", "-o", str(tmp_path / "got.swz"), "--json", *trust]
        receiver = subprocess.Popen(
            [sys.executable, "-m", "splatwire", *follow], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        try:
            lines = [json.loads(receiver.stdout.readline())]
            for number, update in enumerate(updates):
                write_stream(update, tmp_path / "updates" / f"{number}.swz")
                lines.append(json.loads(receiver.stdout.readline()))
            receiver.terminate()
            assert receiver.wait(120) == 0
            assert receiver.stderr.read() == ""
        finally:
            receiver.kill()
            receiver.communicate()
        assert [line["num_elements"] for line in lines] == [500, 500, 500, 460]
        newest = read_stream(tmp_path / "got.swz")[0]
        if quic:
            page = urlopen(facts["page"]).read().decode()
            assert ' updates=""' in page
            assert "update." not in page.replace("updates", "")
            whole = stream_from_bytes(urlopen(f"{facts['page']}streams/room.swz").read())[0]
            assert whole.manifest == newest.manifest
            with pytest.raises(HTTPError, match="404"):
                urlopen(f"{facts['page']}streams/{update_name(manifest_digest(newest.manifest))}.swz")


@pytest.mark.slow
def test_view_offers_the_updates_that_it_receives(tmp_path: Path) -> None:
    base = encode_splats(some_splats(), DATAGRAM)
    update = edits(base)[0]
    write_stream(base, tmp_path / "room.swz")
    (tmp_path / "updates").mkdir()
    serve = ["serve", str(tmp_path / "room.swz"), "--updates", str(tmp_path / "updates"), "--port", "0", "--json"]
    view = ["--port", "0", "--no-open", "--json"]
    with (
        server_process([sys.executable, "-m", "splatwire", *serve]) as facts,
        server_process([sys.executable, "-m", "splatwire", "view", f"udp://127.0.0.1:{facts['port']}", *view]) as page,
    ):
        assert ' updates=""' in urlopen(page["url"]).read().decode()
        write_stream(update, tmp_path / "updates" / "1.swz")
        file = f"{page['url']}streams/{update_name(manifest_digest(base.manifest))}.swz"
        end = time.monotonic() + 600
        while time.monotonic() < end:
            try:
                found = stream_from_bytes(urlopen(file).read())[0]
                break
            except HTTPError:
                time.sleep(0.1)
        assert found == update
