"""Simulated losses in training equal those of the channel, and renders equal those of a receiver."""

import dataclasses
import itertools
from pathlib import Path

import numpy as np
import pytest
import torch

from concealment.gaps import changed
from reference.float_prior import evaluate_prior
from scenes import SMALL_CAUSAL, SMALL_CONFIG
from splatwire.bitstream import HEADER_BYTES, PRESETS, Packetization, PacketPlan
from splatwire.channel import LossModel, draw_mask, parse_loss
from splatwire.codec import decode_stream, encode_scene
from splatwire.codec.geometry import anchor_order
from splatwire.concealment import Grow
from splatwire.data import Dataset
from splatwire.errors import InvalidValueError, UnknownNameError
from splatwire.neural.model.tensors import to_tensors
from splatwire.neural.training.checkpoint import load_checkpoint, save_checkpoint
from splatwire.neural.training.config import PacketLossConfig, TrainConfig
from splatwire.neural.training.context import AnchorCache, SampleBits
from splatwire.neural.training.export import export_scene
from splatwire.neural.training.hacpp import TrainableHacpp
from splatwire.neural.training.initial import initial_state
from splatwire.neural.training.kernels import COMPILED
from splatwire.neural.training.packet_loss import PacketLossSimulator, ReceivedAnchors, packet_of_rank
from splatwire.neural.training.photometric_loss import prepare_photo
from splatwire.neural.training.presets import create_config
from splatwire.neural.training.state import TrainState
from splatwire.neural.training.step import TrainingStep
from splatwire.ops.arrays import to_arrays
from splatwire.types import CausalConfig, HacppConfig

pytestmark = pytest.mark.slow

PACKETS = Packetization(block_size=50, lanes=4)


def _lossy(config: TrainConfig, *models: str, share: float = 0.5) -> TrainConfig:
    return dataclasses.replace(config, packet_loss=PacketLossConfig(models, lossy_share=share))


def _losses(config: TrainConfig) -> PacketLossSimulator:
    return PacketLossSimulator(config, TrainableHacpp(config, COMPILED, AnchorCache(config)), AnchorCache(config))


