"""Refines the networks of the causal model of a finished scene, so that the same attributes take fewer bits."""

import dataclasses
from collections.abc import Callable

import torch
from torch import Tensor

from splatwire.anchors.causal_prediction import position_inputs
from splatwire.neural.model.tensors import to_tensors
from splatwire.neural.training.causal import anchor_and_offset_bits, attribute_steps
from splatwire.neural.training.config import RefineConfig
from splatwire.neural.training.export import copied_mlp
from splatwire.neural.training.fit import fit_samples
from splatwire.ops.arrays import to_arrays
from splatwire.types import AnchorScene, CausalCoding, Linear, Mlp


def refine_causal(
    scene: AnchorScene, config: RefineConfig, *, progress: Callable[[float], None] = lambda share: None
) -> AnchorScene:
    """Refines the causal model's networks so that the same scene takes fewer bits.

    Anchors, quantisation steps and rendering networks do not change.

    Args:
        scene: The scene, on the CPU.
        config: Number of Adam steps, batch size and learning rate.
        progress: Called with the completed share, 0 to 1.

    Returns:
        The scene with the refined networks; `scene` itself if there are no Adam steps or no anchors.

    Raises:
        DivergedError: If the loss is not finite.
    """
    original, scene = scene, to_tensors(scene)
    coding = scene.causal
    alive = scene.anchors.mask.any(dim=1)
    if not config.steps or not bool(alive.any()):
        return original
    inputs, values, mask = _constant_data(scene, coding, alive)
    networks = {name: _trainable_copy(network) for name, network in coding.networks.items()}
    layers = [layer for mlp in networks.values() for layer in (mlp.hidden, mlp.output)]
    parameters = [tensor for layer in layers for tensor in (layer.weight, layer.bias)]

    def loss_of(index: Tensor, generator: torch.Generator) -> Tensor:
        noisy = [value[index] + torch.rand(value[index].shape, generator=generator) - 0.5 for value in values]
        anchor_value_bits, offsets = anchor_and_offset_bits(networks, coding.config, inputs[index], noisy, mask[index])
        return (anchor_value_bits + offsets.sum(dim=1)).mean()

    fit_samples([(parameters, config.network_rate)], len(inputs), config, loss_of, progress)
    fitted = {name: copied_mlp(network) for name, network in networks.items()}
    return dataclasses.replace(original, coding=dataclasses.replace(original.causal, networks=to_arrays(fitted)))


def _constant_data(scene: AnchorScene, coding: CausalCoding, alive: Tensor) -> tuple[Tensor, list[Tensor], Tensor]:
    """Computes the data that stays constant while the networks of the context model are refined.

    Args:
        scene: The scene.
        coding: Context model of the scene, whose networks are refined.
        alive: Mask or indices of the anchors to use.

    Returns:
        Inputs of the position network, attributes of the anchors in quantisation steps, and offset masks, 0 or 1.
    """
    anchors = scene.anchors.select(alive)
    feature_step, log_scaling_step, offset_step = attribute_steps(coding.steps.log(), coding.config)
    voxels = torch.round(anchors.positions.double() / coding.voxel_size)
    log_scalings = anchors.scalings[:, [0, 3, 4, 5]].log() - coding.zero_points
    values = [
        anchors.features / feature_step, log_scalings / log_scaling_step, anchors.offsets.flatten(1) / offset_step,
    ]  # fmt: skip
    return position_inputs(((voxels - coding.middle) / coding.spread).float(), torch.cat), values, anchors.mask.float()


def _trainable_copy(mlp: Mlp) -> Mlp:
    hidden, output = (
        Linear(layer.weight.clone().requires_grad_(), layer.bias.clone().requires_grad_())
        for layer in (mlp.hidden, mlp.output)
    )
    return Mlp(hidden, output, mlp.negative_slope)
