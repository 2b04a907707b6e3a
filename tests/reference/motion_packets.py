"""A packet of motion in plain Python, from its bytes and the bases of its tracks, following docs/format.md."""

from fractions import Fraction

from reference.gaussian_bits import ReferenceBits

KINDS = (0, 0, 0, 1, 1, 1, 2, 2, 2, 3, 4, 4, 4)
DEGREE_CONTEXTS, NEIGHBOUR_CONTEXTS, OCTAVE_CONTEXTS = 8, 10, 16
ZERO, OCTAVE = 8, 8 + 5 * DEGREE_CONTEXTS * NEIGHBOUR_CONTEXTS
LARGEST = 1 << 36


class ReferenceMotion(ReferenceBits):
    """Reads one packet.

    Args:
        payload: Its payload.
        zeros: Initial P(0) of each adaptive model, out of 2**8.
        count: Tracks that it has.
        frames: Frames of the group.
        first_new: First track that starts in the group.
    """

    def __init__(self, payload: bytes, zeros: list[int], count: int, frames: int, first_new: int) -> None:
        super().__init__(payload, [zero << 8 for zero in zeros])
        self.count, self.frames, self.first_new = count, frames, first_new

    def decode(self) -> tuple[list[list[int]], list[list[list[int]]]]:
        """Headers (track, state, first frame, frame after, ended tracks before and after), and residuals by channel."""
        headers = self.headers()
        orders = [self.below(self.frames + 1) for _ in range(5)]
        residuals = [[[0] * self.frames for _ in KINDS] for _ in headers]
        before: list[list[int]] | None = None
        for head, own in zip(headers, residuals, strict=True):
            if head[1]:
                self.track(orders, own, before)
                before = own
        return headers, residuals

    def headers(self) -> list[list[int]]:
        """Decodes the headers of all tracks of the packet."""
        first, lead = self.raw(28), self.gamma()
        span, tail = self.raw(13), self.gamma()
        headers: list[list[int]] = []
        gone = moved = 0
        before = first - lead
        for track in range(first, first + min(span, 4096)):
            gone = self.bit(gone)
            if gone:
                continue
            if len(headers) == self.count:
                break
            state = self.bit(2 + moved)
            moved = (moved << 1 | state) & 3
            begins = self.below(self.frames) if track >= self.first_new and self.bit(7) else 0
            ends = self.below(self.frames) if self.bit(6) else self.frames
            headers.append([track, state, begins, ends, track - before, 0])
            before = track + 1
        if headers:
            headers[-1][5] = tail
        return headers

    def track(self, orders: list[int], out: list[list[int]], before: list[list[int]] | None) -> None:
        """Decodes the residuals of one track."""
        largest = 0
        for channel, kind in enumerate(KINDS):
            first = channel == 0 or KINDS[channel - 1] != kind
            own = 0
            if first:
                largest, own = 0, abs(before[channel][0]) if before else 0
            for order in range(orders[kind]):
                near = max(own, largest)
                if not first:
                    near = max(near, 2 * abs(out[channel - 1][order]))
                value = self.coefficient(kind, order, min(near.bit_length(), NEIGHBOUR_CONTEXTS - 1))
                out[channel][order] = value
                own = abs(value) if order == 0 and first else max(own, abs(value))
            largest = max(largest, own)

    def coefficient(self, kind: int, order: int, level: int) -> int:
        """Decodes one residual."""
        if not self.bit(ZERO + (kind * DEGREE_CONTEXTS + min(order, DEGREE_CONTEXTS - 1)) * NEIGHBOUR_CONTEXTS + level):
            return 0
        octave = 0
        while octave < 29 and self.bit(
            OCTAVE + (kind * NEIGHBOUR_CONTEXTS + level) * OCTAVE_CONTEXTS + min(octave, OCTAVE_CONTEXTS - 1)
        ):
            octave += 1
        magnitude = min((1 << octave) + self.raw(octave), (1 << 30) - 1)
        return -magnitude if self.raw(1) else magnitude


