"""What the viewer shows is what the library makes of the same losses; no browser here."""

import dataclasses
import math

import pytest
import torch

from scenes import tiny_cameras, tiny_causal_scene, tiny_scene
from splatwire.channel import Bernoulli, GilbertElliott, parse_loss, transmit
from splatwire.codec import decode_stream, encode_scene
from splatwire.conceal import conceal
from splatwire.errors import DesyncError, InvalidValueError, UnknownNameError
from splatwire.metrics import psnr
from splatwire.packets import PacketIntake, Packetization, SceneStream, send_sequence
from splatwire.render import render_scene
from splatwire.transport import PacketArrived, SideInfoArrived
from splatwire.view import ProgressiveScene, plan_transfer
from splatwire.view.model import Settings, Viewer, heat
from splatwire.view.sources import FileSource, LiveSource
from web.sketched import with_sketch


@pytest.fixture(scope="module")
def stream() -> SceneStream:
    packetization = Packetization(block_size=200, lanes=1, grouping="hashed", packet_bytes=700)
    return encode_scene(tiny_scene(seed=2, num_anchors=400), packetization)


@pytest.fixture(scope="module")
def viewer(stream) -> Viewer:
    return Viewer(FileSource(stream))


CAMERA = tiny_cameras(num_views=1, width=48, height=32)
CHOICES = [
    Settings(), Settings(loss=0.5, seed=3), Settings(loss=0.3, burst=4.0, concealer="idw"), Settings(progress=0.4),
    Settings(progress=0.6), Settings(progress=0.2, concealer="drop"), Settings(loss=0.0), Settings(progress=0.0),
]  # fmt: skip


def arrived(stream: SceneStream, settings: Settings) -> SceneStream:
    transfer = plan_transfer(stream, settings.loss_model(), seed=settings.seed)
    return stream.with_packets(transfer.upto(settings.progress))


@pytest.mark.parametrize("make", [tiny_scene, tiny_causal_scene])
def test_what_a_stream_carries_for_concealers_is_offered_and_used(viewer, make):
    sketched = with_sketch(encode_scene(make(seed=2, num_anchors=400), Packetization(block_size=100)))
    source, settings = FileSource(sketched), Settings(loss=0.5, concealer="sketch")
    assert "sketch" in source.progressive.concealers
    assert "sketch" not in viewer.source.progressive.concealers
    frame = Viewer(source).frame(settings, CAMERA, score=False)
    partial = decode_stream(arrived(sketched, settings))
    pictures = [render_scene(conceal(partial, name), CAMERA)[0] for name in ("sketch", "grow")]
    assert torch.equal(frame.image, (pictures[0] * 255).round().to(torch.uint8))
    assert not torch.equal(pictures[0], pictures[1])
    live = ProgressiveScene(sketched.manifest, sketched.side_info)
    assert live.concealers == source.progressive.concealers


def test_pictures_are_those_of_decoding_and_concealing_what_arrived(stream, viewer):
    """In any order of choices: what one leaves behind must not be seen in the next."""
    truth = render_scene(decode_stream(stream).scene, CAMERA)
    for settings in [*CHOICES, *reversed(CHOICES)]:
        frame = viewer.frame(settings, CAMERA)
        there = arrived(stream, settings)
        expected = render_scene(conceal(decode_stream(there), settings.concealer), CAMERA)
        assert torch.equal(frame.image, (expected[0] * 255).round().to(torch.uint8)), settings
        quality = float(psnr(expected, truth)[0])
        assert frame.status.psnr == pytest.approx(quality, abs=1e-3) or math.isinf(quality)
        assert frame.status.packets_received == len(there.packets)
        assert frame.status.known == sum(packet.num_anchors for packet in there.packets)


def test_without_loss_the_picture_is_the_reference(viewer):
    frame = viewer.frame(Settings(loss=0.0), CAMERA)
    assert frame.status.psnr == math.inf
    assert frame.status.known == frame.status.total
    reference = viewer.frame(Settings(loss=0.7, layer="lossless"), CAMERA)
    assert torch.equal(reference.image, frame.image)
    dark = viewer.frame(Settings(loss=0.0, layer="difference"), CAMERA)
    assert torch.equal(dark.image, (heat(torch.zeros(32, 48)) * 255).round().to(torch.uint8))


def test_what_is_behind_a_scene_is_behind_its_lossless_picture():
    scene = dataclasses.replace(tiny_scene(seed=2, num_anchors=100), background=(1.0, 1.0, 1.0))
    viewer = Viewer(FileSource(encode_scene(scene)))
    frame = viewer.frame(Settings(loss=0.0), CAMERA)
    assert frame.status.psnr == math.inf
    assert (frame.image[0, 0] == 255).all()
    assert torch.equal(viewer.frame(Settings(layer="lossless"), CAMERA).image, frame.image)
    lossy = viewer.frame(Settings(loss=0.5), CAMERA)
    assert 10 < lossy.status.psnr < math.inf


def test_heat_maps_show_damage(viewer):
    assert viewer.frame(Settings(loss=0.9, concealer="drop", layer="difference"), CAMERA).image.float().mean() > 0


def test_scores_are_left_out_while_moving(viewer):
    assert viewer.frame(Settings(), CAMERA, score=False).status.psnr is None


