"""Content of the HTTP server for the browser page: computes the response to a request, without sockets."""

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

from splatwire.bitstream.container import file_head, file_record
from splatwire.bitstream.manifest import Manifest
from splatwire.errors import BitstreamError, SplatwireError
from splatwire.transport.access import Access
from splatwire.transport.http.downloads import FOLDERS, TILESET, Downloads, prefixed_tileset
from splatwire.transport.http.messages import (
    GrowingFile,
    Request,
    Response,
    accepts_gzip,
    is_current,
    make_file_response,
    make_response,
    read_request,
    token_in,
    token_of,
)
from splatwire.transport.http.origins import host_of, is_loopback, is_loopback_origin, listens_on_loopback
from splatwire.transport.http.scene_list import preview_attributes, scene_list, start_attributes
from splatwire.transport.protocol.layout import SourceBlocks, split_init_segment
from splatwire.transport.protocol.served_stream import ServedStream

SCRIPT, RENDERER, STYLE = "splatwire.js", "splatwire-view.js", "page.css"
"""Files of the browser page: script of the receiver, script of the renderer (loaded by the receiver), style sheet."""
FILES = {SCRIPT: "text/javascript", RENDERER: "text/javascript", STYLE: "text/css"}
PART_TYPES = {"json": "application/json", "glb": "model/gltf-binary", "webp": "image/webp"}
"""Media types of files in folders of other formats, by suffix."""
STREAMS, PRIVATE = "/streams/", "/private/"
"""Folders of public streams, and of streams that need a token."""
_READABLE = "Access-Control-Expose-Headers: Content-Encoding, Content-Range, ETag, Retry-After\r\n"
"""CORS header that lets pages of other web origins read the named response headers."""
METHODS = "GET, HEAD, OPTIONS"
_PREFLIGHT = (
    "Access-Control-Allow-Methods: GET, HEAD\r\n"
    "Access-Control-Allow-Headers: "
    "Authorization, Range, If-Range, If-Match, If-None-Match, Cache-Control, Pragma\r\n"
    "Access-Control-Max-Age: 86400\r\n"
)
"""CORS headers that answer a preflight: methods and request headers that a page of another web origin may use."""


class _StreamFacts(NamedTuple):
    """Facts about a prepared stream for the page.

    Attributes:
        stream: The stream.
        manifest: Its manifest.
        start_attributes: HTML attributes with its initial view and up axis.
        preview_attributes: HTML attributes with which the list of scenes shows its preview; empty without a preview.
    """

    stream: ServedStream
    manifest: Manifest
    start_attributes: Mapping[str, str]
    preview_attributes: Mapping[str, str]


class WebTransportEndpoint(NamedTuple):
    """WebTransport endpoint of the server, to which the page connects.

    Attributes:
        port: UDP port of the endpoint.
        path: Path of the WebTransport session in its URL.
        fingerprint: SHA-256 of the endpoint's self-signed certificate, hexadecimal; None if browsers trust the
            certificate.
    """

    port: int
    path: str
    fingerprint: str | None


