"""Receivers that follow a scene get its updates, and keep the last whole scene if one is lost."""

import asyncio
import errno
import random
from collections.abc import Coroutine
from typing import Any

import pytest

from codec.gaussians.test_gaussians import DATAGRAM, some_splats
from codec.update.test_chain import edits
from explicit import encode_splats
from splatwire.api.following import check_follows, follow, updates_after
from splatwire.bitstream import SceneStream, stream_to_bytes
from splatwire.bitstream.sections import sections_of
from splatwire.codec import apply_update, decode_stream, encode_update
from splatwire.codec.update.chain import UpdateChain
from splatwire.codec.update.section import SECTION, manifest_digest, read_update
from splatwire.errors import InvalidValueError, UnknownHostError
from splatwire.transport import Finished, Receiver, ReceiverOptions, ServedStream, make_served_stream
from splatwire.transport.address import Address
from splatwire.transport.running_server import RunningServer
from splatwire.transport.udp import UdpServer, receive_udp
from transport.network import bernoulli
from transport.relay import Relay

pytest.importorskip("raptorq", reason="the package raptorq is not installed")
BASE = encode_splats(some_splats(), DATAGRAM)
UPDATES = edits(BASE)


def run(work: Coroutine[Any, Any, Any]) -> Any:
    return asyncio.run(asyncio.wait_for(work, 240))


def states() -> list[UpdateChain]:
    chains = [UpdateChain(BASE, BASE)]
    for update in UPDATES:
        chains.append(chains[-1].extended(update))
    return chains


def publish(server: RunningServer, chain: UpdateChain) -> None:
    updates: dict[str, ServedStream | None] = {
        name: None if update is None else make_served_stream(update) for name, update in chain.offers().items()
    }
    server.publish({"room": make_served_stream(chain.scene)}, updates)


def fetcher(port: int) -> Any:
    async def fetch(name: str) -> Receiver:
        return await receive_udp(Address("127.0.0.1", port), ReceiverOptions(name=name))

    return fetch


def test_followers_get_each_state_over_lossy_datagrams() -> None:
    async def work() -> list[SceneStream]:
        server = RunningServer(UdpServer({}, "127.0.0.1", 0), {})
        relay = Relay(server.server.port, bernoulli(0.2, random.Random(1)), bernoulli(0.2, random.Random(2)))
        chains, found, warnings = iter(states()), [], []
        publish(server, next(chains))
        try:
            async for scene in follow(fetcher(relay.port), "room", warnings.append):
                found.append(scene)
                if len(found) == 4:
                    break
                publish(server, next(chains))
        finally:
            relay.close()
            server.server.close()
        assert not warnings
        return found

    assert [stream_to_bytes(scene) for scene in run(work())] == [stream_to_bytes(each.scene) for each in states()]


def test_the_next_update_is_announced_and_other_names_are_refused() -> None:
    async def work() -> None:
        server = RunningServer(UdpServer({}, "127.0.0.1", 0), {})
        first, second = states()[:2]
        publish(server, first)
        try:
            waiting = asyncio.ensure_future(fetcher(server.server.port)(next(iter(first.offers()))))
            await asyncio.sleep(0.6)
            assert not waiting.done()
            assert server.server.core.num_refused == 0
            publish(server, second)
            assert (await waiting).stream() == second.updates[-1]
            refused = await fetcher(server.server.port)("update.0123456789abcdef")
            assert refused.finished.reason == "no such stream"
            unnamed = await fetcher(server.server.port)("")
            assert unnamed.stream() == second.scene
        finally:
            server.server.close()

    run(work())


class Done(Receiver):
    """Finished receiver of a stream."""

    def __init__(self, reason: str, received: SceneStream | None) -> None:
        super().__init__(0, 0.0)
        self.finished, self._received_stream = Finished(reason, received is not None), received

    def stream(self) -> SceneStream | None:
        return self._received_stream


class Answers:
    """Stand-in for transfers: gives each request the next of some finished receivers."""

    def __init__(self, *answers: tuple[str, SceneStream | None]) -> None:
        self.answers, self.names = list(answers), []

    async def fetch(self, name: str) -> Done:
        self.names.append(name)
        reason, stream = self.answers.pop(0) if self.answers else ("stopped", None)
        return Done(reason, stream)


