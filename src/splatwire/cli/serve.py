"""`splatwire serve`: a stream is sent to whoever asks for it."""

import asyncio
import contextlib
import re
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from splatwire.cli import _bundled
from splatwire.cli._datagrams import in_datagrams
from splatwire.cli._files import stream_name
from splatwire.cli._listening import Listening, open_server, stop_on_signals
from splatwire.cli._publishing import publish_stream
from splatwire.cli._receiving import RelayTrustOptions

if TYPE_CHECKING:
    from splatwire.packets import SceneStream
    from splatwire.transport import Program, Protection, ServerLimits


@dataclass(frozen=True)
class Serve(Listening):
    """Serve streams over UDP or QUIC to many clients at once; stop with Ctrl-C."""

    streams: tyro.conf.Positional[tuple[str, ...]] = ()
    """Streams, .swz files or folders; the bundled scene's Gaussians if absent. One of another preset than datagram is
    put into packets that fit datagrams first, which changes nothing of the scene. A client names one by its file name
    without the ending; one that names none gets the first."""
    origins: tuple[str, ...] = ()
    """With --quic: web pages that may read streams and open sessions, e.g. https://example.org. Where none is named,
    all may; only pages of this machine if --host is a loopback address and there is no --public-url."""
    idle: float = 5.0
    """A client that says nothing for so many seconds is forgotten."""
    plan: Path | None = None
    """Where redundancy goes, as `splatwire plan -o FILE` wrote it for this stream."""
    side_repair: float | None = None
    """Without --plan: repair symbols for each symbol of the side information; 0.35 where absent."""
    protect: tuple[str, ...] = ()
    """Without --plan: repair symbols for each packet of a tier: tierN=REPAIR, e.g. tier0=0.4. A stream that was encoded
    without --tiers is tier 0. motion=REPAIR: for each packet of motion of a clip, in every group of frames."""
    clients: int = 256
    """Most clients at once."""
    clients_per_address: int = 16
    """Most of them at one IPv4 address or in one /64 prefix of IPv6, which may begin twice as many a minute."""
    moq: str | None = None
    """Publish one stream to a relay of Media over QUIC, which sends it to whoever asks there, instead of listening:
    https://RELAY[:PORT]/NAME."""
    trust: RelayTrustOptions = field(default_factory=RelayTrustOptions)

    def run(self) -> None:
        """Runs the verb."""
        from splatwire.errors import InvalidValueError

        self.check_listening()
        if not self.over_quic and self.origins:
            raise InvalidValueError("--certificate, --key and --origins are for --quic")
        self.allowed_origins()
        if self.moq is not None:
            if self.over_quic or self.plan or self.protect or len(self.streams) > 1:
                raise InvalidValueError("--moq publishes one stream, which the relay sends: no --page, --quic, --plan")
            path = Path((self.streams or (str(_bundled.ASSETS / _bundled.SPLATS),))[0])
            asyncio.run(publish_stream(self.moq, path, self.trust, json=self.json))
            return
        if self.trust.given:
            raise InvalidValueError("--fingerprint, --authority and --insecure are for --moq")
        (protection, planned), _ = self.protection(), self.limits()  # mistakes are told before streams are read
        asyncio.run(self._serve(self._programs(protection, planned)))

    def _programs(self, protection: "Protection", planned: int | None = None) -> "dict[str, Program]":
        """What is served, by name.

        Raises:
            InvalidValueError: If two streams have one name, or the plan is for another stream.
        """
        from splatwire.errors import InvalidValueError
        from splatwire.packets import read_stream

        named: dict[str, str] = {}
        for path in self.streams or (str(_bundled.ASSETS / _bundled.SPLATS),):
            other = named.setdefault(stream_name(path), path)
            if other != path:
                raise InvalidValueError(
                    f"{other} and {path} are both called '{stream_name(path)}', by which clients ask: rename one"
                )
        streams = {name: (path, in_datagrams(read_stream(Path(path))[0], path)) for name, path in named.items()}
        for path, stream in streams.values():
            if planned is not None and stream.manifest.stream_id != planned:
                raise InvalidValueError(
                    f"{self.plan} is for the stream {planned:08x}, and {path} is "
                    f"{stream.manifest.stream_id:08x}: plan for it"
                )
        return {name: program_of(stream, protection) for name, (_, stream) in streams.items()}

    def protection(self) -> "tuple[Protection, int | None]":
        """Where redundancy goes, and the id of the stream that it was planned for, if it was.

        Raises:
            InvalidValueError: If a number is out of range, something is no plan, or both are given.
        """
        from splatwire.errors import InvalidValueError
        from splatwire.transport import Protection

        if self.plan is None:
            side_repair = Protection().side_repair if self.side_repair is None else self.side_repair
            return protection_of(side_repair, self.protect), None
        if self.side_repair is not None or self.protect:
            raise InvalidValueError("--side-repair and --protect are what --plan decides: give one or the other")
        return plan_of_file(self.plan)

    def limits(self) -> "ServerLimits":
        """What is spent on clients.

        Raises:
            InvalidValueError: If the rate is not above 0, or another number is out of range.
        """
        from splatwire.errors import InvalidValueError
        from splatwire.transport import ServerLimits

        if not 0.1 <= self.idle <= 3600:
            raise InvalidValueError(f"--idle is from 0.1 to 3600 seconds, {self.idle} is not")
        if min(self.clients, self.clients_per_address) < 1:
            raise InvalidValueError("--clients and --clients-per-address are at least 1")
        return ServerLimits(self.clients, self.clients_per_address, silence_s=self.idle, fixed_rate=self.fixed_rate)

    def allowed_origins(self) -> tuple[str, ...]:
        """Web origins of `origins`, as browsers write them.

        Raises:
            InvalidValueError: If one is something else.
        """
        from splatwire.transport.origins import parse_origin

        return tuple(map(parse_origin, self.origins))

    async def _serve(self, programs: "dict[str, Program]") -> None:
        stop = stop_on_signals()
        async with contextlib.AsyncExitStack() as stack:
            opened = await open_server(programs, self, self.limits(), stack, origins=self.allowed_origins())
            sizes = {name: program.sizes() for name, program in programs.items()}
            for name, parts in () if self.json else sizes.items():
                print(f"{name}: {sum(parts.values()):,} bytes, of which protection "
                      f"{parts['side_protection'] + parts['packet_protection']:,}")  # fmt: skip
            self.tell_ready(opened.server.port, opened.facts, "serving", streams=sizes)
            await stop.wait()
        print(opened.served(), file=sys.stderr)


