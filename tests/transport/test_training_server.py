"""Receivers follow a scene while it is trained."""

import asyncio
import os
import socket
import threading
import time
from collections.abc import AsyncGenerator
from contextlib import aclosing
from dataclasses import replace
from typing import Any
from urllib.request import urlopen

import numpy as np
import pytest

import splatwire
from codec.gaussians.test_gaussians import some_splats
from rate_control.test_partial_updates import trained
from splatwire.api.following import follow
from splatwire.api.offered_updates import OfferedUpdates
from splatwire.bitstream import SceneStream, stream_to_bytes
from splatwire.codec import decode_stream
from splatwire.codec.update.chain import UpdateChain
from splatwire.errors import InvalidValueError, SplatwireError
from splatwire.rate_control.partial_updates import PartialUpdates
from splatwire.transport import Receiver, ReceiverOptions, ServerLimits, make_served_stream
from splatwire.transport.address import Address
from splatwire.transport.running_server import RunningServer
from splatwire.transport.udp import receive_udp
from splatwire.types import SplatScene
from splatwire.types.splats import Splats

pytest.importorskip("raptorq", reason="the package raptorq is not installed")


def followed(port: int, warnings: list[str]) -> AsyncGenerator[SceneStream, None]:
    async def fetch(name: str) -> Receiver:
        return await receive_udp(Address("127.0.0.1", port), ReceiverOptions(name=name))

    return follow(fetch, "scene", warnings.append)


def states_of(*scenes: Splats) -> list[SceneStream]:
    states = [PartialUpdates.start(scenes[0])]
    for scene in scenes[1:]:
        states.append(states[-1].pushed(scene))
    return [state.chain.scene for state in states]


def splatwire_threads() -> list[str]:
    return [thread.name for thread in threading.enumerate() if thread.name.startswith("splatwire-")]


def test_receivers_get_the_changes_of_each_push() -> None:
    scenes, warnings = [some_splats(), trained(some_splats(), 1), trained(some_splats(), 2)], []

    async def work(server: splatwire.TrainingServer) -> list[SceneStream]:
        waiting, found = iter(scenes), []
        await asyncio.to_thread(server.push, **vars(next(waiting)), wait=True)
        async with aclosing(followed(server.port, warnings)) as received:
            async for scene in received:
                found.append(scene)
                if (following := next(waiting, None)) is None:
                    return found
                await asyncio.to_thread(server.push, **vars(following), wait=True)
        return found

    with splatwire.serve_training() as server:
        found = asyncio.run(asyncio.wait_for(work(server), 300))
        newest = asyncio.run(splatwire.receive(f"udp://127.0.0.1:{server.port}"))
    assert [stream_to_bytes(scene) for scene in found] == [stream_to_bytes(scene) for scene in states_of(*scenes)]
    assert newest == found[-1]
    assert not warnings
    assert not splatwire_threads()


def test_the_waiting_scene_is_replaced_by_a_newer_one(monkeypatch: pytest.MonkeyPatch) -> None:
    started, go_on = threading.Event(), threading.Event()
    start, encoded = PartialUpdates.start, []

    def slow(*arguments: Any) -> PartialUpdates:
        started.set()
        assert go_on.wait(240)
        return start(*arguments)

    def pushed(state: PartialUpdates, splats: Splats, share: float) -> PartialUpdates:
        encoded.append(float(splats.means[0, 0]))
        return state

    monkeypatch.setattr(PartialUpdates, "start", staticmethod(slow))
    monkeypatch.setattr(PartialUpdates, "pushed", pushed)
    arrays = {name: values.copy() for name, values in vars(some_splats()).items()}
    with splatwire.serve_training() as server:
        server.push(**arrays)
        assert started.wait(240)
        for number in range(3):
            arrays["means"][0, 0] = number
            server.push(**arrays)
        arrays["means"][0, 0] = 7  # a trainer changes its arrays in place
        go_on.set()
        arrays["means"][0, 0] = 9
        server.push(**arrays, wait=True)
    assert encoded in ([2.0, 9.0], [9.0])


@pytest.mark.needs_torch
def test_tensors_are_pushed_like_arrays() -> None:
    torch = pytest.importorskip("torch")
    splats = some_splats()
    with splatwire.serve_training() as server:
        server.push(
            **{name: torch.nn.Parameter(torch.tensor(values)) for name, values in vars(splats).items()}, wait=True
        )
        received = asyncio.run(splatwire.receive(f"udp://127.0.0.1:{server.port}/scene"))
    assert received == states_of(splats)[0]


@pytest.mark.parametrize(("wrong", "message"), [
    ({"means": np.zeros((3, 2), np.float32)}, r"means: expected an array \(G, 3\) of numbers"),
    ({"sh": "nonsense"}, "sh: expected an array"),
    ({"opacities": np.zeros(7, np.float32)}, "opacities: expected 500 rows, as in means, not 7"),
    ({"wait": 1}, "wait: expected"),
    ({name: values[:0] for name, values in vars(some_splats()).items()}, "at least one Gaussian"),
])  # fmt: skip
def test_wrong_arrays_are_one_error(wrong: dict[str, Any], message: str) -> None:
    with splatwire.serve_training() as server, pytest.raises(InvalidValueError, match=message):
        server.push(**{**vars(some_splats()), **wrong})


