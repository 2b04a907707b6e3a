"""A lossy relay on loopback, for machines without netem.

python tests/transport/relay.py --server 4840 --port 4841 --loss 0.2 --burst 20 --delay 0.01 --duplicate 0.01
"""

import argparse
import asyncio
import random
import socket
from collections.abc import Callable


class Relay:
    """Forwards datagrams between clients and one server, with losses in both directions.

    Args:
        server_port: Port of the server on 127.0.0.1.
        down: Called for each datagram to a client; true loses it.
        up: The same for the other direction.
        delay_s: One-way delay, seconds; each datagram takes up to `jitter` times longer, so that many are reordered.
        duplicate: Share of duplicated datagrams.
        port: Port for clients; 0 lets the system choose.
        seed: Seed of the jitter.
    """

    def __init__(
        self,
        server_port: int,
        down: Callable[[], bool] = lambda: False,
        up: Callable[[], bool] = lambda: False,
        delay_s: float = 0.0,
        seed: int = 0,
        jitter: float = 0.2,
        duplicate: float = 0.0,
        port: int = 0,
    ) -> None:
        self._loop = asyncio.get_running_loop()
        self._down, self._up, self._delay = down, up, delay_s
        self._jitter, self._duplicate = jitter, duplicate
        self._rng = random.Random(seed)
        self._target = ("127.0.0.1", server_port)
        self._front = self._open()
        self._front.bind(("127.0.0.1", port))
        self._back: dict[tuple[str, int], socket.socket] = {}
        self.num_lost = self.num_passed = 0
        self._loop.add_reader(self._front, self._from_clients)

    @property
    def port(self) -> int:
        return int(self._front.getsockname()[1])

    def rebind(self) -> None:
        """Changes the clients' address towards the server, like a router after a timeout."""
        for sock in self._back.values():
            self._loop.remove_reader(sock)
            sock.close()
        self._back.clear()

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
        if self._duplicate and self._rng.random() < self._duplicate:
            self._later(send, data)
        self._later(send, data)

    def _later(self, send: Callable[[bytes], int], data: bytes) -> None:
        if not self._delay:
            self._send(send, data)
            return
        self._loop.call_later(self._delay * self._rng.uniform(1.0, 1.0 + self._jitter), self._send, send, data)

    def _send(self, send: Callable[[bytes], int], data: bytes) -> None:
        try:
            send(data)
        except OSError:  # full or closed: lost
            self.num_lost += 1


def main() -> None:
    parser = argparse.ArgumentParser(description="loses, delays, reorders and repeats datagrams of a server")
    parser.add_argument("--server", type=int, required=True, help="port of the server on 127.0.0.1")
    parser.add_argument("--port", type=int, default=0)
    parser.add_argument("--loss", type=float, default=0.2)
    parser.add_argument("--burst", type=float, default=1.0, help="mean datagrams of a loss")
    parser.add_argument("--back", type=float, default=0.0, help="loss on the way to the server")
    parser.add_argument("--delay", type=float, default=0.0, help="seconds each way")
    parser.add_argument("--jitter", type=float, default=0.2, help="times the delay")
    parser.add_argument("--duplicate", type=float, default=0.0)
    parser.add_argument("--seed", type=int, default=0)
    words = parser.parse_args()
    from network import bernoulli, bursts  # next to this file

    async def run() -> None:
        rng = random.Random(words.seed)
        down = bernoulli(words.loss, rng) if words.burst <= 1 else bursts(words.loss, words.burst, rng)
        relay = Relay(
            words.server, down, bernoulli(words.back, rng), words.delay, words.seed, words.jitter, words.duplicate,
            words.port,
        )  # fmt: skip
        print(relay.port, flush=True)
        await asyncio.Event().wait()

    asyncio.run(run())


if __name__ == "__main__":
    main()
