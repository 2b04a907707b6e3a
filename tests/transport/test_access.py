"""Scenes of the page server that need a signed token, and scenes that no list contains."""

import asyncio
import base64
import dataclasses
import itertools
import json
import random
import re
import time
from functools import partial

import pytest

pytest.importorskip("jwt", reason="PyJWT is not installed")
import jwt

from explicit import ball_of_gaussians, encode_splats
from splatwire.bitstream import Packetization
from splatwire.errors import BitstreamError, InvalidValueError
from splatwire.transport import Protection, ReceiverOptions, Server, make_served_stream
from splatwire.transport.access import Access
from splatwire.transport.http.content import PageContent, WebTransportEndpoint
from splatwire.transport.http.downloads import DownloadedFile
from splatwire.transport.http.tokens import make_token, read_key, token_problem
from splatwire.transport.protocol.messages import NEEDS_TOKEN, REFUSALS, Request, Welcome
from splatwire.transport.protocol.wire import decode, encode

KEY = b"0123456789abcdef0123456789abcdef"
OTHER = b"fedcba9876543210fedcba9876543210"


class Files:
    formats = ("spz",)

    async def file(self, stream, tag, form, part=""):
        return DownloadedFile(b"spz", "tag")


@pytest.fixture(scope="module")
def content():
    stream = encode_splats(ball_of_gaussians(), Packetization(block_size=100, lanes=2))
    program = make_served_stream(stream, Protection())
    programs = dict.fromkeys(("secret", "hidden", "open"), program)
    access = Access(frozenset({"secret"}), frozenset({"hidden"}), partial(token_problem, KEY))
    return PageContent(programs, WebTransportEndpoint(4840, "/splatwire", None), access=access, downloads=Files())


def asked(content, path, headers=""):
    head = f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1\r\n{headers}\r\n".encode()
    answer = asyncio.run(content.respond(head))
    return int(answer.head[9:12]), bytes(answer.body).decode(errors="replace")


def unsigned(claims):
    parts = (json.dumps(part).encode() for part in ({"alg": "none", "typ": "JWT"}, claims))
    return ".".join(base64.urlsafe_b64encode(part).decode().rstrip("=") for part in parts) + "."


PLACES = ("/?stream=secret", "/private/secret.swz", "/secret.spz")
"""All addresses of a private scene."""


def with_token(path, token):
    return f"{path}{'&' if '?' in path else '?'}token={token}"


@pytest.mark.parametrize("path", PLACES)
def test_a_private_scene_needs_a_valid_token(content, path):
    now = time.time()
    good = make_token(KEY, ["other", "secret"], 60.0)
    assert asked(content, with_token(path, good))[0] == 200
    assert asked(content, path, f"Authorization: Bearer {good}\r\n")[0] == 200
    claims = {"aud": "splatwire", "exp": int(now + 60), "scenes": ["secret"]}
    bad = {
        "": "needs a token",
        make_token(KEY, ["secret"], 60.0, now - 120): "expired",
        make_token(OTHER, ["secret"], 60.0): "not valid",
        make_token(KEY, ["open"], 60.0): "for other scenes",
        unsigned(claims): "not valid",
        jwt.encode(claims | {"aud": "another"}, KEY, "HS256"): "not valid",
        jwt.encode({"aud": "splatwire", "scenes": ["secret"]}, KEY, "HS256"): "not valid",
        jwt.encode(claims | {"scenes": "secret"}, KEY, "HS256"): "for other scenes",
        jwt.encode(claims, KEY + KEY, "HS512"): "not valid",
    }
    for token, reason in bad.items():
        status, body = asked(content, with_token(path, token) if token else path)
        assert (status, reason in body) == (401, True), (token, body)


def test_private_scenes_have_no_other_address(content):
    good = make_token(KEY, ["secret"], 60.0)
    for path in (
        "/streams/secret.swz", "/streams/secre%74.swz", "/%73treams/secret%2Eswz", "/private/open.swz",
        "/%70rivate/open%2eswz", "/private%2Fsecret.swz", "/private/secret", "/private//secret.swz",
        "/streams/..%2Fprivate%2Fsecret.swz",
    ):  # fmt: skip
        assert asked(content, with_token(path, good))[0] == 404, path
        assert asked(content, path)[0] in (401, 404), path
    for encoded in ("/private/secre%74.swz", "/%70rivate/secret.swz", "/private/secret%2Eswz"):  # the same address
        assert [asked(content, path)[0] for path in (encoded, with_token(encoded, good))] == [401, 200]
        head = f"GET {with_token(encoded, good)} HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n".encode()
        assert b"Cache-Control: private" in content.respond_now(head).head
    assert asked(content, "/?stream=secre%74")[0] == 401


def test_responses_do_not_reveal_names_of_private_scenes(content):
    tokens = ("", make_token(KEY, ["open"], 60.0), make_token(OTHER, ["secret"], 60.0))
    for method in ("GET", "HEAD", "OPTIONS", "POST"):
        for path in (
            *PLACES, "/streams/secret.swz", "/private/secre%74.swz", "/secret.swz", "/secret.ply",
            "/%70rivate/secret%2Eswz", "/%73treams/secret.swz", "/private/secret", "/private/secret.swz/x.swz",
        ):  # fmt: skip
            for token in tokens:
                heads = [
                    f"{method} {with_token(path, token).replace('secre', name)} HTTP/1.1\r\nHost: 127.0.0.1\r\n"
                    "Origin: https://example.org\r\n\r\n"
                    for name in ("secre", "absen")
                ]
                real, absent = (asyncio.run(content.respond(head.encode())) for head in heads)
                assert (real.head, bytes(real.body)) == (absent.head, bytes(absent.body)), (method, path, token)


