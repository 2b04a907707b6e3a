"""From a partial scene to one that can be rendered."""

from dataclasses import replace
from typing import Any

import numpy as np

from splatwire.conceal.base import Concealed, Concealer
from splatwire.conceal.registry import check_needs, create_concealer
from splatwire.errors import InvalidValueError, check_kind
from splatwire.model.appearance import Partial, Scene


def conceal(partial: Partial, concealer: Concealer | str) -> Any:
    """Fills, or leaves out, what was lost.

    Whatever the concealer proposes, every attribute that was received stays bit for bit; filled offsets are zero where
    the mask says that there is none. If nothing was lost the concealer is not asked.

    Args:
        partial: What a decoder returned.
        concealer: A concealer or its name (`splatwire.conceal.create_concealer`).

    Returns:
        The scene with filled elements and render hints, of the kind of the input.

    Raises:
        UnknownNameError: No concealer has that name.
        InvalidValueError: `partial` is none, it lacks what the concealer needs, or the concealer returned tensors of
            other sizes or hints that cannot be drawn.
    """
    method = create_concealer(concealer) if isinstance(concealer, str) else concealer
    check_kind(partial, Partial, "decode_stream")
    check_needs(method, partial)
    if partial.erasures.num_lost == 0:
        return partial.scene
    return drawn(partial, method(partial), method.name)


def drawn(partial: Partial, proposal: Concealed, name: str) -> Any:
    """The scene that a proposal makes of what arrived.

    Args:
        partial: What arrived.
        proposal: What a concealer makes of it.
        name: Of the concealer, for messages.

    Raises:
        InvalidValueError: If sizes are wrong, or hints cannot be drawn.
    """
    proposed = partial.filled if proposal.elements is None else proposal.elements
    _check(proposal, proposed, partial, name)
    elements = partial.elements.kept(partial.erasures, proposed)
    hints, own = proposal.hints, partial.scene.hints
    if own is not None and not proposal.shows:
        hints = replace(hints, left_out=hints.left_out | own.left_out)
    return partial.scene.with_elements(elements, hints)


def concealed(loaded: Scene | Partial, concealer: Concealer | str) -> Any:
    """Conceals what has gaps; a scene that can be drawn stays as it is. See `conceal`."""
    return conceal(loaded, concealer) if isinstance(loaded, Partial) else loaded


def _check(proposal: Concealed, proposed: Any, partial: Partial, name: str) -> None:
    count, hints = partial.scene.num_elements, proposal
    opacity_gain = hints.size_gain if hints.opacity_gain is None else hints.opacity_gain
    rows = {len(hints.size_gain), len(hints.left_out), len(opacity_gain), *(len(t) for t in vars(proposed).values())}
    shapes = [{n: t.shape for n, t in vars(elements).items()} for elements in (proposed, partial.elements)]
    if rows != {count} or shapes[0] != shapes[1]:
        raise InvalidValueError(f"concealer '{name}' returned {sorted(rows)} rows for {count} {partial.scene.ELEMENTS}")
    if not bool((np.isfinite(hints.size_gain) & (hints.size_gain > 0)).all()):
        raise InvalidValueError(f"concealer '{name}' returned a size gain that is not positive and finite")
    if not bool((np.isfinite(opacity_gain) & (opacity_gain >= 0)).all()):
        raise InvalidValueError(f"concealer '{name}' returned an opacity gain that is negative or not finite")
