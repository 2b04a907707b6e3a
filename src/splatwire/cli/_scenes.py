"""What the verbs that draw take in common."""

from typing import TYPE_CHECKING, TypeAlias

if TYPE_CHECKING:
    from splatwire.scene.background import Background

BackgroundOption: TypeAlias = tuple[float, float, float] | None
"""What `--background` takes; None for the scene's own."""


def chosen_background(option: BackgroundOption) -> "Background | None":
    """Checks what the user said; None for nothing.

    Raises:
        InvalidValueError: If it is no colour.
    """
    from splatwire.scene.background import check_background

    return None if option is None else check_background(option)
