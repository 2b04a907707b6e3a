"""A lossy relay on loopback: what netem does, where netem is not to be had."""

import asyncio
import random
import socket
from collections.abc import Callable


class Relay:
    """Passes datagrams between clients and one server, and loses some on the way to the clients and back.

    Args:
        server_port: Where the server is, on 127.0.0.1.
        down: Called for each datagram to a client; true loses it.
        up: The same for the other direction.
        delay_s: One-way delay, seconds.
        seed: Seed of the jitter.
    """

    def __init__(
        self,
        server_port: int,
        down: Callable[[], bool] = lambda: False,
        up: Callable[[], bool] = lambda: False,
        delay_s: float = 0.0,
        seed: int = 0,
    ) -> None:
        self._loop = asyncio.get_running_loop()
        self._down, self._up, self._delay = down, up, delay_s
        self._rng = random.Random(seed)
        self._target = ("127.0.0.1", server_port)
        self._front = self._open()
        self._front.bind(("127.0.0.1", 0))
        self._back: dict[tuple[str, int], socket.socket] = {}
        self.num_lost = self.num_passed = 0
        self._loop.add_reader(self._front, self._from_clients)

    @property
    def port(self) -> int:
        return int(self._front.getsockname()[1])

    def close(self) -> None:
        for sock in (self._front, *self._back.values()):
            self._loop.remove_reader(sock)
            sock.close()

    def _open(self) -> socket.socket:
        sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        sock.setblocking(False)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
        return sock

    def _from_clients(self) -> None:
        for _ in range(64):
            try:
                data, client = self._front.recvfrom(2048)
            except OSError:
                return
            if client not in self._back:
                back = self._back[client] = self._open()
                back.connect(self._target)
                self._loop.add_reader(back, self._from_server, back, client)
            self._pass(self._up, self._back[client].send, data)

    def _from_server(self, back: socket.socket, client: tuple[str, int]) -> None:
        for _ in range(64):
            try:
                data = back.recv(2048)
            except OSError:
                return
            self._pass(self._down, lambda data: self._front.sendto(data, client), data)

    def _pass(self, lost: Callable[[], bool], send: Callable[[bytes], int], data: bytes) -> None:
        if lost():
            self.num_lost += 1
            return
        self.num_passed += 1
        if not self._delay:
            self._send(send, data)
            return
        self._loop.call_later(self._delay * self._rng.uniform(1.0, 1.2), self._send, send, data)

    def _send(self, send: Callable[[bytes], int], data: bytes) -> None:
        try:
            send(data)
        except OSError:  # full or closed: lost
            self.num_lost += 1
