import asyncio
import os
import signal

import pytest

from splatwire.cli._loop_signals import LoopSignals


@pytest.fixture
def earlier_actions():
    found = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, action in found.items():
        signal.signal(number, action)


def test_signals_reach_the_callback_until_their_earlier_actions_are_restored(earlier_actions):
    def earlier(number, frame):
        raise AssertionError("not called while the loop handles the signal")

    async def receive():
        received = asyncio.Queue()
        signals = LoopSignals(received.put_nowait)
        os.kill(os.getpid(), signal.SIGTERM)
        assert await received.get() == signal.SIGTERM
        signals.restore(signal.SIGTERM)
        signals.restore(signal.SIGTERM)
        signals.restore()

    signal.signal(signal.SIGTERM, earlier)
    asyncio.run(receive())
    assert signal.getsignal(signal.SIGTERM) is earlier


def test_ignored_signals_stay_ignored_and_can_be_restored(earlier_actions):
    async def receive():
        signals = LoopSignals(lambda number: None)
        assert signal.getsignal(signal.SIGINT) == signal.SIG_IGN
        signals.restore(signal.SIGINT)
        signals.restore()

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    asyncio.run(receive())
    assert signal.getsignal(signal.SIGINT) == signal.SIG_IGN