@dataclass(frozen=True)
class PageContent:
    """Content that the HTTP server for the browser page offers: page, scripts and streams.

    Attributes:
        streams: Streams by name: a prepared stream, the bytes of a `.swz` file, or a file that still grows. None for a
            live sequence, which is not offered over HTTP.
        endpoint: WebTransport endpoint, or a function that returns the current one; None without an endpoint.
        host: Address that the server listens on; accepted in the `Host` header of requests.
        origins: Web origins whose pages may read the streams. None allows all origins, or only origins of this machine
            if the server listens on a loopback address.
        public_origin: Web origin under which visitors reach the server, such as that of a proxy. None if they connect
            directly.
        attributes: Further HTML attributes of the page's viewer element (`docs/browser.md`).
        access: Access rules for the scenes; None if all are public.
        updates: Updates of the streams by file name. They can be requested, but the list of scenes does not show them.
        downloads: Converter of the streams to other file formats; None for no such downloads.
    """

    streams: Mapping[str, ServedStream | bytes | GrowingFile | None]
    endpoint: WebTransportEndpoint | Callable[[], WebTransportEndpoint] | None = None
    host: str = "127.0.0.1"
    origins: tuple[str, ...] | None = None
    public_origin: str | None = None
    attributes: Mapping[str, str] = field(default_factory=dict)
    access: Access | None = None
    updates: Mapping[str, ServedStream | bytes] = field(default_factory=dict)
    downloads: Downloads | None = None
    _files: dict[str, bytes] = field(default_factory=dict, init=False, repr=False)
    _facts: dict[str, _StreamFacts] = field(default_factory=dict, init=False, repr=False)
    _tags: dict[int, str] = field(default_factory=dict, init=False, repr=False)

    def respond_now(self, head: bytes) -> Response:
        """Returns the HTTP response to a request for the page, a script, a list or a stream.

        A download in another file format gets status 404, because only `respond` waits for the conversion.

        Args:
            head: Head of the HTTP request, up to and including the empty line.
        """
        try:
            request = read_request(head)
        except BitstreamError:
            return make_response("400 Bad Request")
        return self._respond_now(request).for_method(request.method)

    async def respond(self, head: bytes) -> Response:
        """Returns the HTTP response to any request; for a download in another format, waits for the conversion.

        Args:
            head: Head of the HTTP request, up to and including the empty line.
        """
        try:
            request = read_request(head)
        except BitstreamError:
            return make_response("400 Bad Request")
        wanted = self._parse_download(request.target)
        if wanted is None or self.downloads is None or not self._is_own_host(request.host):
            return self.respond_now(head)
        cors_headers = self._cors_headers(request.headers.get("origin"))
        if request.method == "OPTIONS":
            return self._preflight(request)
        if request.method not in ("GET", "HEAD"):
            return self.respond_now(head)
        name, form, part = wanted
        if (refused := self._unauthorized(name, request)) is not None:
            return refused.for_method(request.method)
        stream = self._file(name)
        assert isinstance(stream, bytes)
        try:
            download = await self.downloads.file(stream, self._entity_tag(stream), form, part)
        except (SplatwireError, OSError):
            return make_response("500 Internal Server Error", headers=cors_headers).for_method(request.method)
        if download is None:
            return make_response("404 Not Found", headers=cors_headers).for_method(request.method)
        file_name = quote(f"{name}.{form}", safe="")
        attachment = f"Content-Disposition: attachment; filename*=UTF-8''{file_name}\r\n"
        headers = cors_headers if part else attachment + cors_headers
        kind = PART_TYPES.get(part.rpartition(".")[2], "application/octet-stream")
        data, tag = download
        if request.target == f"/{TILESET}":
            data = prefixed_tileset(bytes(data), f"{quote(name, safe='')}/{form}/")
            tag = hashlib.sha256(data).hexdigest()[:16]
        private = self._is_private(name)
        return make_file_response(kind, data, headers, request, tag, private=private).for_method(request.method)

    def _parse_download(self, target: str) -> tuple[str, str, str] | None:
        """Parses a download path such as `/room.spz` or `/room/3dtiles/tileset.json`.

        Returns:
            Three texts: name of the stream, file format, and path of the requested file in the format's folder. The
            third is empty for a format with a single file. None if the path is not a download path.
        """
        if target == f"/{TILESET}":
            listed = self._listed()
            is_available = len(listed) == 1 and "3dtiles" in self._download_formats(listed[0])
            return (listed[0], "3dtiles", TILESET) if is_available else None
        if target.count("/") > 2:
            name, form, part = target[1:].split("/", 2)
            is_available = form in FOLDERS and form in self._download_formats(unquote(name))
            return (unquote(name), form, part) if is_available else None
        name, dot, form = unquote(target[1:]).rpartition(".")
        single = form not in FOLDERS and form in self._download_formats(name)
        return (name, form, "") if dot and _is_same_path(target, download_path(name, form)) and single else None

    def _download_formats(self, name: str) -> tuple[str, ...]:
        """Returns the file formats in which a stream can be downloaded."""
        stream = self.streams.get(name)
        if self.downloads is None or not isinstance(stream, ServedStream) or stream.is_live:
            return ()
        schema = self._facts_of(name, stream).manifest.schema
        private = self._is_private(name)  # addresses inside the files of a folder have no token
        offered = tuple(form for form in self.downloads.formats if not (private and form in FOLDERS))
        return offered if schema.explicit and not schema.timed else ()

    def _download_list(self, name: str, token: str) -> str:
        """Returns the HTML list of links to the formats in which a stream can be downloaded.

        Args:
            name: Name of the stream.
            token: Access token to add to the links; empty to add none.
        """
        query = f"?token={token}" if token else ""
        paths = {form: _relative(download_path(name, form)) for form in self._download_formats(name)}
        files = {form: html.escape(path + query) for form, path in paths.items()}
        links = [
            f'<li><a href="{url}">{html.escape(name)}, {form}</a></li>' if form in FOLDERS else
            f'<li><a href="{url}" download>{html.escape(name)}.{form}</a></li>' for form, url in files.items()
        ]  # fmt: skip
        return f'<nav aria-label="files for other programs"><ul>{"".join(links)}</ul></nav>' if links else ""

    def _respond_now(self, request: Request) -> Response:
        if request.method not in ("GET", "HEAD", "OPTIONS"):
            return make_response("405 Method Not Allowed", headers=f"Allow: {METHODS}\r\n")
        if not self._is_own_host(request.host):
            return make_response("403 Forbidden", body=self._host_advice())
        origin = request.headers.get("origin")
        if request.method == "OPTIONS":  # also for missing scenes, so that no response reveals names of private scenes
            return self._preflight(request)
        if (refused := self._unauthorized(self._requested_scene(request), request)) is not None:
            return refused
        resource = self._find_resource(request.target, request.query, origin)
        if resource is None:  # pages of other origins may see that a stream is missing
            return make_response("404 Not Found", headers=self._cors_headers(origin))
        status, kind, body, headers = resource
        script, stream = request.target[1:] in FILES, _split_stream_path(request.target)
        if isinstance(body, bytes) and (script or stream is not None):
            packed = script and accepts_gzip(request.headers.get("accept-encoding", ""))
            private = stream is not None and stream[0] == PRIVATE
            return make_file_response(
                kind, body, headers, request, self._entity_tag(body), packed=packed, private=private
            )
        if is_current("", request.headers.get("if-none-match", "")):
            return make_response("304 Not Modified", kind, headers=headers, bodiless=True)
        # With "no-store", browsers would not keep the page for the back button.
        is_cacheable = request.target == "/" and not self._is_private(self._shown_name(request.query))
        return make_response(status, kind, body, headers, cache="no-cache" if is_cacheable else "no-store")

    def _requested_scene(self, request: Request) -> str:
        """Returns the name of the scene that a request is for; empty for a request that needs no access token."""
        if request.target == "/":
            return self._shown_name(request.query)
        stream = _split_stream_path(request.target)
        if stream is not None and stream[0] == PRIVATE:
            return stream[1]
        name, _, form = unquote(request.target[1:]).rpartition(".")
        return name if self.downloads is not None and form in self.downloads.formats else ""

    def _unauthorized(self, name: str, request: Request) -> Response | None:
        """Returns the response that refuses a request for a scene; None if the request is allowed."""
        if self.access is None or not name:
            return None
        # The response for a private scene is the same as for a missing one, so that it does not reveal private scenes.
        reason = self.access.refusal(name, token_of(request), exists=name in self.streams)
        if reason is None:
            return None
        headers = f"WWW-Authenticate: Bearer\r\n{self._cors_headers(request.headers.get('origin'))}"
        return make_response("401 Unauthorized", body=f"{reason}\n".encode(), headers=headers)

    def _is_private(self, name: str) -> bool:
        return self.access is not None and name in self.access.private

    def _listed(self) -> list[str]:
        """Returns the names of the scenes that are neither private nor unlisted."""
        return [name for name in self.streams if self.access is None or self.access.is_listed(name)]

    def _shown_name(self, query: str) -> str:
        """Returns the name of the scene to show on the page.

        Args:
            query: Query string of the URL. Its parameter `stream` names the scene; the default is the first listed one.
        """
        wanted = re.search(r"(?:^|&)stream=([^&]*)", query)
        return unquote(wanted[1]) if wanted else next(iter(self._listed()), "")

    def _preflight(self, request: Request) -> Response:
        """Returns the response to an OPTIONS request (CORS preflight)."""
        headers = self._cors_headers(request.headers.get("origin"))
        if request.target != "/" and "Access-Control-Allow-Origin" in headers:
            headers = f"{headers.replace(_READABLE, '')}{_PREFLIGHT}"
        return make_response("204 No Content", headers=f"Allow: {METHODS}\r\n{headers}")

    def busy(self, head: bytes) -> Response:
        """Returns the HTTP response that refuses a request because the server is busy.

        Args:
            head: Head of the HTTP request, up to and including the empty line.
        """
        try:
            request = read_request(head)
        except BitstreamError:
            return make_response("400 Bad Request")
        cors_headers = self._cors_headers(request.headers.get("origin"))
        response = make_response("503 Service Unavailable", headers=f"Retry-After: 1\r\n{cors_headers}")
        return response.for_method(request.method)

    def _host_advice(self) -> bytes:
        """Returns the text of the response to an unknown `Host` header: advice on how to reach the server."""
        if self.public_origin is not None:
            host = host_of(self.public_origin)
            return f"the proxy must pass 'Host: {host}' or the IP address of this server\n".encode()
        return (
            b"open this page by the IP address of its server, or start the server with --public-url ADDRESS, "
            b"the address in the browser's address bar\n"
        )

    def _entity_tag(self, file: bytes) -> str:
        """Returns the HTTP entity tag (ETag) of a file, derived from its content."""
        if id(file) not in self._tags:  # files live as long as this object
            self._tags[id(file)] = hashlib.sha256(file).hexdigest()[:16]
        return self._tags[id(file)]

    def _find_resource(
        self, target: str, query: str, origin: str | None
    ) -> tuple[str, str, bytes | GrowingFile, str] | None:
        """Finds the page, script, list or stream at a path.

        Args:
            target: Path of the URL.
            query: Query string of the URL.
            origin: Web origin of the requesting page, for the CORS headers; None without an `Origin` header.

        Returns:
            Status, media type, body and further headers of the response; None if nothing has this path.
        """
        if target == "/":
            return "200 OK", "text/html; charset=utf-8", self._page(query).encode(), self._content_security_policy()
        cors_headers = self._cors_headers(origin)
        if kind := FILES.get(target[1:]):
            headers = f"{cors_headers}Vary: Accept-Encoding\r\n"
            return "200 OK", f"{kind}; charset=utf-8", _web_bytes(target[1:]), headers
        if target == "/streams.json":
            return "200 OK", "application/json", json.dumps(self._stream_list()).encode(), cors_headers
        stream = _split_stream_path(target)
        if stream is None:
            return None
        folder, name = stream
        if self._is_private(name) != (folder == PRIVATE) or (file := self._file(name)) is None:
            return None
        return "200 OK", "application/octet-stream", file, cors_headers

    def _page(self, query: str) -> str:
        name = self._shown_name(query)
        token = token_in(query) if self._is_private(name) else ""
        address = f"{self._stream_path(name)}?token={token}" if token else self._stream_url(name)
        # a live stream of datagrams has no file: `src` then only names it
        attributes = {"src": _relative(address), **self.attributes} if name else dict(self.attributes)
        if (endpoint := self._endpoint()) and not self._is_private(name):
            # Relative, because behind a proxy the request's host may differ from the one in the visitor's address bar.
            attributes["session"] = f":{endpoint.port}{endpoint.path}"
            attributes["fingerprint"] = endpoint.fingerprint or ""
        stream = self.streams.get(name)
        if isinstance(stream, ServedStream) and stream.preview:
            attributes["preview"] = base64.b64encode(stream.preview).decode()
            # shows the preview before the stream arrives
            attributes |= self._facts_of(name, stream).start_attributes
        words = " ".join(f'{key}="{html.escape(value)}"' for key, value in attributes.items())
        scenes = {one: self._scene_attributes(one) for one in self._listed()}
        listed = scene_list(scenes, name, lambda one: f"?stream={quote(one, safe='')}")
        listed += self._download_list(name, token)
        return web_file("index.html").replace("$scenes", listed).replace("$attributes", words)

    def _scene_attributes(self, name: str) -> dict[str, str]:
        """Returns the HTML attributes with which the list of scenes shows the preview of a stream.

        The result maps attribute names of the element `<splat-wire>` to values. It is empty for a stream without a
        preview.
        """
        stream = self.streams[name]
        return dict(self._facts_of(name, stream).preview_attributes) if isinstance(stream, ServedStream) else {}

    def _facts_of(self, name: str, stream: ServedStream) -> _StreamFacts:
        """Returns facts about a stream; reads them from its side information at the first call for the stream only."""
        facts = self._facts.get(name)
        if facts is None or facts.stream is not stream:
            manifest, side_info = _manifest_and_side_info(stream)
            start = start_attributes(side_info, manifest.schema_name)
            preview = preview_attributes(side_info, manifest.schema_name, stream.preview)
            facts = self._facts[name] = _StreamFacts(stream, manifest, start, preview)
        return facts

    def _stream_url(self, name: str) -> str:
        """Returns the URL of a stream's file on this server."""
        file = self._file(name)
        path = self._stream_path(name)
        return f"{path}?{self._entity_tag(file)}" if isinstance(file, bytes) and file else path

    def _stream_path(self, name: str) -> str:
        """Returns the URL path of a stream's file. Paths of private scenes are in a separate folder."""
        return stream_path(name).replace(STREAMS, PRIVATE, 1) if self._is_private(name) else stream_path(name)

    def _content_security_policy(self) -> str:
        endpoint = self._endpoint()
        session = f" https://*:{endpoint.port}" if endpoint else ""
        return (
            "Content-Security-Policy: default-src 'none'; script-src 'self' 'wasm-unsafe-eval'; style-src 'self'; "
            f"img-src data:; worker-src blob:; connect-src 'self'{session}; base-uri 'none'; form-action 'none'; "
            "frame-ancestors *\r\n"
        )

    def _stream_list(self) -> dict[str, object]:
        endpoint = self._endpoint()
        return {"streams": [stream_path(name) for name in self._listed()], **(endpoint._asdict() if endpoint else {})}

    def _endpoint(self) -> WebTransportEndpoint | None:
        return self.endpoint() if callable(self.endpoint) else self.endpoint

    def _cors_headers(self, origin: str | None) -> str:
        """Returns the CORS headers of a response to a page of the given web origin."""
        if self.origins is None and (self.public_origin is not None or not listens_on_loopback(self.host)):
            return f"Access-Control-Allow-Origin: *\r\n{_READABLE}"
        allowed = is_loopback_origin(origin) if self.origins is None else origin in self.origins
        return (
            f"Access-Control-Allow-Origin: {origin}\r\n{_READABLE}Vary: Origin\r\n" if allowed else "Vary: Origin\r\n"
        )

    def _file(self, name: str) -> bytes | GrowingFile | None:
        stream = self.streams.get(name, self.updates.get(name))
        if not isinstance(stream, ServedStream):
            return stream
        if name not in self._files:
            self._files[name] = served_stream_file(stream)
        return self._files[name]

    def _is_own_host(self, name: str) -> bool:
        """True if the `Host` header of a request is accepted: it has a name of this server, or any IP address."""
        if not name:
            return True
        # Other names are refused, because an attacker's name could point to this machine (DNS rebinding).
        plain = name.lower().removesuffix(".")  # a name with a final dot is the same name (RFC 1034)
        try:
            ipaddress.ip_address(plain.strip("[]"))
        except ValueError:
            own_names = {self.host.lower(), socket.gethostname().lower()}
            return is_loopback(name) or plain in own_names | (
                {host_of(self.public_origin)} if self.public_origin else set()
            )
        return True