def plan_of_file(path: Path) -> "tuple[Protection, int]":
    """What `splatwire plan` wrote, see `splatwire.plan.plan_file.read_plan`."""
    from splatwire.plan.plan_file import MOST_BYTES, read_plan

    with path.open("rb") as file:
        return read_plan(file.read(MOST_BYTES + 1), str(path))


def protection_of(side_repair: float, texts: Sequence[str]) -> "Protection":
    """Reads motion=REPAIR, and tierN=REPAIR (`parse_tiers`).

    Raises:
        InvalidValueError: If it is something else, or a number is out of range.
    """
    from splatwire.transport import Protection

    motion = [match for match in (re.fullmatch(r"motion=([0-9]*\.?[0-9]+)", text.strip()) for text in texts) if match]
    tiers = parse_tiers([text for text in texts if not text.strip().startswith("motion=")])
    return Protection(
        side_repair=side_repair, tier_repair=tiers, motion=tuple((1.0, float(match[1])) for match in motion[-1:])
    )


def parse_tiers(texts: Sequence[str]) -> tuple[float, ...]:
    """Reads tierN=REPAIR, in any order; tiers between that are not named have no parity.

    Raises:
        InvalidValueError: If it is something else, or a tier is named twice.
    """
    from splatwire.errors import InvalidValueError

    found: dict[int, float] = {}
    for text in texts:
        match = re.fullmatch(r"tier([0-7])=([0-9]*\.?[0-9]+)", text.strip())
        if match is None or int(match[1]) in found:
            raise InvalidValueError(f"'{text}' is not parity for a tier such as tier0=0.4, or names one again")
        found[int(match[1])] = float(match[2])
    return tuple(found.get(tier, 0.0) for tier in range(max(found, default=-1) + 1))


def program_of(stream: "SceneStream", protection: "Protection") -> "Program":
    """Prepares a stream for sending, with its preview.

    Raises:
        InvalidValueError: If it is incomplete, or its packets do not fit datagrams.
    """
    from splatwire.transport import make_program
    from splatwire.transport.preview import stream_preview

    worth = None
    if any(share < 1 for share, _ in protection.motion):  # what a relay without torch is not asked for
        from splatwire.clips.worth import worth_of_stream

        worth = worth_of_stream(stream)
    preview = stream_preview(stream.side_info, stream.manifest.codec)
    return make_program(stream, protection, preview=preview, worth=worth)
