"""Targets of an encoder: size, PSNR or quality setting."""

import math
import re
from dataclasses import dataclass

from splatwire.arguments import check_fields, checked
from splatwire.codec.gaussians.quality import Quality
from splatwire.errors import InvalidValueError, shown

_UNITS = {"": 1, "B": 1, "kB": 10**3, "MB": 10**6, "GB": 10**9, "KiB": 2**10, "MiB": 2**20, "GiB": 2**30}
_SIZE = re.compile(r"(\d+(?:\.\d+)?|\.\d+) ?([A-Za-z]*)")
_BY_LOWER_CASE = {unit.lower(): factor for unit, factor in _UNITS.items()}


@dataclass(frozen=True)
class Target:
    """Target of an encoding: exactly one of size, PSNR and quality setting.

    Attributes:
        size: Maximum number of bytes of the stream as one file.
        psnr: Mean PSNR against renders of the source, decibels.
        quality: Quality setting, which determines quantisation steps and pruning.

    Raises:
        InvalidValueError: If not exactly one attribute is set, or one is out of range.
    """

    size: int | None = None
    psnr: float | None = None
    quality: Quality | None = None

    def __post_init__(self) -> None:
        check_fields(self)
        if [self.size, self.psnr, self.quality].count(None) != 2:
            raise InvalidValueError("give a size, a PSNR or a quality, only one of them")
        if self.size is not None and self.size < 1:
            raise InvalidValueError(f"a size is at least 1 byte, not {self.size}")
        if self.psnr is not None and not (math.isfinite(self.psnr) and self.psnr > 0):
            raise InvalidValueError(f"a PSNR is a number of decibels above 0, not {self.psnr:g}")


@checked
def parse_size(text: str) -> int:
    """Returns the number of bytes of a text such as `500kB`, `0.5 MB`, `2MiB` or `500000`.

    Units may be in upper or lower case; kB and MB are powers of 1000, KiB and MiB of 1024.

    Raises:
        InvalidValueError: If the text is not a size, or the size is below 1 byte.
    """
    match = _SIZE.fullmatch(text.strip())
    factor = None if match is None else _BY_LOWER_CASE.get(match[2].lower())
    if match is None or factor is None or (size := round(float(match[1]) * factor)) < 1:
        units = ", ".join(unit for unit in _UNITS if unit)
        raise InvalidValueError(f"a size is a number of bytes above 0 with a unit ({units}), not {shown(text)}")
    return size
