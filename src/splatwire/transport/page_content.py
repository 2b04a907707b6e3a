"""What the page server answers: bytes in, bytes out, no socket."""

import base64
import hashlib
import html
import ipaddress
import json
import re
import socket
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib.resources import files
from typing import NamedTuple
from urllib.parse import quote, unquote

from splatwire.errors import BitstreamError
from splatwire.packets.container import file_head, file_record
from splatwire.packets.manifest import Manifest
from splatwire.transport.http_messages import Answer, Growing, make_answer, make_part, read_request
from splatwire.transport.layout import Segments, split_head_object
from splatwire.transport.origins import host_of, is_loopback, is_loopback_origin
from splatwire.transport.program import Program
from splatwire.transport.scene_list import begins, scene_list, told_of

SCRIPT, DRAWING, STYLE = "splatwire.js", "splatwire-view.js", "page.css"
"""What receives, what it loads to draw with, and what the page looks like."""
FILES = {SCRIPT: "text/javascript", DRAWING: "text/javascript", STYLE: "text/css"}
STREAMS = "/streams/"
_READABLE = "Access-Control-Expose-Headers: Content-Encoding, Content-Range, ETag, Retry-After\r\n"
"""Headers that pages of other origins need to check an answer."""


class Link(NamedTuple):
    """Where a browser opens WebTransport sessions.

    Attributes:
        port: UDP port.
        path: Path of the session.
        fingerprint: SHA-256 of a certificate that was made on the spot; None for one that browsers know.
    """

    port: int
    path: str
    fingerprint: str | None