def _split_stream_path(target: str) -> tuple[str, str] | None:
    """Splits the URL path of a stream's file in any percent-encoding; returns None for another path.

    Args:
        target: Path of a request, percent-encoded.

    Returns:
        Folder (`STREAMS` or `PRIVATE`) and name of the stream, decoded.
    """
    start, *parts = (unquote(part) for part in target.split("/"))  # an encoded slash belongs to a name
    if start or len(parts) != 2 or f"/{parts[0]}/" not in (STREAMS, PRIVATE) or not parts[1].endswith(".swz"):
        return None
    return f"/{parts[0]}/", parts[1].removesuffix(".swz")


def _is_same_path(target: str, path: str) -> bool:
    """True if two URL paths are equal after percent-decoding, with slashes at the same places.

    Proxies such as nginx encode a path anew, and JavaScript leaves characters unencoded that Python encodes.

    Args:
        target: Path of a request.
        path: Path on this server.
    """
    return [unquote(part) for part in target.split("/")] == [unquote(part) for part in path.split("/")]


def _relative(path: str) -> str:
    """Returns a path of this server relative to its page: a proxy may offer the page below a path of its own."""
    return path.removeprefix("/")


def web_file(name: str) -> str:
    """Returns the text of a file of the browser page, such as a script or `index.html`, given its name."""
    return _web_bytes(name).decode()


