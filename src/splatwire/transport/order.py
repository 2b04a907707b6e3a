"""What leaves next of a program, each packet once: by its schedule, or what somebody looks at first."""

from array import array
from collections import deque

import numpy as np

from splatwire.packets.view import Look, cut_of
from splatwire.transport.frames import BY_SEQUENCE, View
from splatwire.transport.program import Program
from splatwire.transport.wire import DATA, PARITY, SIDE

Item = tuple[int, int, int]
"""Kind, segment or group (0 for a packet), symbol or index."""
RECENT = 8192
"""Datagrams that are remembered."""
LOOK_S, TILE_S = 2e-3, 1e-6
"""A view waits for its turn, which takes so long, and so long for each tile: some five times as long as ordering takes,
so that views take a fifth of a server's time at most."""
BETWEEN_S = 0.1
"""Between two views of one client; of those in between the newest counts."""


def look_of(view: View) -> Look:
    """Where somebody looks from, as the function has it that the page and the server share."""
    matrix = np.eye(4)
    matrix[:3] = np.array(view.viewmat).reshape(3, 4)
    return Look(matrix, view.focal, view.width, view.height)


class Turns:
    """When views are looked at: one after another, those of all clients."""

    def __init__(self) -> None:
        self._free_at = 0.0

    def take(self, now: float, last: float | None, tiles: int) -> float:
        """When a view with so many tiles has its turn, given when the client had its last one."""
        at = max(self._free_at, now if last is None else max(now, last + BETWEEN_S))
        self._free_at = at + LOOK_S + tiles * TILE_S
        return at


class Left:
    """Which packet left in which datagram, of those of late.

    Args:
        noted: Whether anybody asks by their numbers.
    """

    def __init__(self, noted: bool) -> None:
        self._places = array("I", bytes(4 * RECENT)) if noted else None

    def note(self, sequence: int, place: int) -> None:
        """Notes what leaves: the place of a packet, or -1."""
        if self._places is not None:
            self._places[sequence % RECENT] = place + 1

    def place(self, number: int, sequence: int) -> int:
        """The packet that is asked for as `Feedback` has it, before a number; -1 if none is known."""
        if not number & BY_SEQUENCE:
            return number
        asked = number - BY_SEQUENCE
        known = self._places is not None and sequence - RECENT <= asked < sequence
        return self._places[asked % RECENT] - 1 if known and self._places is not None else -1

    def answered(self, number: int) -> None:
        """Forgets what leaves again, in a datagram of another number."""
        if number & BY_SEQUENCE:
            self.note(number - BY_SEQUENCE, -1)


class Order:
    """What leaves next of a program.

    Args:
        program: What is sent.
        reliable: Whether the head object travels on a reliable stream, at once.

    Attributes:
        head_left: Whether the last symbol of the head object has just left.
        looked_at: When the client's view was last looked at; None before.
    """

    def __init__(self, program: Program, reliable: bool) -> None:
        self._program = program
        self._schedule = program.reliable_schedule if reliable else program.send_schedule
        self._next, self._passed = 0, program.carried
        self.head_left = False
        self._gone: np.ndarray | None = None
        self._wanted: deque[int] = deque()
        self._run: deque[int] = deque()
        self.looked_at: float | None = None

    @property
    def viewed(self) -> bool:
        """Whether somebody said where they look from."""
        return self.looked_at is not None

    def __bool__(self) -> bool:
        """Whether there is something left."""
        return bool(self._run or self._wanted) or self._next < self._end

    @property
    def _end(self) -> int:
        """How much of the schedule leaves: all, or what leaves before any view counts."""
        return self._schedule.opening_end if self.viewed else len(self._schedule.items)

    def pop(self) -> Item:
        """What leaves now."""
        if self._next < self._end:
            item = self._schedule.items[self._next]
            self._next += 1
            self._passed = item[2] + 1 if item[0] == DATA else self._passed
            self.head_left = self._next == self._schedule.head_end
            return item
        self.head_left = False
        if not self._run:
            tile = self._wanted.popleft()
            self._begin(tile)
        return DATA, 0, self._run.popleft()

    def look(self, look: Look, budget: int, now: float) -> None:
        """From here on, what this view wants comes first, and nothing else."""
        tiles = self._program.tiles
        assert tiles is not None
        if self._gone is None:
            self._passed = max(self._passed, self._program.opening_packets)
            self._gone = (tiles.first_packets[1:] <= self._passed) | (tiles.packets == 0)
            if not self._gone.all():  # one that the schedule has begun is finished first
                self._begin(int(np.argmin(self._gone)), if_begun=True)
        self.looked_at = now
        self._wanted = deque(cut_of(tiles, self._gone, look, budget).wanted)

    def _begin(self, tile: int, *, if_begun: bool = False) -> None:
        """Lets the packets of a tile leave that have not."""
        tiles = self._program.tiles
        assert tiles is not None
        assert self._gone is not None
        first, end = tiles.first_packets[tile : tile + 2].tolist()
        if if_begun and first >= self._passed:
            return
        self._gone[tile] = True
        self._run.extend(range(max(first, self._passed) if if_begun else first, end))

    def renew(self, program: Program, reliable: bool, told: Item, known: int) -> None:
        """Goes on with a program that has grown: its head object at once, then what is left, then what is new.

        Args:
            program: The program.
            reliable: Whether the head object travels on a reliable stream.
            told: What leaves before the head object, behind it and before what is new.
            known: Packets that it had before.
        """
        self._program = program
        source = (program.reliable_schedule if reliable else program.send_schedule).items
        head = [item for item in source if item[0] == SIDE]
        left = [item for item in self._schedule.items[self._next :] if known and program.wants(*item)]
        new = [] if known == len(program.packets) else [
            item for item in source if item[0] == PARITY or (item[0] == DATA and item[2] >= known)
        ]  # fmt: skip
        self._schedule, self._next = program.schedule_of((told, *head, told, *left, told, *new)), 0
