"""Little-endian byte writer and bounds-checked reader."""

import struct

from splatwire.errors import BitstreamError, TruncatedStreamError


class ByteWriter:
    """Writer of numbers and byte strings to a little-endian byte string."""

    def __init__(self) -> None:
        self._parts: list[bytes] = []

    def u8(self, value: int) -> None:
        """Appends an unsigned byte."""
        self._parts.append(struct.pack("<B", value))

    def f32(self, value: float) -> None:
        """Appends a float32."""
        self._parts.append(struct.pack("<f", value))

    def f64(self, value: float) -> None:
        """Appends a float64."""
        self._parts.append(struct.pack("<d", value))

    def unsigned(self, value: int) -> None:
        """Appends a non-negative integer as a varint: 7 bits per byte, low bits first."""
        while value > 127:
            self._parts.append(bytes([value & 127 | 128]))
            value >>= 7
        self._parts.append(bytes([value]))

    def signed(self, value: int) -> None:
        """Appends an integer as a zigzag varint."""
        self.unsigned(value * 2 if value >= 0 else -value * 2 - 1)

    def blob(self, data: bytes) -> None:
        """Appends bytes preceded by their length."""
        self.unsigned(len(data))
        self._parts.append(data)

    def bytes(self) -> bytes:
        """Returns all bytes appended so far."""
        return b"".join(self._parts)


class ByteReader:
    """Parser of bytes written by `ByteWriter`; checks that every read is within bounds.

    Args:
        data: The bytes.
        subject: Description of the data for error messages.
    """

    def __init__(self, data: bytes, subject: str) -> None:
        self._data = data
        self._at = 0
        self._subject = subject

    def take(self, size: int) -> bytes:
        """Reads and returns the next `size` bytes.

        Raises:
            TruncatedStreamError: If fewer bytes are left.
        """
        if size > len(self._data) - self._at:
            raise TruncatedStreamError(
                f"{self._subject}: {size} bytes expected at offset {self._at}, {len(self._data) - self._at} left"
            )
        self._at += size
        return self._data[self._at - size : self._at]

    def u8(self) -> int:
        """Reads an unsigned byte."""
        return self.take(1)[0]

    def f32(self) -> float:
        """Reads a float32."""
        return float(struct.unpack("<f", self.take(4))[0])

    def f64(self) -> float:
        """Reads a float64."""
        return float(struct.unpack("<d", self.take(8))[0])

    def unsigned(self) -> int:
        """Reads a non-negative varint of at most 53 bits."""
        value = 0
        for shift in range(0, 63, 7):
            byte = self.u8()
            value |= (byte & 127) << shift
            if byte < 128 and value >> 53:
                raise BitstreamError(f"{self._subject}: {value} is too large a number")
            if byte < 128:
                return value
        raise BitstreamError(f"{self._subject}: an integer at offset {self._at} does not end")

    def signed(self) -> int:
        """Reads a zigzag varint."""
        value = self.unsigned()
        return value >> 1 if value % 2 == 0 else -(value >> 1) - 1

    def blob(self) -> bytes:
        """Reads bytes preceded by their length."""
        return self.take(self.unsigned())

    def rest(self) -> bytes:
        """Reads all remaining bytes."""
        return self.take(len(self._data) - self._at)

    @property
    def left(self) -> int:
        """Number of remaining bytes."""
        return len(self._data) - self._at

    def finish(self) -> None:
        """Checks that no bytes remain.

        Raises:
            BitstreamError: If there are trailing bytes.
        """
        if self._at != len(self._data):
            raise BitstreamError(f"{self._subject}: {len(self._data) - self._at} unexpected bytes at the end")
