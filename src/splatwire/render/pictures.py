"""Pictures that notebooks show: an array with a PNG representation."""

import io
from typing import Any

import numpy as np

_MAX_WIDTH = 16_384
"""Maximum width of several pictures side by side, pixels; browsers do not show much wider ones."""


class Pictures(np.ndarray):
    """Array of pictures, RGB in [0, 1], with the shape (C, H, W, 3); behaves like any array.

    Notebooks show the array, or one picture of it with the shape (H, W, 3), as an image.
    """

    def __array_wrap__(self, array: np.ndarray, context: Any = None, return_scalar: bool = False) -> Any:
        """Returns the result of arithmetic as a plain array or number."""
        # The result is usually not a picture.
        return np.asarray(array)[()] if array.ndim == 0 else np.asarray(array)

    def _repr_png_(self) -> bytes | None:
        """Returns the pictures side by side as a PNG file; None if the array does not contain pictures.

        Of very many pictures, the first ones are shown.
        """
        if self.ndim not in (3, 4) or self.shape[-1] != 3 or self.dtype.kind != "f" or not self.size:
            return None
        from PIL import Image  # only notebooks need it

        values = np.asarray(self).reshape(-1, *self.shape[-3:])
        values = values[: max(1, _MAX_WIDTH // values.shape[2])]
        row = np.concatenate([np.rint(255 * np.clip(np.nan_to_num(one), 0, 1)) for one in values], axis=1)
        file = io.BytesIO()
        Image.fromarray(row.astype(np.uint8)).save(file, "PNG")
        return file.getvalue()