def test_what_makes_no_sense_is_refused(viewer):
    with pytest.raises(InvalidValueError, match="difference"):
        viewer.frame(Settings(layer="depth"), CAMERA)
    with pytest.raises(UnknownNameError):
        viewer.frame(Settings(concealer="magic"), CAMERA)
    with pytest.raises(InvalidValueError):
        viewer.frame(Settings(seed=-1), CAMERA)
    with pytest.raises(InvalidValueError):
        viewer.frame(Settings(loss=1.5), CAMERA)


def test_a_file_with_gaps_says_so(stream):
    viewer = Viewer(FileSource(stream.with_packets(stream.packets[3:])))
    status = viewer.frame(Settings(loss=0.0), CAMERA).status
    assert "lacks 3 packets" in status.note
    assert status.known < status.total


def test_settings_name_a_loss_model():
    assert Settings(loss=0.1).loss_model() == Bernoulli(0.1)
    assert Settings(loss=0.1, burst=5.0).loss_model() == GilbertElliott(0.1, 5.0)
    assert Settings(loss=0.9, burst=2.0).loss_model().mean_burst == pytest.approx(9.0)


def test_a_transfer_loses_what_the_channel_loses(stream):
    """The same seed, model and order as `transmit`."""
    loss = parse_loss("bernoulli:0.3")
    transfer, (received, _) = plan_transfer(stream, loss, seed=5), transmit(stream, loss, seed=5)
    assert stream.with_packets(transfer.upto(1.0)) == received
    assert transfer.upto(0.0) == ()
    counts = [len(transfer.upto(share / 20)) for share in range(21)]
    assert counts == sorted(counts)
    head = stream.parts()["manifest"] + stream.parts()["side_info"]
    assert transfer.moment(0.0)[0] == head
    assert transfer.num_bytes == head + sum(packet.num_bytes for packet in stream.packets)
    assert transfer.moment(1.0) == (transfer.num_bytes, pytest.approx(transfer.num_bytes / 1_250_000))
    with pytest.raises(InvalidValueError):
        plan_transfer(stream, loss, seed=0, bytes_per_second=0)


def test_important_tiers_are_sent_first():
    scene = tiny_scene(seed=2, num_anchors=400)
    tiers = (torch.rand(400, generator=torch.Generator().manual_seed(0)) > 0.2).to(torch.uint8)
    stream = encode_scene(scene, Packetization(block_size=100, lanes=4), tiers=tiers)
    order = [stream.manifest.plan.tier_of(packet.id.block) for packet in send_sequence(stream, "tiers")]
    assert order == sorted(order)
    assert len(set(order)) == 2


def test_a_live_source_shows_what_was_handed_over(stream):
    source, intake = LiveSource(), PacketIntake(stream.manifest)
    source.take(SideInfoArrived(stream.manifest, stream.side_info, intake), 0.1)
    assert source.advance()
    viewer, settings = Viewer(source), Settings(concealer="grow")
    for number in (0, 4, len(stream.packets)):
        for packet in reversed(stream.packets[:number]):  # early ones are told again
            intake.take(packet, "test")
            source.take(PacketArrived(packet, False), 0.2)
        assert source.advance() == (number > 0)
        frame = viewer.frame(settings, CAMERA)
        assert not source.advance()
        partial = decode_stream(stream.with_packets(stream.packets[:number]))
        expected = render_scene(conceal(partial, "grow"), CAMERA)[0]
        assert torch.equal(frame.image, (expected * 255).round().to(torch.uint8))
        assert frame.status.packets_received == number
        assert frame.status.psnr is None


def test_a_progressive_scene_shows_some_of_what_arrived(stream):
    scene = ProgressiveScene(stream.manifest, stream.side_info, "grow")
    scene.add(stream.packets)
    for packets in (stream.packets[:5], stream.packets[3:], (), stream.packets):
        scene.show(packets)
        expected = conceal(decode_stream(stream.with_packets(packets)), "grow")
        with scene.reading() as current:
            assert torch.equal(current.anchors.features, expected.anchors.features)
        assert scene.num_known == sum(packet.num_anchors for packet in packets)


def test_what_passed_a_receivers_intake_passes_no_second_one(stream):
    intake = PacketIntake(stream.manifest)
    for packet in stream.packets:
        intake.take(packet, "test")
    scene = ProgressiveScene(stream.manifest, stream.side_info, "drop", intake=intake)
    assert scene.add(stream.packets) == stream.manifest.num_anchors
    assert intake.report().num_duplicate == 0
    assert scene.add(stream.packets[:2]) == 0
    assert scene.decoder.report.num_duplicate == intake.report().num_duplicate == 2


def test_a_progressive_scene_changes_its_concealer_midway(stream):
    scene = ProgressiveScene(stream.manifest, stream.side_info, "drop")
    assert scene.add(stream.packets[:5]) == scene.num_known > 0
    for name in ("idw", "grow", "cari"):
        scene.conceal_with(name)
        with scene.reading() as current:
            expected = conceal(decode_stream(stream.with_packets(stream.packets[:5])), name)
            assert torch.equal(current.anchors.features, expected.anchors.features)
    assert not scene.incremental
    scene.add(stream.packets)
    assert scene.complete


def test_a_scene_that_decodes_wrongly_says_so_once_and_goes_on(stream):
    wrong = dataclasses.replace(stream.manifest, symbols_digest="0" * 64)
    scene = ProgressiveScene(wrong, stream.side_info, "grow")
    with pytest.raises(DesyncError):
        scene.add(stream.packets)
    with scene.reading() as current:
        assert torch.equal(current.anchors.features, decode_stream(stream).scene.anchors.features)
    assert scene.add(stream.packets) == 0