def followed(monkeypatch: pytest.MonkeyPatch, *answers: tuple[str, SceneStream | None]) -> tuple[Any, list[str], Any]:
    monkeypatch.setattr("splatwire.api.following.RETRY_S", 0.0)
    server, warnings = Answers(*answers), []

    async def work() -> list[SceneStream]:
        return [scene async for scene in follow(server.fetch, "room", warnings.append)]

    return run(work()), warnings, server.names


def test_a_lost_update_leaves_the_last_scene_and_is_requested_again(monkeypatch: pytest.MonkeyPatch) -> None:
    update = UPDATES[0]
    found, warnings, names = followed(
        monkeypatch, ("complete", BASE), ("the server fell silent", update.with_packets(update.packets[1:])),
        ("no answer", None), ("complete", update),
    )  # fmt: skip
    assert found == [BASE, apply_update(BASE, update)]
    assert [text.partition(" (")[0] for text in warnings] == ["an update did not arrive as a whole"] * 2
    assert names[1] == names[2] == names[3]


def test_a_receiver_that_missed_an_update_gets_the_whole_scene(monkeypatch: pytest.MonkeyPatch) -> None:
    newest = states()[-1].scene
    found, warnings, names = followed(
        monkeypatch, ("complete", BASE), ("no such stream", None), ("no answer", None), ("complete", newest)
    )
    assert found == [BASE, newest]
    assert "the server no longer has it" in warnings[0]
    assert "the last one remains" in warnings[1]
    assert names[2] == names[3] == "room"


def test_a_scene_without_updates_is_an_error_and_not_received_without_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """A server without `--updates` would otherwise send the same scene again and again."""
    missing = "no such stream", None
    with pytest.raises(ValueError, match="offers no updates"):
        followed(monkeypatch, *[("complete", BASE), missing] * 3)
    found, warnings, _ = followed(
        monkeypatch, ("complete", BASE), ("complete", UPDATES[0]), missing, ("complete", BASE), missing
    )
    assert (found, len(warnings)) == ([BASE, apply_update(BASE, UPDATES[0]), BASE], 2)


@pytest.mark.parametrize("wrong", [BASE, UPDATES[1]])
def test_streams_that_do_not_follow_are_not_applied(monkeypatch: pytest.MonkeyPatch, wrong: SceneStream) -> None:
    found, warnings, _ = followed(monkeypatch, ("complete", BASE), ("complete", wrong))
    assert found == [BASE]
    assert warnings[0].startswith("an update cannot be applied: the server sends")


def test_an_update_that_changes_nothing_is_not_requested_without_end() -> None:
    state = apply_update(BASE, encode_update(BASE, decode_stream(BASE).scene))
    update = encode_update(state, decode_stream(state).scene)
    digest = manifest_digest(state.manifest)
    assert read_update(sections_of(update)[SECTION]).result_digest == digest
    with pytest.raises(InvalidValueError, match="changes nothing"):
        check_follows(update, digest)


def test_a_scene_that_does_not_arrive_at_first_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ValueError, match="did not arrive as a whole: no answer"):
        followed(monkeypatch, ("no answer", None))


def test_a_follower_may_start_an_update_each_second() -> None:
    """Transfers of updates have a separate limit, since a follower starts one for each update."""

    async def work() -> None:
        chain = UpdateChain(BASE, BASE).extended(UPDATES[0])
        server = RunningServer(UdpServer({}, "127.0.0.1", 0), {})
        publish(server, chain)
        try:
            for _ in range(40):
                receiver = await fetcher(server.server.port)(next(iter(chain.offers())))
                assert receiver.finished.reason == "complete"
        finally:
            server.server.close()

    run(work())


