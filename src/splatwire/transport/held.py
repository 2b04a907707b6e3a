"""What a client has of a program from before: it does not leave by itself."""

from splatwire.transport.frames import Have
from splatwire.transport.program import Program
from splatwire.transport.wire import DATA, DATA_OVERHEAD, WELCOME


class Held:
    """What one client has said that it has; as large as a bit for each packet that it named."""

    def __init__(self) -> None:
        self._packets = bytearray()
        self._head = False

    def take(self, frame: Have, program: Program) -> int:
        """Takes what a client says; gives the bytes of the program that are news.

        Another stream's are none, nor those of a stream that grows.
        """
        count, at = len(program.packets), frame.first // 8
        if frame.stream_id != program.stream_id or program.open or frame.first >= count:
            return 0
        size = program.head_bytes if frame.head and not self._head else 0
        self._head = self._head or bool(frame.head)
        end = min(at + len(frame.held), -(-count // 8))
        self._packets.extend(bytes(max(end - len(self._packets), 0)))
        for place in range(at, end):
            if new := frame.held[place - at] & ~self._packets[place]:
                self._packets[place] |= new
                told = (8 * place + n for n in range(8) if new >> n & 1)
                size += sum(DATA_OVERHEAD + len(packet) for n in told for packet in program.packets[n : n + 1])
        return size

    def has(self, kind: int, symbol: int) -> bool:
        """Whether an item of a schedule need not leave; who has the head asks for what it lacks and needs no parity."""
        if kind != DATA:
            return self._head and kind != WELCOME
        return symbol // 8 < len(self._packets) and bool(self._packets[symbol // 8] >> symbol % 8 & 1)
