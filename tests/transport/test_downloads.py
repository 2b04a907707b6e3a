"""Files of other formats that the page server makes at their first request."""

import asyncio
import json
import re
import shutil
import threading
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import pytest

from explicit import ball_of_gaussians, encode_splats
from splatwire.bitstream import Packetization
from splatwire.cli._downloads import MadeDownloads, check_formats
from splatwire.errors import InvalidValueError, SplatwireError
from splatwire.io.formats import read_splats
from splatwire.transport import Protection, make_served_stream
from splatwire.transport.access import Access
from splatwire.transport.http import content as content_module
from splatwire.transport.http.content import PageContent, served_stream_file
from splatwire.transport.http.downloads import DownloadedFile
from splatwire.transport.http.server import PageServer

SPZ = bytes(range(256)) * 40


class Counted:
    """Files that take a moment to make; counts how often."""

    formats = ("spz", "ply")

    def __init__(self, error=None):
        self.made, self._error = 0, error

    async def file(self, stream, tag, form, part=""):
        self.made += 1
        await asyncio.sleep(0)
        if self._error:
            raise self._error
        return DownloadedFile(SPZ, "tag-of-content")


@pytest.fixture(scope="module")
def program():
    stream = encode_splats(ball_of_gaussians(), Packetization(block_size=100, lanes=2))
    return make_served_stream(stream, Protection())


async def ask(port, path, method="GET", headers=""):
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(f"{method} {path} HTTP/1.1\r\nHost: 127.0.0.1\r\n{headers}\r\n".encode())
    head, _, body = (await asyncio.wait_for(reader.read(), 60)).partition(b"\r\n\r\n")
    writer.close()
    return head.decode(), body


def served(content, *requests):
    async def work():
        async with PageServer(content) as server:
            return [await ask(server.port, *request) for request in requests]

    return asyncio.run(work())


def test_a_file_has_ranges_a_tag_and_a_name(program):
    content = PageContent({"a room": program}, downloads=Counted())
    whole, part, head, same, wrong = served(
        content,
        ("/a%20room.spz",),
        ("/a%20room.spz", "GET", "Range: bytes=10-19\r\n"),
        ("/a%20room.spz", "HEAD"),
        ("/a%20room.spz", "GET", 'If-None-Match: "tag-of-content"\r\n'),
        ("/a%20room.spz", "POST"),
    )
    assert "200 OK" in whole[0]
    assert whole[1] == SPZ
    assert "filename*=UTF-8''a%20room.spz" in whole[0]
    assert 'ETag: "tag-of-content"' in whole[0]
    assert "206 Partial" in part[0]
    assert part[1] == SPZ[10:20]
    assert f"Content-Length: {len(SPZ)}" in head[0]
    assert head[1] == b""
    assert "304 Not Modified" in same[0]
    assert "405" in wrong[0]


def test_only_offered_formats_of_known_streams_are_made(program):
    downloads = Counted()
    content = PageContent({"room": program}, downloads=downloads)
    for path in ("/room.sog", "/other.spz", "/room", "/.spz", "/room%2fspz"):
        assert "404" in served(content, (path,))[0][0], path
    assert downloads.made == 0
    assert "404" in served(PageContent({"room": program}), ("/room.spz",))[0][0]


def test_side_information_is_read_once_for_all_pages(program, monkeypatch):
    """A flood of requests for the page of many scenes would take the processor time of transfers."""
    read, real = [], content_module._manifest_and_side_info
    monkeypatch.setattr(
        content_module, "_manifest_and_side_info", lambda stream: (read.append(stream), real(stream))[1]
    )
    shown = replace(program, preview=b"preview")
    streams = {"a": shown, "b": shown}
    content = PageContent(streams, downloads=Counted())
    head = b"GET /?stream=a HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n"
    page = bytes(content.respond_now(head).body)
    assert b'preview="cHJldmlldw=="' in page
    assert read
    read.clear()
    assert {bytes(content.respond_now(head).body) for _ in range(3)} == {page}
    assert not read
    streams["a"] = replace(program, preview=b"another")
    assert b'preview="YW5vdGhlcg=="' in bytes(content.respond_now(head).body)
    assert len(read) == 1


