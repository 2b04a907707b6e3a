"""From a partial scene to one that can be rendered."""

import dataclasses

import torch
from torch import Tensor

from splatwire.conceal.base import (
    Concealed,
    Concealer,
    CopyConcealer,
    ElementConcealer,
    concealer_names,
    create_concealer,
)
from splatwire.conceal.context import AnchorContext, context_of, elements_of
from splatwire.errors import InvalidValueError, check_kind
from splatwire.model import PartialScene, PartialSplats, RenderHints, SplatScene
from splatwire.model.appearance import Partial, Scene
from splatwire.scene import Anchors, Attribute


def conceal(partial: Partial, concealer: Concealer | str) -> Scene:
    """Fills, or leaves out, what was lost.

    Whatever the concealer proposes, every attribute that was received stays bit for bit; filled offsets are zero where
    the mask says that there is none. If nothing was lost the concealer is not asked.

    Args:
        partial: What a decoder returned.
        concealer: A concealer or its name (`splatwire.conceal.create_concealer`).

    Returns:
        The scene with filled elements and render hints, on the device of the input.

    Raises:
        UnknownNameError: No concealer has that name.
        InvalidValueError: `partial` is none, it lacks what the concealer works with, or the concealer returned tensors
            of other sizes or hints that cannot be drawn.
    """
    method = create_concealer(concealer) if isinstance(concealer, str) else concealer
    if isinstance(partial, PartialSplats):
        return _with_hints(partial, method)
    check_kind(partial, PartialScene, "load_partial")
    context = context_of(partial)
    if context.erasures.num_lost == 0:
        proposal = Concealed.filled(context.anchors.to("cpu"))
    else:
        proposal = method(context.to_cpu())
    _check(proposal, context, method.name)
    device = context.anchors.positions.device
    opacity_gain = None if proposal.opacity_gain is None else proposal.opacity_gain.to(device)
    hints = RenderHints(proposal.size_gain.to(device), proposal.left_out.to(device), opacity_gain)
    return dataclasses.replace(partial.scene, anchors=keep_received(context, proposal.anchors.to(device)), hints=hints)


def concealed(loaded: Scene | Partial, concealer: Concealer | str) -> Scene:
    """Conceals what has gaps; a scene that can be drawn stays as it is. See `conceal`."""
    return conceal(loaded, concealer) if isinstance(loaded, PartialScene | PartialSplats) else loaded


def _with_hints(partial: PartialSplats, method: Concealer) -> SplatScene:
    """Explicit Gaussians have no attributes that a prior expects: they are drawn differently, never filled."""
    if not isinstance(method, ElementConcealer):
        able = ", ".join(concealer_names(partial.concealment, SplatScene.ELEMENTS))
        raise InvalidValueError(f"concealer '{method.name}' works on anchors; explicit Gaussians take {able}")
    if partial.erasures.num_lost == 0:
        return partial.scene
    filled = method.filled(partial) if isinstance(method, CopyConcealer) else partial
    return dataclasses.replace(filled.scene, hints=method.hints(elements_of(filled)))


def keep_received(context: AnchorContext, proposed: Anchors) -> Anchors:
    """Takes from `proposed` only what is missing in the context."""
    received = context.erasures.received.to(context.anchors.positions.device)

    def merge(attribute: Attribute, decoded: Tensor, filled: Tensor) -> Tensor:
        column = received[:, int(attribute)].view(-1, *[1] * (decoded.dim() - 1))
        return torch.where(column, decoded, filled)

    anchors = context.anchors
    mask = merge(Attribute.MASK, anchors.mask, proposed.mask)
    return dataclasses.replace(
        anchors,
        features=merge(Attribute.FEATURE, anchors.features, proposed.features),
        scalings=merge(Attribute.SCALING, anchors.scalings, proposed.scalings),
        offsets=merge(Attribute.OFFSET, anchors.offsets, proposed.offsets * mask[:, :, None]),
        mask=mask,
    )


def _check(proposal: Concealed, context: AnchorContext, name: str) -> None:
    num_anchors = context.anchors.num_anchors
    opacity_gain = proposal.size_gain if proposal.opacity_gain is None else proposal.opacity_gain
    sizes = {proposal.anchors.num_anchors, len(proposal.size_gain), len(proposal.left_out), len(opacity_gain)}
    if sizes != {num_anchors} or not proposal.anchors.matches(context.layout):
        raise InvalidValueError(f"concealer '{name}' returned {sorted(sizes)} rows for {num_anchors} anchors")
    if not bool((proposal.size_gain.isfinite() & (proposal.size_gain > 0)).all()):
        raise InvalidValueError(f"concealer '{name}' returned a size gain that is not positive and finite")
    if not bool((opacity_gain.isfinite() & (opacity_gain >= 0)).all()):
        raise InvalidValueError(f"concealer '{name}' returned an opacity gain that is negative or not finite")