def test_missing_scenes_are_missing_if_no_scene_is_private(content):
    public = dataclasses.replace(content, access=Access(unlisted=frozenset({"hidden"})))
    for path in ("/private/absent.swz", "/streams/absent.swz", "/absent.spz"):
        assert asked(public, path)[0] == 404, path


def test_a_preflight_permits_the_header_with_the_token(content):
    head = b"OPTIONS /private/secret.swz HTTP/1.1\r\nHost: 127.0.0.1\r\nOrigin: http://localhost:1\r\n\r\n"
    answer = asyncio.run(content.respond(head)).head.decode()
    allowed = re.search(r"Access-Control-Allow-Headers: (.*)\r\n", answer)[1].split(", ")
    assert "Authorization" in allowed


def test_lists_have_neither_private_nor_unlisted_scenes(content):
    for path in ("/", "/streams.json", "/?stream=hidden"):
        status, body = asked(content, path)
        assert status == 200
        assert "secret" not in body
        assert path == "/?stream=hidden" or "hidden" not in body
    assert '"streams/open.swz' in asked(content, "/")[1]
    assert asked(content, "/streams/hidden.swz")[0] == 200
    assert asked(content, "/hidden.spz")[0] == 200


def test_the_page_of_a_private_scene_passes_the_token_on_and_opens_no_session(content):
    token = make_token(KEY, ["secret"], 60.0)
    body = asked(content, with_token("/?stream=secret", token))[1]
    assert f'src="private/secret.swz?token={token}"' in body
    assert f'href="secret.spz?token={token}"' in body
    assert "session=" not in body
    assert "session=" in asked(content, "/?stream=open")[1]


def test_shared_caches_may_not_keep_a_private_scene(content):
    token = make_token(KEY, ["secret"], 60.0)

    def cache(path, headers=""):
        head = asyncio.run(
            content.respond(f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1\r\n{headers}\r\n".encode())
        ).head.decode()
        return re.search(r"Cache-Control: (.*)\r\n", head)[1], re.search(r'ETag: "(.*)"', head)

    bearer = f"Authorization: Bearer {token}\r\n"
    for path in ("/private/secret.swz", "/secret.spz"):
        tag = cache(with_token(path, token))[1][1]
        assert cache(f"{path}?{tag}", bearer)[0] == "private, no-cache", path
        assert cache(with_token(path, token))[0] == "private, no-cache", path
    tag = cache("/streams/open.swz")[1][1]
    assert cache(f"/streams/open.swz?{tag}")[0].startswith("public")


def test_keys_and_times_have_limits(tmp_path):
    (tmp_path / "key").write_bytes(KEY[:31] + b"\n")
    with pytest.raises(InvalidValueError, match="at least 32 bytes"):
        read_key(tmp_path / "key")
    (tmp_path / "key").write_bytes(KEY + b"\n")
    assert read_key(tmp_path / "key") == KEY
    for seconds in (0.0, 0.5, -1.0, float("nan"), 1e9):
        with pytest.raises(InvalidValueError, match="valid for 1 second to"):
            make_token(KEY, ["a"], seconds)
    with pytest.raises(InvalidValueError, match="needs the name"):
        make_token(KEY, [], 60.0)
    with pytest.raises(InvalidValueError, match="make several tokens"):
        make_token(KEY, [f"scene {number}" for number in range(1000)], 60.0)


def test_a_server_over_quic_opens_private_streams_with_a_valid_token_only(content):
    server = Server(content.streams, secret=bytes(16), random=random.Random(0).randbytes)
    server.access = content.access

    def reply(name, token="", client="client"):
        request = Request(next(nonces), bytes(16), name, token)
        assert decode(encode(request)) == request
        return decode(server.receive(client, encode(request), 0.0, reliable=True))

    nonces = itertools.count(1)
    good = make_token(KEY, ["secret"], 60.0)
    for token in ("", "x", make_token(OTHER, ["secret"], 60.0), make_token(KEY, ["open"], 60.0), good[:-1]):
        for name in ("secret", "missing"):  # a missing stream looks like a private one
            assert reply(name, token).reason == NEEDS_TOKEN, token
    assert server.num_transfers == 0
    assert isinstance(reply("secret", good), Welcome)
    assert isinstance(reply("open"), Welcome)
    assert isinstance(reply("hidden"), Welcome)
    assert isinstance(reply(""), Welcome), "without a name, the first listed stream"
    for names in (("secret",), ("hidden", "secret")):
        server.replace({name: content.streams[name] for name in names})
        assert reply("").reason == NEEDS_TOKEN
        assert isinstance(reply("", good), Welcome)


def test_a_request_without_a_name_gets_no_unlisted_stream(content, caplog):
    server = Server(content.streams, secret=bytes(16), random=random.Random(0).randbytes)
    server.access = Access(unlisted=frozenset({"secret", "hidden"}))
    caplog.set_level("INFO")
    assert isinstance(decode(server.receive("client", encode(Request(1, bytes(16), "")), 0.0, reliable=True)), Welcome)
    assert 'stream="open"' in caplog.text
    server.access = Access(unlisted=frozenset(content.streams))
    refusal = decode(server.receive("client", encode(Request(2, bytes(16), "")), 0.0, reliable=True))
    assert REFUSALS[refusal.reason] == "no such stream"


def test_requests_with_other_tokens_are_malformed():
    for token in ("x" * 1025, "caf\xe9", "a\nb"):
        with pytest.raises(BitstreamError):
            decode(encode(Request(1, bytes(16), "scene", token)))
        with pytest.raises(InvalidValueError, match="printable ASCII"):
            ReceiverOptions(scene_token=token)