def test_the_page_links_to_the_files(program):
    ((_, body),) = served(PageContent({"a room": program}, downloads=Counted()), ("/",))
    assert re.findall(rb'href="(a%20room[^"]*)" download', body) == [b"a%20room.spz", b"a%20room.ply"]
    ((_, body),) = served(PageContent({"a room": program}), ("/",))
    assert b"download" not in body


def test_a_failure_is_an_error_of_the_server(program):
    content = PageContent({"room": program}, downloads=Counted(SplatwireError("no")))
    assert "500 Internal Server Error" in served(content, ("/room.spz",))[0][0]


@pytest.mark.slow
def test_a_file_is_made_once_by_a_process_of_its_own(program, tmp_path):
    async def work():
        downloads = MadeDownloads(tmp_path, ("ply", "spz"), most_bytes=1)
        content = PageContent({"room": program}, downloads=downloads)
        async with PageServer(content) as server:
            first, second = await asyncio.gather(*(ask(server.port, "/room.ply") for _ in range(2)))
            assert first[1] == second[1]
            assert [path.name for path in tmp_path.iterdir()] != []
            await ask(server.port, "/room.spz")  # over the limit: the older file is removed
            assert [path.suffix for path in tmp_path.iterdir()] == [".spz"]
        await downloads.close()
        return first[1]

    (tmp_path / "a.ply").write_bytes(asyncio.run(work()))
    assert read_splats(tmp_path / "a.ply").num_gaussians == ball_of_gaussians().num_gaussians


@pytest.mark.slow
def test_a_folder_of_levels_is_made_once_and_its_files_are_served(program, tmp_path):
    """3D Tiles and streamed SOG: index, the files that it names, and nothing else."""

    async def work():
        downloads = MadeDownloads(tmp_path, ("3dtiles", "streamed-sog", "spz"))
        content = PageContent({"a room": program}, downloads=downloads)
        async with PageServer(content) as server:
            head, tileset = await ask(server.port, "/a%20room/3dtiles/tileset.json")
            assert "application/json" in head
            assert "Content-Disposition" not in head
            uri = json.loads(tileset)["root"]["content"]["uri"]
            head, tile = await ask(server.port, f"/a%20room/3dtiles/{uri}")
            assert "model/gltf-binary" in head
            assert tile.startswith(b"glTF")
            bare_head, bare = await ask(server.port, "/tileset.json")
            assert json.loads(bare)["root"]["content"]["uri"] == f"a%20room/3dtiles/{uri}"
            assert re.sub(rb'"a%20room/3dtiles/', b'"', bare) == tileset
            assert re.search("ETag: (.*)\r", bare_head)[1] != re.search("ETag: (.*)\r", head)[1]
            etag = re.search("ETag: (.*)\r", head)[1]
            head, _ = await ask(server.port, f"/a%20room/3dtiles/{uri}", headers=f"If-None-Match: {etag}\r\n")
            assert "304" in head
            _, index = await ask(server.port, "/a%20room/streamed-sog/lod-meta.json")
            [finest, *_] = json.loads(index)["filenames"]
            head, meta = await ask(server.port, f"/a%20room/streamed-sog/{finest}")
            assert json.loads(meta)["count"] == ball_of_gaussians().num_gaussians
            for path in ("3dtiles/../x", "3dtiles/tiles", "3dtiles/", "spz/x", "glb/tileset.json"):
                assert "404" in (await ask(server.port, f"/a%20room/{path}"))[0], path
            _, page = await ask(server.port, "/")
            assert b'href="a%20room/3dtiles/tileset.json"' in page
        downloads._most_bytes = 0
        await downloads.file(*next((served_stream_file(program), tag) for tag, _ in downloads._files), "spz")
        await downloads.close()

    asyncio.run(work())
    assert [path.suffix for path in tmp_path.iterdir()] == [".spz"]


def test_the_bare_tileset_is_that_of_the_only_listed_scene(program):
    class Folders(Counted):
        formats = ("3dtiles",)

    def parsed(names, access=None):
        content = PageContent(dict.fromkeys(names, program), downloads=Folders(), access=access)
        return content._parse_download("/tileset.json")

    assert parsed(["room"]) == ("room", "3dtiles", "tileset.json")
    assert parsed(["room", "garden"]) is None
    assert parsed(["room", "garden"], Access(unlisted=frozenset({"garden"}))) == ("room", "3dtiles", "tileset.json")
    assert parsed(["room"], Access(frozenset({"room"}), frozenset(), lambda token, name: None)) is None


