"""`splatwire serve`: a stream is sent to whoever asks for it."""

import asyncio
import signal
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from splatwire.cli._output import JsonFlag, print_json

if TYPE_CHECKING:
    from splatwire.transport import Program, Protection, ServerLimits


@dataclass(frozen=True)
class Serve:
    """Serve streams over UDP to many clients at once; stop with Ctrl-C."""

    streams: tyro.conf.Positional[list[str]]
    """Streams of the preset datagram: .swz files or folders. A client names one by its file name without the ending;
    one that names none gets the first."""
    port: int = 4840
    """UDP port; 0 lets the system choose."""
    host: str = "127.0.0.1"
    """Address to listen on; 0.0.0.0 for all of this machine's."""
    rate: float | None = None
    """Megabits per second to each client, fixed; without it the rate adapts to the path."""
    side_repair: float = 0.35
    """Repair symbols for each symbol of the side information."""
    side_lead: float = 0.4
    """Share of the packets that the side information is sent between."""
    parity: tuple[str, ...] = ()
    """Parity over packets, tier by tier in sending order: SHARE:REPAIR, e.g. 0.2:0.5."""
    clients: int = 256
    """Most clients at once."""
    json: JsonFlag = False
    """Print one JSON object when ready."""

    def run(self) -> None:
        """Runs the verb."""
        from splatwire.errors import InvalidValueError

        if not 0 <= self.port < 1 << 16:
            raise InvalidValueError(f"a port is a number from 0 to 65535, {self.port} is not")
        if not self.streams:
            raise InvalidValueError("name at least one stream to serve")
        protection = self.protection()
        programs = {stream_name(path): load_program(path, protection) for path in self.streams}
        asyncio.run(self._serve(programs))

    def protection(self) -> "Protection":
        """Where redundancy goes.

        Raises:
            InvalidValueError: If a number is out of range, or a tier is not SHARE:REPAIR.
        """
        from splatwire.errors import InvalidValueError
        from splatwire.transport import Protection, Tier

        tiers = []
        for text in self.parity:
            try:
                share, repair = map(float, text.split(":"))
            except ValueError:
                raise InvalidValueError(f"'{text}' is not a tier of parity such as 0.2:0.5") from None
            tiers.append(Tier(share, repair))
        return Protection(self.side_repair, self.side_lead, tuple(tiers))

    def limits(self) -> "ServerLimits":
        """What is spent on clients.

        Raises:
            InvalidValueError: If the rate is not above 0.
        """
        from splatwire.errors import InvalidValueError
        from splatwire.transport import ServerLimits

        if self.rate is not None and not 0 < self.rate <= 100_000:
            raise InvalidValueError(f"a rate is above 0 and at most 100000 megabits per second, {self.rate} is not")
        return ServerLimits(sessions=self.clients, fixed_rate=None if self.rate is None else self.rate * 1e6 / 8)

    async def _serve(self, programs: "dict[str, Program]") -> None:
        from splatwire.transport.udp import UdpServer

        stop = asyncio.Event()
        loop = asyncio.get_running_loop()
        for number in (signal.SIGINT, signal.SIGTERM):
            loop.add_signal_handler(number, stop.set)
        server = UdpServer(programs, self.host, self.port, limits=self.limits())
        try:
            sizes = {name: program.sizes() for name, program in programs.items()}
            if self.json:
                print_json({"host": self.host, "port": server.port, "streams": sizes})
            else:
                for name, parts in sizes.items():
                    print(f"{name}: {sum(parts.values()):,} bytes, of which protection "
                          f"{parts['side_protection'] + parts['packet_protection']:,}")  # fmt: skip
                print(f"serving on udp://{self.host}:{server.port}")
            sys.stdout.flush()
            await stop.wait()
        finally:
            server.close()
        print(f"served {server.core.num_served} clients, {server.bytes_sent:,} bytes", file=sys.stderr)


def stream_name(path: str) -> str:
    """Name by which clients ask for a stream."""
    from splatwire.packets.stream import FILE_SUFFIX

    return Path(path).resolve().name.removesuffix(FILE_SUFFIX)


def load_program(path: str, protection: "Protection") -> "Program":
    """Reads a stream and prepares it for sending.

    Raises:
        InvalidValueError: If it is incomplete, or its packets do not fit datagrams.
    """
    from splatwire.packets import read_stream
    from splatwire.transport import make_program

    stream, _ = read_stream(Path(path))
    return make_program(stream, protection)