@cache
def _web_bytes(name: str) -> bytes:
    """Returns the bytes of a file of the browser page, such as a script or `index.html`, given its name."""
    return files("splatwire").joinpath("web").joinpath(name).read_bytes()


def stream_path(name: str) -> str:
    """Returns the URL path under which the page server offers a stream of a given name."""
    return f"{STREAMS}{quote(name, safe='')}.swz"


def download_path(name: str, format_name: str) -> str:
    """Returns the URL path from which a stream can be downloaded in another file format.

    Args:
        name: Name of the stream.
        format_name: File format: a suffix without its dot, such as `spz`, or a format with several files, such as
            `3dtiles`.
    """
    if format_name in FOLDERS:
        return f"/{quote(name, safe='')}/{format_name}/{FOLDERS[format_name]}"
    return f"/{quote(name, safe='')}.{format_name}"


def served_stream_file(stream: ServedStream) -> bytes:
    """Returns the bytes of a prepared stream as one `.swz` file."""
    manifest, side_info = _manifest_and_side_info(stream)
    return b"".join([file_head(manifest, side_info), *map(file_record, stream.packets)])


def _manifest_and_side_info(stream: ServedStream) -> tuple[Manifest, bytes]:
    """Parses the init segment of a stream, and returns manifest and side information (data that all packets need)."""
    source_blocks = SourceBlocks(stream.init_segment_bytes, stream.symbol_bytes)
    symbols = (
        symbol
        for number, source_block in enumerate(stream.init_symbols)
        for symbol in source_block[: source_blocks.size(number)]
    )
    manifest, side_info, _ = split_init_segment(b"".join(symbols)[: stream.init_segment_bytes])
    return manifest, side_info