@dataclass(frozen=True)
class PageContent:
    """Everything that is served.

    Attributes:
        programs: Streams by name, or the bytes of their files, or files that still grow, or None for a live clip, which
            comes by sessions only; the page shows the first one, or that of its query `stream`.
        link: Where datagrams are to be had, or what says so at the moment (certificates are renewed); None where there
            are none.
        host: The address that the server was told to listen on, by which it may be called.
        origins: Origins of web pages that may use the streams. None allows all pages, but on a loopback address only
            pages that come from this machine: any other page that its user visits could read local scenes.
        public_origin: Origin by which visitors reach the server, e.g. through a proxy; None where they reach it
            directly. Its host may be in requests, and streams are for all pages unless `origins` says otherwise.
        attributes: More of what the page's element is told (docs/browser.md).
    """

    programs: Mapping[str, Program | bytes | Growing | None]
    link: Link | Callable[[], Link] | None = None
    host: str = "127.0.0.1"
    origins: tuple[str, ...] | None = None
    public_origin: str | None = None
    attributes: Mapping[str, str] = field(default_factory=dict)
    _files: dict[str, bytes] = field(default_factory=dict, init=False, repr=False)
    _tags: dict[int, str] = field(default_factory=dict, init=False, repr=False)

    def answer(self, head: bytes) -> Answer:
        """What a request gets.

        Args:
            head: The request up to the empty line.
        """
        try:
            request = read_request(head)
        except BitstreamError:
            return make_answer("400 Bad Request")
        if request.method not in ("GET", "HEAD"):
            return make_answer("405 Method Not Allowed", headers="Allow: GET, HEAD\r\n")
        if not self._is_ours(request.host):
            words_of_help = (
                b"open this page by the IP address of its server, or start the server with --public-url ADDRESS, "
                b"the address in the browser's address bar\n"
            )
            return make_answer("403 Forbidden", body=words_of_help)
        found = self._find(request.target, request.query, request.headers.get("origin"))
        if found is None:
            return make_answer("404 Not Found")
        status, kind, body, headers = found
        script = request.target[1:] in FILES
        if isinstance(body, bytes) and (script or request.target.startswith(STREAMS)):
            packed = script and "gzip" in request.headers.get("accept-encoding", "")
            return make_part(kind, body, headers, request, self._tag(body), packed=packed)
        return make_answer(status, kind, body, headers, bodiless=request.method == "HEAD")

    def _tag(self, file: bytes) -> str:
        """What names the content of a file."""
        if id(file) not in self._tags:  # files stay as long as this does
            self._tags[id(file)] = hashlib.sha256(file).hexdigest()[:16]
        return self._tags[id(file)]

    def _find(self, target: str, query: str, origin: str | None) -> tuple[str, str, bytes | Growing, str] | None:
        """Status, kind, body and further headers of a target."""
        if target == "/":
            return "200 OK", "text/html; charset=utf-8", self._page(query).encode(), self._policy()
        shared = self._shared(origin)
        if kind := FILES.get(target[1:]):
            headers = f"{shared}Vary: Accept-Encoding\r\n"
            return "200 OK", f"{kind}; charset=utf-8", _web_bytes(target[1:]), headers
        if target == "/streams.json":
            return "200 OK", "application/json", json.dumps(self._described()).encode(), shared
        name = unquote(target.removeprefix(STREAMS).removesuffix(".swz"))
        if target == stream_path(name) and (file := self._file(name)) is not None:
            return "200 OK", "application/octet-stream", file, shared
        return None

    def _page(self, query: str) -> str:
        wanted = re.search(r"(?:^|&)stream=([^&]*)", query)
        name = unquote(wanted[1]) if wanted else next(iter(self.programs), "")
        attributes = {"src": self._address(name), **self.attributes} if name else dict(self.attributes)
        if link := self._link():
            # Relative: behind a proxy, the host of the request may be another than that of the visitor's address bar.
            attributes["session"] = f":{link.port}{link.path}"
            attributes["fingerprint"] = link.fingerprint or ""
        program = self.programs.get(name)
        if isinstance(program, Program) and program.preview:
            attributes["preview"] = base64.b64encode(program.preview).decode()
            attributes |= begins(*_told(program))  # the preview is on the screen before the stream says it
        words = " ".join(f'{key}="{html.escape(value)}"' for key, value in attributes.items())
        scenes = {one: self._scene(one) for one in self.programs}
        listed = scene_list(scenes, name, lambda one: f"/?stream={quote(one, safe='')}")
        return web_file("index.html").replace("$scenes", listed).replace("$attributes", words)

    def _scene(self, name: str) -> dict[str, str]:
        """What the list of scenes shows of one."""
        program = self.programs[name]
        return told_of(*_told(program), program.preview) if isinstance(program, Program) else {}

    def _address(self, name: str) -> str:
        """Where a page finds a stream: under a name that no other content will have, unless it grows."""
        file = self._file(name)
        return f"{stream_path(name)}?{self._tag(file)}" if isinstance(file, bytes) and file else stream_path(name)

    def _policy(self) -> str:
        link = self._link()
        session = f" https://*:{link.port}" if link else ""
        return (
            "Content-Security-Policy: default-src 'none'; script-src 'self'; style-src 'self'; img-src data:; "
            f"worker-src blob:; connect-src 'self'{session}; base-uri 'none'; form-action 'none'; frame-ancestors *\r\n"
        )

    def _described(self) -> dict[str, object]:
        link = self._link()
        return {"streams": [stream_path(name) for name in self.programs], **(link._asdict() if link else {})}

    def _link(self) -> Link | None:
        return self.link() if callable(self.link) else self.link

    def _shared(self, origin: str | None) -> str:
        """Headers that let a page of an origin read an answer; caches keep answers to different origins apart."""
        if self.origins is None and (self.public_origin is not None or not is_loopback(self.host)):
            return f"Access-Control-Allow-Origin: *\r\n{_READABLE}"
        allowed = is_loopback_origin(origin) if self.origins is None else origin in self.origins
        return (
            f"Access-Control-Allow-Origin: {origin}\r\n{_READABLE}Vary: Origin\r\n" if allowed else "Vary: Origin\r\n"
        )

    def _file(self, name: str) -> bytes | Growing | None:
        program = self.programs.get(name)
        if not isinstance(program, Program):
            return program
        if name not in self._files:
            self._files[name] = program_file(program)
        return self._files[name]

    def _is_ours(self, name: str) -> bool:
        """Returns False for a name that another person could let point to this machine (DNS rebinding).

        Numbers are names of nobody.
        """
        try:
            ipaddress.ip_address(name.strip("[]"))
        except ValueError:
            own = {"localhost", self.host.lower(), socket.gethostname().lower()}
            return name.lower() in own | ({host_of(self.public_origin)} if self.public_origin else set())
        return True


def web_file(name: str) -> str:
    """The text of a file of the page."""
    return _web_bytes(name).decode()


@cache
def _web_bytes(name: str) -> bytes:
    """A file of the page, one for all who read it."""
    return files("splatwire.transport").joinpath("web").joinpath(name).read_bytes()


def stream_path(name: str) -> str:
    """Where a stream is found on the page's server."""
    return f"{STREAMS}{quote(name, safe='')}.swz"


def program_file(program: Program) -> bytes:
    """A stream as one file (docs/format.md), its packets in the order in which they are sent."""
    manifest, side_info = _head(program)
    return b"".join([file_head(manifest, side_info), *map(file_record, program.packets)])


def _head(program: Program) -> tuple[Manifest, bytes]:
    """Manifest and side information of what is served."""
    segments = Segments(program.head_bytes, program.symbol_bytes)
    symbols = (symbol for number, segment in enumerate(program.head) for symbol in segment[: segments.size(number)])
    manifest, side_info, _ = split_head_object(b"".join(symbols)[: program.head_bytes])
    return manifest, side_info


def _told(program: Program) -> tuple[bytes, str]:
    """Side information and schema of what is served."""
    manifest, side_info = _head(program)
    return side_info, manifest.codec
