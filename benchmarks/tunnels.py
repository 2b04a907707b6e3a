"""Two network namespaces, connected by a link that a process implements."""

import contextlib
import fcntl
import os
import struct
import subprocess
from collections.abc import Iterator, Mapping

TUNSETIFF, IFF_TUN_WITHOUT_HEADER = 0x400454CA, 0x1001


def shell(*words: str) -> None:
    subprocess.run(words, check=True, stdout=subprocess.DEVNULL, timeout=30)


@contextlib.contextmanager
def ends(spaces: Mapping[str, str]) -> Iterator[list[int]]:
    """Namespaces with these addresses, by name, each with a TUN device that this process opens."""
    with contextlib.ExitStack() as stack:
        files = []
        for space, address in spaces.items():
            shell("ip", "netns", "add", space)
            stack.callback(shell, "ip", "netns", "del", space)
            files.append(os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK))
            stack.callback(os.close, files[-1])
            fcntl.ioctl(files[-1], TUNSETIFF, struct.pack("16sH", space.encode(), IFF_TUN_WITHOUT_HEADER))
            shell("ip", "link", "set", space, "netns", space)
            for words in (["addr", "add", f"{address}/24", "dev", space], ["link", "set", space, "up"]):
                shell("ip", "-n", space, *words)
        yield files