def test_folders_of_private_scenes_are_not_offered(program):
    class Folders(Counted):
        formats = ("spz", "3dtiles")

    access = Access(frozenset({"room"}), frozenset(), lambda token, name: None)
    content = PageContent({"room": program}, downloads=Folders(), access=access)
    assert content._download_formats("room") == ("spz",)


@pytest.mark.slow
def test_a_stream_that_cannot_be_converted_fails_once_and_close_ends_the_process(tmp_path):
    async def work():
        downloads = MadeDownloads(tmp_path, ("ply",))
        for _ in range(2):
            with pytest.raises(SplatwireError, match="splatwire: error"):
                await downloads.file(b"no stream", "tag", "ply")
        waiting = asyncio.ensure_future(downloads.file(b"no stream", "other", "ply"))
        await asyncio.sleep(0.05)
        await downloads.close()
        with suppress(asyncio.CancelledError):
            await waiting

    asyncio.run(asyncio.wait_for(work(), 120))
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_is_an_error_of_the_request_and_the_next_one_tries_again(program, tmp_path, monkeypatch):
    downloads, written = MadeDownloads(tmp_path, ("ply",)), []

    def full(path, data):
        written.append(path)
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("pathlib.Path.write_bytes", full)
    answers = served(PageContent({"room": program}, downloads=downloads), ("/room.ply",), ("/room.ply",))
    assert ["500 Internal Server Error" in head for head, _ in answers] == [True, True]
    assert len(written) == 2
    assert not list(tmp_path.iterdir())


def test_a_conversion_that_takes_too_long_ends_and_leaves_no_file(program, tmp_path):
    async def work():
        downloads = MadeDownloads(tmp_path, ("ply",), most_seconds=0.05)
        for _ in range(2):
            with pytest.raises(SplatwireError, match=r"took longer than 0\.05 seconds"):
                await downloads.file(b"no stream", "tag", "ply")
        await downloads.close()

    asyncio.run(asyncio.wait_for(work(), 120))
    assert not list(tmp_path.iterdir())


def test_a_failed_conversion_is_tried_again_after_some_time(tmp_path, monkeypatch):
    """The cause may have passed, such as a busy machine."""
    tried = []

    async def slow(self, *words):
        tried.append(words)
        raise SplatwireError("the conversion took longer than 600 seconds")

    async def fails(downloads):
        with pytest.raises(SplatwireError, match="took longer"):
            await downloads.file(b"", "tag", "ply")

    async def work():
        patient, quick = MadeDownloads(tmp_path, ("ply",)), MadeDownloads(tmp_path, ("ply",), retry_s=0.0)
        await fails(patient)
        await fails(patient)
        assert len(tried) == 1
        await fails(quick)
        await asyncio.sleep(0.05)
        await fails(quick)
        assert len(tried) == 3

    monkeypatch.setattr(MadeDownloads, "_run", slow)
    asyncio.run(work())
    assert not list(tmp_path.iterdir())


def test_removing_old_folders_does_not_block_other_responses(tmp_path, monkeypatch):
    """Thousands of files are removed in another thread; meanwhile the folder may be made again."""
    threads, made = [], []

    async def convert(self, verb, source, target, *words):
        made.append(target)
        Path(target).mkdir()
        (Path(target) / "tileset.json").write_bytes(bytes(100))

    def removing(place, **options):
        threads.append(threading.current_thread() is threading.main_thread())
        rmtree(place, **options)

    async def work():
        downloads = MadeDownloads(tmp_path, ("3dtiles",), most_bytes=150)
        for tag in ("a", "b", "a", "b"):
            assert (await downloads.file(b"", tag, "3dtiles", "tileset.json")).data == bytes(100)

    rmtree = shutil.rmtree
    monkeypatch.setattr(MadeDownloads, "_run", convert)
    monkeypatch.setattr(shutil, "rmtree", removing)
    asyncio.run(work())
    assert [path.name for path in tmp_path.iterdir()] == ["b.3dtiles"]
    assert len(made) == 4
    assert not any(threads)


def test_formats_are_named_once():
    check_formats(("ply", "spz"))
    with pytest.raises(InvalidValueError, match="spz twice"):
        check_formats(("spz", "ply", "spz"))
