"""Loss models from text."""

from dataclasses import replace
from pathlib import Path

from splatwire.channel.loss_models import UNIT, UNITS, Bernoulli, GilbertElliott, LossModel, Nothing
from splatwire.channel.trace import Trace
from splatwire.errors import InvalidValueError, UnknownNameError

LOSS_PRESETS = {
    "webrtc-20/3": GilbertElliott(0.20, 3),
    "20/20": GilbertElliott(0.20, 20),
    "10/8": GilbertElliott(0.10, 8),
    "5/5": GilbertElliott(0.05, 5),
    "2/10": GilbertElliott(0.02, 10),
    "1/20": GilbertElliott(0.01, 20),
}
"""Named bursts: percent lost / mean burst in packets. `webrtc-20/3` is a setting of libwebrtc's own tests."""


def parse_loss(spec: str, unit: str = UNIT) -> LossModel:
    """Makes a loss model from text.

    Args:
        spec: `none`, `bernoulli:RATE`, `gilbert:RATE,BURST`, `gilbert:RATE,BURST,ARRIVAL_BAD,ARRIVAL_GOOD`,
            `gilbert:PRESET` (a key of `LOSS_PRESETS`) or `trace:FILE[,repeat]`. Rates are shares from 0 to 1.
        unit: What is lost as one, one of `UNITS`.

    Raises:
        UnknownNameError: If there is no such model, preset or unit.
        InvalidValueError: If a parameter is missing, superfluous or out of range.
        DatasetError: If a trace file is missing or not a trace.
    """
    if unit not in UNITS:
        raise UnknownNameError("loss unit", unit, UNITS)
    if not isinstance(spec, str):
        raise InvalidValueError(f"expected the text of a loss model such as 'bernoulli:0.2', not {spec!r:.60}")
    kind, colon, text = spec.strip().partition(":")
    if kind == "none" and not colon:
        return Nothing(unit=unit)
    if kind == "bernoulli":
        return Bernoulli(*_numbers(spec, text, (1,), "bernoulli:RATE"), unit=unit)
    if kind == "gilbert":
        if text in LOSS_PRESETS:
            return replace(LOSS_PRESETS[text], unit=unit)
        if text and "," not in text:
            raise UnknownNameError("gilbert preset", text, [*LOSS_PRESETS, "RATE,BURST"])
        return GilbertElliott(*_numbers(spec, text, (2, 4), "gilbert:RATE,BURST"), unit=unit)
    if kind == "trace":
        if not text:
            raise InvalidValueError(f"'{spec}' names no file: it should look like trace:FILE")
        return Trace(Path(text.removesuffix(",repeat")), repeat=text.endswith(",repeat"), unit=unit)
    raise UnknownNameError("loss model", spec, ("none", "bernoulli:RATE", "gilbert:RATE,BURST", "trace:FILE"))


def _numbers(spec: str, text: str, counts: tuple[int, ...], form: str) -> list[float]:
    try:
        numbers = [float(word) for word in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) not in counts:
        raise InvalidValueError(f"'{spec}' should look like {form}")
    return numbers