def test_gaussians_that_cannot_be_encoded_are_an_error_and_the_next_ones_are_served() -> None:
    splats = some_splats()
    with splatwire.serve_training() as server:
        with pytest.raises(SplatwireError, match=r"drawn|drawable|draws"):
            server.push(**vars(replace(splats, opacities=np.zeros_like(splats.opacities))), wait=True)
        server.push(**vars(splats), wait=True)
        assert asyncio.run(splatwire.receive(f"udp://127.0.0.1:{server.port}")) == states_of(splats)[0]


def test_gaussians_that_are_no_numbers_are_left_out() -> None:
    splats = some_splats()
    broken = {name: values.copy() for name, values in vars(splats).items()}
    for number, values in enumerate(broken.values()):
        values[7 * number : 7 * number + 3] = (np.nan, np.inf, -np.inf)[number % 3]
    with splatwire.serve_training() as server:
        server.push(**vars(splats), wait=True)
        server.push(**broken, wait=True, share=1.0)
        received = asyncio.run(splatwire.receive(f"udp://127.0.0.1:{server.port}"))
        assert received.manifest.num_elements == 485
        with pytest.raises(SplatwireError, match="no Gaussian can be drawn"):
            server.push(**{name: np.full_like(values, np.nan) for name, values in broken.items()}, wait=True)
        server.push(**vars(splats), wait=True, share=1.0)
        received = asyncio.run(splatwire.receive(f"udp://127.0.0.1:{server.port}"))
    assert received.manifest.num_elements == 500


def test_the_degree_may_change() -> None:
    splats = some_splats()
    with splatwire.serve_training() as server:
        for degree in (3, 0, 1):
            wider = np.zeros((500, (degree + 1) ** 2, 3), np.float32)
            wider[:, 0] = splats.sh[:, 0]
            server.push(**{**vars(splats), "sh": wider}, wait=True)
            received = asyncio.run(splatwire.receive(f"udp://127.0.0.1:{server.port}"))
            assert decode_stream(received).scene.splats.degree == degree


@pytest.mark.slow
def test_clients_have_the_last_state_after_drain() -> None:
    scenes, warnings = [some_splats(), trained(some_splats(), 1)], []

    async def work(server: splatwire.TrainingServer) -> list[SceneStream]:
        found = []
        await asyncio.to_thread(server.push, **vars(scenes[0]), wait=True)

        async def receive() -> None:
            async with aclosing(followed(server.port, warnings)) as received:
                async for scene in received:
                    found.append(scene)

        receiving = asyncio.ensure_future(receive())
        while not found:
            await asyncio.sleep(0.02)
        await asyncio.to_thread(server.push, **vars(scenes[1]), share=1.0)
        await asyncio.to_thread(server.drain, 30.0)
        server.close()
        receiving.cancel()
        return found

    with splatwire.serve_training() as server:
        found = asyncio.run(asyncio.wait_for(work(server), 300))
    expected = PartialUpdates.start(scenes[0]).pushed(scenes[1], 1.0).chain.scene
    assert stream_to_bytes(found[-1]) == stream_to_bytes(expected)


@pytest.mark.slow
def test_drain_ends_soon_without_clients() -> None:
    with splatwire.serve_training() as server:
        server.drain()
        server.push(**vars(some_splats()))
        began = time.monotonic()
        server.drain(3600.0)
        assert time.monotonic() - began < 600
        assert server.encoding_seconds > 0
        with pytest.raises(InvalidValueError, match="most_s: expected"):
            server.drain(float("nan"))


def test_a_server_that_cannot_publish_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    """The thread that encodes would otherwise wait for ever."""

    def fail(*arguments: Any) -> None:
        raise ZeroDivisionError("a fault")

    monkeypatch.setattr(RunningServer, "publish", fail)
    with splatwire.serve_training() as server, pytest.raises(ZeroDivisionError, match="a fault"):
        server.push(**vars(some_splats()), wait=True)
    assert not splatwire_threads()


@pytest.mark.parametrize("error", [ZeroDivisionError, SystemExit])
def test_a_server_that_cannot_be_opened_is_an_error(monkeypatch: pytest.MonkeyPatch, error: type) -> None:
    async def fail(*arguments: Any) -> None:
        raise error

    monkeypatch.setattr("splatwire.api.training._open_server", fail)
    with pytest.raises(error), splatwire.serve_training():
        pass
    assert not splatwire_threads()


def test_waiting_for_a_server_that_is_closed_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    started, go_on, raised = threading.Event(), threading.Event(), []
    start = PartialUpdates.start

    def slow(*arguments: Any) -> PartialUpdates:
        started.set()
        assert go_on.wait(240)
        return start(*arguments)

    def push() -> None:
        with pytest.raises(InvalidValueError) as error:
            server.push(**vars(some_splats()), wait=True)
        raised.append(str(error.value))

    monkeypatch.setattr(PartialUpdates, "start", staticmethod(slow))
    with splatwire.serve_training() as server:
        server.push(**vars(some_splats()))
        assert started.wait(240)
        waiting = threading.Thread(target=push)
        waiting.start()
        while server._waiting is None:
            time.sleep(0.01)
        closing = threading.Thread(target=server.close)
        closing.start()
        waiting.join(240)
        go_on.set()
        closing.join(240)
    assert raised == ["push: the server was closed before the Gaussians were encoded"]


