"""Loss models from text."""

from pathlib import Path

from splatwire.channel.loss_models import Bernoulli, GilbertElliott, LossModel, Nothing
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


def parse_loss(spec: str) -> LossModel:
    """Makes a loss model from text.

    Args:
        spec: `none`, `bernoulli:RATE`, `gilbert:RATE,BURST`, `gilbert:RATE,BURST,ARRIVAL_BAD,ARRIVAL_GOOD`,
            `gilbert:PRESET` (a key of `LOSS_PRESETS`) or `trace:FILE[,repeat]`. Rates are shares from 0 to 1.

    Raises:
        UnknownNameError: If there is no such model or preset.
        InvalidValueError: If a parameter is missing, superfluous or out of range.
        DatasetError: If a trace file is missing or not a trace.
    """
    kind, colon, text = spec.strip().partition(":")
    if kind == "none" and not colon:
        return Nothing()
    if kind == "bernoulli":
        return Bernoulli(*_numbers(spec, text, (1,), "bernoulli:RATE"))
    if kind == "gilbert":
        if text in LOSS_PRESETS:
            return LOSS_PRESETS[text]
        if text and "," not in text:
            raise UnknownNameError("gilbert preset", text, [*LOSS_PRESETS, "RATE,BURST"])
        return GilbertElliott(*_numbers(spec, text, (2, 4), "gilbert:RATE,BURST"))
    if kind == "trace":
        if not text:
            raise InvalidValueError(f"'{spec}' names no file: it should look like trace:FILE")
        return Trace(Path(text.removesuffix(",repeat")), repeat=text.endswith(",repeat"))
    raise UnknownNameError("loss model", spec, ("none", "bernoulli:RATE", "gilbert:RATE,BURST", "trace:FILE"))


def _numbers(spec: str, text: str, counts: tuple[int, ...], form: str) -> list[float]:
    try:
        numbers = [float(word) for word in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) not in counts:
        raise InvalidValueError(f"'{spec}' should look like {form}")
    return numbers
