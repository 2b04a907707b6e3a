"""Applies a concealer to a received scene; the result can be rendered."""

from dataclasses import replace
from typing import Any

import numpy as np

from splatwire.anchors.appearance import check_drawable
from splatwire.arguments import checked_except
from splatwire.concealment.base import Concealed, Concealer
from splatwire.concealment.registry import check_needs, create_concealer
from splatwire.errors import InvalidValueError, check_kind, shown
from splatwire.types.received_scene import ReceivedScene, S
from splatwire.types.scene import Scene


@checked_except("received", "concealer")
def conceal(received: ReceivedScene[S], concealer: Concealer | str) -> S:
    """Conceals the losses of a received scene: replaces lost elements by estimates, or hides them.

    Received attributes do not change.

    Args:
        received: Output of a decoder.
        concealer: A concealer or its name (`splatwire.concealment.create_concealer`).

    Returns:
        A scene of the same type, with estimates of lost elements and with hints for rendering.

    Raises:
        UnknownNameError: If no concealer has that name.
        InvalidValueError: If `received` is not a received still scene or lacks side information that the concealer
            needs, or if the concealer returned an invalid result.
    """
    check_kind(received, ReceivedScene, "decode_stream")
    check_drawable(received.scene)  # clips have other concealers
    method = create_concealer(concealer) if isinstance(concealer, str) else concealer
    if not isinstance(method, Concealer) or isinstance(method, type):
        raise InvalidValueError(f"expected a concealer or its name such as 'grow', not {shown(method)}")
    check_needs(method, received)
    if received.loss_mask.num_lost == 0:
        return received.scene
    result: Any = method(received)
    if not isinstance(result, Concealed):
        raise InvalidValueError(f"concealer '{method.name}' returned {shown(result)}, not Concealed")
    return apply_result(received, result, method.name)


def apply_result(received: ReceivedScene[S], result: Concealed, name: str) -> S:
    """Applies the result of a concealer to a received scene: fills in lost values, and adds the hints for rendering.

    Received values do not change.

    Args:
        received: The received scene.
        result: Result of the concealer.
        name: Name of the concealer, for messages.

    Raises:
        InvalidValueError: If the result has an array of wrong shape, or invalid hints.
    """
    estimates = received.filled if result.elements is None else result.elements
    _check(result, estimates, received, name)
    elements = received.elements.with_estimates(received.loss_mask, estimates)
    hints, scene_hints = result.hints, received.scene.hints
    if scene_hints is not None and not result.draws_hidden:
        hints = replace(hints, left_out=hints.left_out | scene_hints.left_out)
    return received.scene.with_elements(elements, hints)


@checked_except("concealer")
def conceal_if_received(loaded: Scene | ReceivedScene, concealer: Concealer | str) -> Scene:
    """Returns a scene that can be drawn: conceals the losses of a received scene.

    A scene that is not a `ReceivedScene` is returned unchanged.
    """
    return conceal(loaded, concealer) if isinstance(loaded, ReceivedScene) else loaded


def _check(result: Concealed, estimates: Any, received: ReceivedScene, name: str) -> None:
    if not isinstance(estimates, type(received.elements)):
        kind = type(received.elements).__name__
        raise InvalidValueError(f"concealer '{name}' returned elements of type {shown(estimates)}, not {kind}")
    count, hints = received.scene.num_elements, result
    opacity_gain = hints.size_gain if hints.opacity_gain is None else hints.opacity_gain
    rows = {len(hints.size_gain), len(hints.left_out), len(opacity_gain), *(len(t) for t in vars(estimates).values())}
    shapes = [{n: t.shape for n, t in vars(elements).items()} for elements in (estimates, received.elements)]
    if rows != {count} or shapes[0] != shapes[1]:
        raise InvalidValueError(
            f"concealer '{name}' returned {sorted(rows)} rows for {count} {received.scene.ELEMENTS}"
        )
    if not bool((np.isfinite(hints.size_gain) & (hints.size_gain > 0)).all()):
        raise InvalidValueError(f"concealer '{name}' returned a size gain that is not positive and finite")
    if not bool((np.isfinite(opacity_gain) & (opacity_gain >= 0)).all()):
        raise InvalidValueError(f"concealer '{name}' returned an opacity gain that is negative or not finite")