def coefficients(
    places: list[list[int]], states: list[int], shifts: list[list[int]], residuals: list[list[list[int]]]
) -> list[list[list[int]]]:
    """Motion coefficients of a packet's tracks, from residuals and the coefficients known from their keyframes."""
    near = _shrunk(places)
    used = [0] * 5
    for own in residuals:
        for channel, kind in enumerate(KINDS):
            used[kind] = max([used[kind], *(k + 1 for k, value in enumerate(own[channel]) if value)])
    out = [[[0] * len(own[0]) for _ in KINDS] for own in residuals]
    known = [i for i, state in enumerate(states) if not state]
    for i in _order(near, [i for i, state in enumerate(states) if state], shifts):
        by_distance = sorted(
            (sum((p - q) ** 2 for p, q in zip(near[j], near[i], strict=True)), n) for n, j in enumerate(known)
        )
        found = [(d, known[n]) for d, n in by_distance[:8]]
        weights = _weights(near, i, found)
        for channel, kind in enumerate(KINDS):
            for k in range(used[kind]):
                mean = sum(w * out[j][channel][k] for w, (_, j) in zip(weights, found, strict=True))
                value = ((mean + (1 << 11)) >> 12) + (residuals[i][channel][k] << shifts[i][channel])
                out[i][channel][k] = min(max(value, -LARGEST), LARGEST)
        known.append(i)
    return out


def _square(here: list[int], there: list[int]) -> int:
    return sum((p - q) ** 2 for p, q in zip(here, there, strict=True))


def _shrunk(places: list[list[int]]) -> list[list[int]]:
    low = [min(axis) for axis in zip(*places, strict=True)]
    moved = [[p - q for p, q in zip(place, low, strict=True)] for place in places]
    shift = max(max(map(max, moved)).bit_length() - 20, 0)
    return [[p >> shift for p in place] for place in moved]


def _order(near: list[list[int]], moving: list[int], shifts: list[list[int]]) -> list[int]:
    def code(place: list[int]) -> int:
        return sum((place[a] >> (10 + bit) & 1) << (3 * bit + a) for bit in range(10) for a in range(3))

    curve = sorted(moving, key=lambda i: code(near[i]))
    bits = max(len(moving) - 1, 0).bit_length()
    slots = [int(format(slot, f"0{bits}b")[::-1], 2) if bits else 0 for slot in range(1 << bits)]
    strided = [curve[slot] for slot in slots if slot < len(curve)]
    return sorted(strided, key=lambda i: (shifts[i][0] + shifts[i][3]) >> 1)


def _weights(near: list[list[int]], i: int, found: list[tuple[int, int]]) -> list[int]:
    if not found:
        return []
    weights = [4096 // len(found)] * len(found)
    if len(found) >= 4:
        weights = _plane(near, i, found)
    weights[0] += 4096 - sum(weights)
    return weights


def _plane(near: list[list[int]], i: int, found: list[tuple[int, int]]) -> list[int]:
    radius = max(1, *(abs(near[j][a] - near[i][a]) for _, j in found for a in range(3)))
    close = [1 + 2 * (found[0][0] + 1) // (d + 1) for d, _ in found]
    offsets = [[(near[j][a] - near[i][a]) * 1024 // radius for a in range(3)] for _, j in found]
    total = sum(close)
    first = [sum(w * o[a] for w, o in zip(close, offsets, strict=True)) for a in range(3)]

    def second(a: int, b: int) -> int:
        return total * sum(w * o[a] * o[b] for w, o in zip(close, offsets, strict=True)) - first[a] * first[b]

    trace = sum(second(a, a) for a in range(3))
    spread = max(trace.bit_length() - 16, 0)
    ridge = (trace >> (spread + 14)) + 4
    m = [[(second(a, b) >> spread) + (ridge if a == b else 0) for b in range(3)] for a in range(3)]
    adjugate = [
        [
            m[(b + 1) % 3][(a + 1) % 3] * m[(b + 2) % 3][(a + 2) % 3]
            - m[(b + 1) % 3][(a + 2) % 3] * m[(b + 2) % 3][(a + 1) % 3]
            for b in range(3)
        ]
        for a in range(3)
    ]
    determinant = max(sum(m[0][b] * adjugate[b][0] for b in range(3)), 1)
    pulls = [sum(adjugate[a][b] * first[b] for b in range(3)) for a in range(3)]
    pull = max(max(abs(p) for p in pulls).bit_length() - 33, 0)
    pulls = [p >> pull for p in pulls]
    weights = []
    for w, o in zip(close, offsets, strict=True):
        moment = sum(h * (total * p - q) for h, p, q in zip(pulls, o, first, strict=True))
        exact = Fraction(moment, determinant) * Fraction(2) ** (20 + pull - spread) + Fraction(1, 2)
        share = w * ((1 << 20) - exact.numerator // exact.denominator) // (total << 8)
        weights.append(min(max(share, -4096), 4096))
    return weights
