"""Parser of loss models given as text, such as `gilbert:0.2,3`."""

from dataclasses import replace
from pathlib import Path

from splatwire.arguments import checked_except
from splatwire.channel.loss_models import UNIT, UNITS, Bernoulli, GilbertElliott, LossModel, NoLoss
from splatwire.channel.registry import LOSS_MODELS, make_loss, register_loss_model
from splatwire.channel.trace import Trace
from splatwire.errors import InvalidValueError, UnknownNameError, shown

LOSS_PRESETS = {
    "webrtc-20/3": GilbertElliott(0.20, 3),
    "20/20": GilbertElliott(0.20, 20),
    "10/8": GilbertElliott(0.10, 8),
    "5/5": GilbertElliott(0.05, 5),
    "2/10": GilbertElliott(0.02, 10),
    "1/20": GilbertElliott(0.01, 20),
}
"""Presets of the Gilbert model by name, `PERCENT/BURST`: loss rate in percent and mean burst length in packets.
`webrtc-20/3` is a setting of libwebrtc's own tests.
"""


@checked_except("spec")
def parse_loss(spec: str, unit: str = UNIT) -> LossModel:
    """Returns the loss model that a text describes.

    Args:
        spec: `none`, `bernoulli:RATE`, `gilbert:RATE,BURST`, `gilbert:RATE,BURST,ARRIVAL_BAD,ARRIVAL_GOOD`,
            `gilbert:PRESET` (a key of `LOSS_PRESETS`), `trace:FILE[,repeat]`, or a model of another package. Rates are
            from 0 to 1.
        unit: Unit of loss: `pak` (whole packets of the stream) or `datagram`.

    Raises:
        UnknownNameError: If the model, preset or unit is unknown.
        InvalidValueError: If a parameter is missing, superfluous or out of range.
        DatasetError: If a trace file is missing or not a trace.
    """
    if unit not in UNITS:
        raise UnknownNameError("loss unit", unit, UNITS)
    if not isinstance(spec, str):
        raise InvalidValueError(f"expected the text of a loss model such as 'bernoulli:0.2', not {shown(spec)}")
    kind, colon, text = spec.strip().partition(":")
    if LOSS_MODELS.find(kind) is None or (colon and kind == "none"):
        forms = {model.form for model in LOSS_MODELS.registered().values()}
        raise UnknownNameError("loss model", spec, forms | (LOSS_MODELS.known_names() - set(LOSS_MODELS.registered())))
    return make_loss(kind, text, unit)


@register_loss_model("none", form="none")
def _none(text: str, *, unit: str) -> LossModel:
    return NoLoss(unit=unit)


@register_loss_model("bernoulli", form="bernoulli:RATE")
def _bernoulli(text: str, *, unit: str) -> LossModel:
    return Bernoulli(*_numbers(f"bernoulli:{text}", text, (1,), "bernoulli:RATE"), unit=unit)


@register_loss_model("gilbert", form="gilbert:RATE,BURST")
def _gilbert(text: str, *, unit: str) -> LossModel:
    if text in LOSS_PRESETS:
        return replace(LOSS_PRESETS[text], unit=unit)
    if text and "," not in text:
        raise UnknownNameError("gilbert preset", text, [*LOSS_PRESETS, "RATE,BURST"])
    return GilbertElliott(*_numbers(f"gilbert:{text}", text, (2, 4), "gilbert:RATE,BURST"), unit=unit)


@register_loss_model("trace", form="trace:FILE")
def _trace(text: str, *, unit: str) -> LossModel:
    if not text:
        raise InvalidValueError("'trace:' names no file: it should look like trace:FILE")
    return Trace(Path(text.removesuffix(",repeat")), repeat=text.endswith(",repeat"), unit=unit)


def _numbers(spec: str, text: str, counts: tuple[int, ...], form: str) -> list[float]:
    try:
        numbers = [float(word) for word in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) not in counts:
        raise InvalidValueError(f"'{spec}' should look like {form}")
    return numbers