@pytest.fixture(scope="module")
def grown(dataset: Dataset, config: TrainConfig, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Checkpoint of a run after growth, with a fixed set of anchors."""
    state, step = initial_state(dataset, config), TrainingStep(config, dataset.cameras)
    photos = [prepare_photo(torch.from_numpy(dataset.image(view))) for view in range(4)]
    for i in range(config.milestones.growth_end):
        step(state, i % 4, photos[i % 4])
    path: Path = tmp_path_factory.mktemp("grown") / "run.checkpoint"
    save_checkpoint(state, config, path)
    return path


@pytest.fixture
def state(grown: Path) -> TrainState:
    """The state one iteration later."""
    state = load_checkpoint(grown)[0]
    state.iteration += 1
    return state


@pytest.mark.parametrize("model", ["bernoulli:0.3", "gilbert:0.4,6"])
def test_training_losses_and_growth_equal_those_of_a_receiver(
    model: str, state: TrainState, config: TrainConfig
) -> None:
    loss_model = parse_loss(model)
    scene = export_scene(state, config)
    stream = encode_scene(scene, PACKETS)
    assert stream.manifest.num_elements == state.num_anchors
    received = decode_stream(draw_mask(stream, loss_model, seed=7).apply(stream))
    context = received  # except for its rounded weights
    positions = torch.from_numpy(context.scene.anchors.positions)
    exact = evaluate_prior(to_tensors(scene.coding.context_model), positions, scene.coding.config)
    expected = Grow()(changed(context, prior=to_arrays(exact)))
    order = anchor_order(state.voxels.numpy(), "morton")
    grown = _losses(_lossy(config, model)).lose_packets(state, PACKETS, loss_model, 7, 1)
    assert isinstance(grown, ReceivedAnchors)
    assert np.array_equal(grown.received[order].numpy(), ~expected.left_out)
    assert 0.1 < float(expected.left_out.mean()) < 0.9
    assert float(np.abs(grown.size_gain[order].numpy() - expected.size_gain).max()) < 1e-4


@pytest.mark.parametrize("share", [0.25, 0.5])
def test_growth_of_first_anchors_equals_that_of_a_received_tier(
    share: float, state: TrainState, config: TrainConfig
) -> None:
    with torch.no_grad():  # the sizes of the two tiers must differ
        state.parameters["log_scalings"][:, 3:] += torch.linspace(0, -3, state.num_anchors)[:, None]
    tiers = (np.arange(state.num_anchors) >= round(share * state.num_anchors)).astype(np.uint8)
    stream = encode_scene(export_scene(state, config), PACKETS, tiers=tiers)
    plan = stream.manifest.plan
    received = decode_stream(stream.with_packets([p for p in stream.packets if plan.tier_of(p.id.block) == 0]))
    expected = Grow()(received)
    order = anchor_order(state.voxels.numpy(), "morton")
    grown = _losses(_lossy(config)).receive_first(state, share)
    assert isinstance(grown, ReceivedAnchors)
    assert np.array_equal(grown.received[order].numpy(), ~expected.left_out)
    ratio = grown.size_gain[order].numpy() / expected.size_gain
    assert float(np.abs(ratio - 1).max()) < 0.03  # a tier's size is a byte
    assert float(expected.size_gain.max()) < Grow().max_excess * share**-0.5 - 0.1  # less than for tiers of equal size


@pytest.mark.parametrize(("block_size", "packet_anchors"), [(40, 7), (40, 64), (1000, 7), (1000, 64)])
def test_simulated_datagrams_are_runs_of_the_hash_order(block_size: int, packet_anchors: int) -> None:
    packetization = Packetization(block_size=block_size, lanes=1, grouping="hashed", packet_bytes=1150)
    packet = packet_of_rank(packetization, 333, packet_anchors)
    ranks, starts = PacketPlan(packetization, 333).all_members()
    blocks = [ranks[a:b] for a, b in itertools.pairwise(starts)]
    runs = [
        (at, i, b[at : at + packet_anchors]) for i, b in enumerate(blocks) for at in range(0, len(b), packet_anchors)
    ]
    for number, (_, _, members) in enumerate(sorted(runs, key=lambda run: run[:2])):  # sent in the order of positions
        assert set(np.flatnonzero(packet == number)) == set(members)
    assert packet.max() + 1 == len(runs)


@pytest.mark.parametrize(("model", "expected"), [(SMALL_CAUSAL, 50), (SMALL_CONFIG, 48)])
def test_anchors_per_packet_count_masks_that_the_estimate_excludes(
    model: CausalConfig | HacppConfig, expected: int, state: TrainState, config: TrainConfig
) -> None:
    packetization = PRESETS["datagram"]
    anchor_bits = 8 * (packetization.packet_bytes - HEADER_BYTES) / 50
    config = _lossy(dataclasses.replace(config, model=model), "bernoulli:0.3", share=1.0)
    config = dataclasses.replace(
        config, packet_loss=dataclasses.replace(config.packet_loss, packetizations=("datagram",))
    )
    found = list[int]()

    class Recorder(PacketLossSimulator):
        def lose_packets(
            self, state: TrainState, packetization: Packetization, loss_model: LossModel, seed: int, packet_anchors: int
        ) -> None:
            found.append(packet_anchors)

    cache = AnchorCache(config)
    recorder = Recorder(config, TrainableHacpp(config, COMPILED, cache), cache)
    state.iteration = config.milestones.growth_end + 1
    recorder.simulate(state, SampleBits(torch.tensor(20 * anchor_bits), 20))
    assert found == [expected]


def test_training_without_losses_draws_no_random_numbers(
    dataset: Dataset, state: TrainState, config: TrainConfig
) -> None:
    """The generator is untouched as well, because all later random numbers of the run depend on it."""
    losses = _losses(config)
    luck, voxels = state.generator.get_state(), state.voxels
    losses.before_iteration(state, dataset.cameras)
    assert losses.simulate(state, None) is None
    assert torch.equal(state.generator.get_state(), luck)
    assert state.voxels is voxels


def test_losses_start_after_growth_for_their_share_of_iterations(state: TrainState, config: TrainConfig) -> None:
    losses = _losses(_lossy(config, "bernoulli:0.4", share=0.3))
    drawn = sum(losses.simulate(state, None) is not None for _ in range(400))
    assert 0.3 * 400 - 40 < drawn < 0.3 * 400 + 40
    state.iteration = config.milestones.growth_end
    assert not any(losses.simulate(state, None) for _ in range(40))


def test_invisible_anchors_are_removed_before_packet_loss(
    dataset: Dataset, state: TrainState, config: TrainConfig
) -> None:
    losses = _losses(_lossy(config, "bernoulli:0.4"))
    number = state.num_anchors
    with torch.no_grad():
        state.parameters["mask_logits"][::3] = -20
    losses.before_iteration(state, dataset.cameras)
    assert state.num_anchors == number - len(range(0, number, 3))
    assert export_scene(state, config).anchors.num_anchors == state.num_anchors


def test_lost_anchors_get_no_picture_gradient(
    dataset: Dataset, state: TrainState, config: TrainConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Only the picture has gradients here, without a rate."""
    config = dataclasses.replace(config, milestones=dataclasses.replace(config.milestones, context_start=100))
    config = _lossy(config, "bernoulli:0.5", share=1.0)
    results, simulate = [], PacketLossSimulator.simulate

    def recorded(
        losses: PacketLossSimulator, state: TrainState, estimated_bits: SampleBits | None
    ) -> ReceivedAnchors | None:
        results.append(simulate(losses, state, estimated_bits))
        return results[-1]

    monkeypatch.setattr(PacketLossSimulator, "simulate", recorded)
    gradients: list[torch.Tensor] = []
    state.parameters["features"].register_hook(gradients.append)
    state.iteration -= 1
    TrainingStep(config, dataset.cameras)(state, 0, prepare_photo(torch.from_numpy(dataset.image(0))))
    (received,) = results
    assert received is not None
    assert not bool(gradients[0][~received.received].any())
    assert bool(gradients[0][received.received].any())


def test_loss_models_for_training_are_parsed_from_text() -> None:
    assert create_config().packet_loss.models == create_config(packet_losses=("none",)).packet_loss.models == ()
    assert create_config(packet_losses=("bernoulli:0.2", "none", "gilbert:0.2,20")).packet_loss.models == (
        "bernoulli:0.2",
        "gilbert:0.2,20",
    )
    with pytest.raises(UnknownNameError, match="bernouli"):
        create_config(packet_losses=("bernouli:0.2",))
    with pytest.raises(InvalidValueError, match="share"):
        create_config(packet_losses=("bernoulli:2",))
    mixed = create_config(packet_losses=("first:0.5", "bernoulli:0.1", "first:0.25")).packet_loss
    assert (mixed.models, mixed.received_shares) == (("bernoulli:0.1",), (0.5, 0.25))
    for wrong in ("first", "first:", "first:0", "first:1", "first:nan", "first:half"):
        with pytest.raises(InvalidValueError, match="first:SHARE"):
            create_config(packet_losses=(wrong,))
    with pytest.raises(InvalidValueError, match="share of lossy"):
        PacketLossConfig(lossy_share=1.5)
    for model in ("hacpp", "causal"):
        losses = create_config(model=model, packet_losses=("bernoulli:0.2",), lossy_share=0.8).packet_loss
        assert (losses.models, losses.lossy_share) == (("bernoulli:0.2",), 0.8)