def test_alternating_failures_are_warned_of_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("splatwire.api.following.RETRY_S", 0.0)
    no_route, no_answer = OSError(errno.ENETUNREACH, "Network is unreachable"), Done("no answer", None)
    answers = iter([Done("complete", BASE), *[no_route, no_answer] * 3, Done("stopped", None)])
    warnings = list[str]()

    async def fetch(name: str) -> Receiver:
        answer = next(answers)
        if isinstance(answer, Exception):
            raise answer
        return answer

    async def work() -> list[SceneStream]:
        return [scene async for scene in follow(fetch, "room", warnings.append)]

    assert len(run(work())) == 1
    assert [warning.split(" (")[0].split(":")[0] for warning in warnings] == [
        "no connection", "an update did not arrive as a whole"
    ]  # fmt: skip


def test_followers_wait_for_a_network_and_a_name_service(monkeypatch: pytest.MonkeyPatch) -> None:
    """Only the first connection must succeed."""
    monkeypatch.setattr("splatwire.api.following.RETRY_S", 0.0)
    no_route, no_name = OSError(errno.ENETUNREACH, "Network is unreachable"), UnknownHostError("the host is not known")
    answers = iter([
        Done("complete", BASE), no_route, no_name, Done("complete", UPDATES[0]), Done("no such stream", None), no_route,
        Done("stopped", None),
    ])  # fmt: skip
    warnings = list[str]()

    async def fetch(name: str) -> Receiver:
        answer = next(answers)
        if isinstance(answer, Exception):
            raise answer
        return answer

    async def work() -> list[SceneStream]:
        return [scene async for scene in follow(fetch, "room", warnings.append)]

    assert [stream_to_bytes(scene) for scene in run(work())] == [stream_to_bytes(each.scene) for each in states()[:2]]
    assert [warning.split(":")[0] for warning in warnings if "no connection" in warning] == ["no connection"] * 2
    answers = iter([no_route])
    with pytest.raises(OSError, match="unreachable"):
        run(work())


@pytest.mark.parametrize("error", [OSError(errno.EMFILE, "Too many open files"), InvalidValueError("wrong")])
def test_errors_that_waiting_does_not_end_are_raised(error: Exception) -> None:
    async def fetch(name: str) -> Receiver:
        raise error

    async def work() -> None:
        async for update in updates_after(fetch, manifest_digest(BASE.manifest), lambda text: None):
            raise AssertionError(update)

    with pytest.raises(type(error), match=str(error.args[-1])):
        run(work())


def test_backoff_grows_during_an_outage_and_restarts_after_it(monkeypatch: pytest.MonkeyPatch) -> None:
    outage, pauses, warnings = [OSError(errno.ENETDOWN, "Network is down")] * 5, list[float](), list[str]()
    answers = iter([*outage, Done("complete", UPDATES[0]), *outage, Done("no such stream", None)])

    async def fetch(name: str) -> Receiver:
        answer = next(answers)
        if isinstance(answer, Exception):
            raise answer
        return answer

    async def sleep(seconds: float) -> None:
        pauses.append(seconds)

    async def work() -> int:
        return len([update async for update in updates_after(fetch, manifest_digest(BASE.manifest), warnings.append)])

    monkeypatch.setattr("splatwire.api.following.asyncio.sleep", sleep)
    assert run(work()) == 1
    assert pauses == [1.0, 2.0, 4.0, 4.0, 4.0] * 2
    assert len(warnings) == 2


def test_a_receiver_that_was_stopped_before_needs_no_network() -> None:
    async def work() -> Receiver:
        stop = asyncio.get_running_loop().create_future()
        stop.cancel()
        return await receive_udp(Address("no-such-host.invalid", 1), ReceiverOptions(), stop=stop)

    assert run(work()).finished.reason == "stopped"


def test_an_outage_of_the_server_causes_one_warning(monkeypatch: pytest.MonkeyPatch) -> None:
    closed: list[tuple[str, SceneStream | None]] = [("nothing listens there", None)] * 5
    _, warnings, _ = followed(
        monkeypatch, ("complete", BASE), *closed, ("complete", UPDATES[0]), *closed, ("no answer", None)
    )
    reasons = [text.partition("(")[2].partition(")")[0] for text in warnings]
    assert reasons == ["nothing listens there", "nothing listens there", "no answer"]