def test_closing_ends_the_transfers_of_clients() -> None:
    limits = ServerLimits(fixed_rate=2000.0)

    async def work(server: splatwire.TrainingServer) -> None:
        async def fetch() -> Receiver:
            return await receive_udp(Address("127.0.0.1", server.port), ReceiverOptions(name="scene"))

        receiving = asyncio.ensure_future(fetch())
        while not server._opened.running.is_busy:
            await asyncio.sleep(0.02)
        await asyncio.to_thread(server.close)
        assert not receiving.done()
        receiving.cancel()

    with splatwire.serve_training(limits=limits) as server:
        server.push(**vars(some_splats()), wait=True)
        asyncio.run(asyncio.wait_for(work(server), 300))
    assert not splatwire_threads()


@pytest.mark.skipif(not hasattr(os, "fork"), reason="there is no fork")
@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
def test_a_forked_process_cannot_push_and_does_not_close() -> None:
    """Data loaders are forked and inherit the object, but not its threads."""
    splats = some_splats()
    with splatwire.serve_training() as server:
        server.push(**vars(splats), wait=True)
        if not (child := os.fork()):
            status = 1
            try:
                server.push(**vars(splats), wait=True)
            except InvalidValueError as error:
                status = 0 if "another process" in str(error) else 2
            finally:
                server.close()
                os._exit(status)
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
        server.push(**vars(trained(splats, 1)), wait=True)
        received = asyncio.run(splatwire.receive(f"udp://127.0.0.1:{server.port}"))
    assert received == states_of(splats, trained(splats, 1))[1]


@pytest.mark.parametrize("kind", ["port", "page"])
def test_a_port_that_is_taken_is_one_error(kind: str) -> None:
    if kind == "page":
        pytest.importorskip("aioquic", reason="the package aioquic is not installed")
    with socket.socket(type=socket.SOCK_DGRAM if kind == "port" else socket.SOCK_STREAM) as taken:
        taken.bind(("127.0.0.1", 0))
        if kind == "page":
            taken.listen()
        number = taken.getsockname()[1]
        with pytest.raises(InvalidValueError, match=str(number)), splatwire.serve_training(**{kind: number}):
            pass
    assert not splatwire_threads()


def test_closing_ends_the_threads_and_refuses_more() -> None:
    with splatwire.serve_training() as server:
        assert len(splatwire_threads()) == 2
    assert not splatwire_threads()
    server.close()
    with pytest.raises(InvalidValueError, match="the server is closed"):
        server.push(**vars(some_splats()))


@pytest.mark.parametrize(("options", "message"), [
    ({"share": 0.0}, "share: expected a number above 0, at most 1"), ({"share": float("nan")}, "share: expected"),
    ({"port": 70_000}, "port: expected"),
    ({"page": -1}, "page: expected"), ({"origin": (0.0, 0.0, 1e13)}, "origin"),
    ({"background": (2.0, 0.0, 0.0)}, "background"), ({"host": "192.0.2.1"}, "listen"),
])  # fmt: skip
def test_wrong_settings_are_one_error(options: dict[str, Any], message: str) -> None:
    with pytest.raises(InvalidValueError, match=message), splatwire.serve_training(**options):
        pass
    assert not splatwire_threads()


def test_the_page_offers_the_updates() -> None:
    pytest.importorskip("aioquic", reason="the package aioquic is not installed")
    scenes = some_splats(), trained(some_splats(), 1)
    with splatwire.serve_training(page=0) as server:
        for scene in scenes:
            server.push(**vars(scene), wait=True)
        url = server.facts["page"]
        with urlopen(url) as answer:
            page = answer.read().decode()
        chain = PartialUpdates.start(scenes[0]).pushed(scenes[1]).chain
        (name, update), _ = chain.offers().items()
        with urlopen(f"{url}streams/{name}.swz") as answer:
            received = splatwire.bitstream.stream_from_bytes(answer.read())[0]
    assert 'updates=""' in page
    assert received.manifest == update.manifest


def test_a_scene_that_returns_to_an_earlier_state_offers_its_newest_update() -> None:
    first, second, third = (SplatScene(trained(some_splats(), seed)) for seed in range(3))
    stream, updates = splatwire.encode_scene(first, "datagram"), OfferedUpdates(make_served_stream)
    chain, served = UpdateChain(stream, stream), {}
    finest = int(splatwire.decode_stream(stream).scene.coding.precision_classes.max())
    for scene in (second, first, third):
        chain = chain.edited(scene, finest)
        served = updates.prepared(chain.offers())
        assert {name: one is None for name, one in served.items()} == {
            name: one is None for name, one in chain.offers().items()
        }
    for name, update in chain.offers().items():
        assert update is None or served[name].stream_id == update.manifest.stream_id
