"""One unit of work, from a stream in the store to the scores of its views; runs in a worker of any engine."""

import dataclasses
import json
import math
import time
from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from splatwire.codec import decode_stream
from splatwire.conceal import conceal, create_concealer
from splatwire.errors import SplatwireError
from splatwire.evaluate.study.masks import LossMask, draw_mask
from splatwire.evaluate.study.records import records_to_bytes
from splatwire.evaluate.study.references import load_views
from splatwire.evaluate.study.store import Store
from splatwire.evaluate.study.units import Unit
from splatwire.evaluate.views import Compared, ReferenceViews, spread, views_of
from splatwire.metrics import Lpips, find_lpips
from splatwire.model import AnchorScene, PartialScene
from splatwire.packets import SceneStream, read_stream
from splatwire.scene import Anchors, Attribute, Erasures

_MAX_FEATURE_BYTES = 1 << 30
"""LPIPS features of references that a worker keeps."""
_STREAMS, _SCENES, _VIEWS = 4, 2, 4
"""Streams, decoded scenes and sets of references that a worker keeps."""
Value = TypeVar("Value")


def run_unit(root: str, unit: Unit) -> str:
    """Computes a unit and writes its records into the store, unless they are there.

    Args:
        root: Folder of the store.
        unit: The unit.

    Returns:
        Its key.
    """
    store = Store(Path(root))
    if not store.has(unit.key):
        workshop = _WORKSHOPS.setdefault(root, Workshop(store))
        store.put_unit(unit.key, records_to_bytes(workshop.records(unit)))
    return unit.key


_WORKSHOPS: dict[str, "Workshop"] = {}
"""What a worker process keeps from one unit to the next, by store."""


def use_one_thread() -> None:
    """Keeps a worker to one thread: workers share the processors, and sums must not depend on their number."""
    import numba
    from threadpoolctl import threadpool_limits

    torch.set_num_threads(1)
    numba.set_num_threads(1)
    threadpool_limits(limits=1)


@dataclass(eq=False)
class Workshop:
    """Streams, decoded scenes, references and the metric's features that units share.

    Attributes:
        store: The store.
    """

    store: Store
    _streams: "OrderedDict[str, SceneStream]" = field(default_factory=OrderedDict)
    _decoded: "OrderedDict[tuple[str, str], tuple[PartialScene, float]]" = field(default_factory=OrderedDict)
    _views: "OrderedDict[str, ReferenceViews]" = field(default_factory=OrderedDict)
    _features: "OrderedDict[tuple[str, int], tuple[Tensor, ...]]" = field(default_factory=OrderedDict)
    _lpips: Lpips | None = None

    def records(self, unit: Unit) -> list[dict[str, Any]]:
        """Computes the records of a unit, one per view."""
        mask, partial, seconds = self.received(unit)
        started = time.perf_counter()
        scene = concealed(partial, unit)
        common = self._common(unit, mask, partial)
        common["seconds_conceal"], common["seconds_decode"] = time.perf_counter() - started, seconds
        views = self.views(unit)
        wanted = spread(views.cameras.num_views, unit.lpips_views) if unit.lpips_digest else []
        records = []
        for view, (image, drawn) in enumerate(_timed(views_of(scene, views.cameras, unit.renderer, views.background))):
            began = time.perf_counter()
            scores = self._scores(unit, view, views.compared(view, image), lpips=view in wanted)
            timings = {"seconds_render": drawn, "seconds_score": time.perf_counter() - began}
            place = {"view": views.cameras.names[view], "view_index": view}
            records.append({**common, **place, **scores, **timings})
        return records

    def received(self, unit: Unit) -> tuple[LossMask | None, PartialScene, float]:
        """What arrived of the unit's stream, decoded; and the seconds that decoding took."""
        stream = self._keep(self._streams, unit.stream, _STREAMS, lambda: self._read(unit))
        mask = None
        sent = stream
        if unit.loss is not None and unit.seed is not None:
            mask = draw_mask(stream, unit.loss, unit.seed)
            if mask.digest != unit.mask_digest:
                raise SplatwireError(f"the mask of unit {unit.key} is not the one that was saved for it")
            sent = mask.apply(stream)

        def decode() -> tuple[PartialScene, float]:
            started = time.perf_counter()
            partial = decode_stream(sent, threads=1)
            return partial, time.perf_counter() - started

        partial, seconds = self._keep(self._decoded, (unit.stream, unit.mask_digest), _SCENES, decode)
        if unit.erode is not None and mask is not None:
            complete = (unit.stream, "")
            whole, _ = self._keep(self._decoded, complete, _SCENES, lambda: (decode_stream(stream, threads=1), 0.0))
            partial = erode(whole, ~partial.erasures.known, Attribute[unit.erode.upper()])
        return mask, partial, seconds

    def views(self, unit: Unit) -> ReferenceViews:
        """The references of a unit."""
        return self._keep(self._views, unit.views, _VIEWS, lambda: load_views(self.store, unit.views))

    def _read(self, unit: Unit) -> SceneStream:
        return read_stream(self.store.root / unit.stream)[0]

    def _common(self, unit: Unit, mask: LossMask | None, partial: PartialScene) -> dict[str, Any]:
        stream = self._streams[unit.stream]
        lost = 0 if mask is None else mask.num_lost
        received = stream.num_bytes if mask is None else mask.apply(stream).num_bytes
        return {
            "unit": unit.key,
            "scene": unit.scene,
            "stream": Path(unit.stream).stem,
            "mask": unit.mask_digest,
            "loss": "none" if unit.loss is None else unit.loss.model,
            "loss_unit": None if unit.loss is None else unit.loss.unit,
            "send_order": None if unit.loss is None else unit.loss.send_order,
            "seed": unit.seed,
            "conceal": unit.conceal,
            "options": unit.options,
            "erode": unit.erode,
            "renderer": unit.renderer,
            "code": unit.code,
            "num_anchors": partial.scene.anchors.num_anchors,
            "num_lost_anchors": partial.erasures.num_lost,
            "num_packets": len(stream.packets),
            "num_lost_packets": lost,
            "num_datagrams": None if mask is None else mask.num_datagrams,
            "num_lost_datagrams": None if mask is None else mask.num_lost_datagrams,
            "num_bytes_received": received,
        }

    def _scores(self, unit: Unit, view: int, both: Compared, *, lpips: bool) -> dict[str, float | None]:
        value = both.psnr()
        equal = math.isinf(value)  # then the slower metrics need not be computed
        scores: dict[str, float | None] = {"psnr": value} if "psnr" in unit.metrics else {}
        if "ssim" in unit.metrics:
            scores["ssim"] = 1.0 if equal else both.ssim()
        if lpips:
            scores["lpips"] = 0.0 if equal else self._distance(unit, view, both)
        return scores

    def _distance(self, unit: Unit, view: int, both: Compared) -> float:
        if self._lpips is None:
            self._lpips = find_lpips()
        if self._lpips is None:
            raise SplatwireError("this worker has no LPIPS weights: set SPLATWIRE_LPIPS_DIR for it, too")
        key = (unit.views, view)
        features = self._features.get(key)
        if features is None:
            features = self._lpips.features(both.reference)
            size = sum(tensor.nbytes for tensor in features)
            while self._features and (len(self._features) + 1) * size > _MAX_FEATURE_BYTES:
                self._features.popitem(last=False)
            self._features[key] = features
        return float(self._lpips.distance(self._lpips.features(both.image), features)[0])

    @staticmethod
    def _keep(cache: "OrderedDict[Any, Value]", key: Any, most: int, make: Callable[[], Value]) -> Value:
        """Takes a value from a cache, or makes it and lets the oldest go."""
        if key not in cache:
            while len(cache) >= most:
                cache.popitem(last=False)
            cache[key] = make()
        cache.move_to_end(key)
        return cache[key]


def concealed(partial: PartialScene, unit: Unit) -> AnchorScene:
    """Conceals what a unit lost."""
    options: Mapping[str, Any] = json.loads(unit.options)
    return conceal(partial, create_concealer(unit.concealer, **options))


def erode(whole: PartialScene, anchors: Bool[Tensor, "N"], attribute: Attribute) -> PartialScene:
    """Attribute erosion (paper 3.2.1, "partial loss"): some anchors lose one attribute and keep the others.

    Args:
        whole: The complete scene.
        anchors: True where the attribute is lost.
        attribute: Which one.

    Returns:
        The scene with the attribute set to zero there, so that no concealer can see what it must guess.
    """
    received = whole.erasures.received.clone()
    received[:, int(attribute)] &= ~anchors
    parts = {name: getattr(whole.scene.anchors, name) for name in _FIELDS.values()}
    lost = parts[_FIELDS[attribute]].clone()
    lost[anchors] = 0
    parts[_FIELDS[attribute]] = lost
    eroded = Anchors(positions=whole.scene.anchors.positions, **parts)
    return dataclasses.replace(
        whole, scene=dataclasses.replace(whole.scene, anchors=eroded), erasures=Erasures(received)
    )


_FIELDS = {
    Attribute.FEATURE: "features",
    Attribute.SCALING: "scalings",
    Attribute.OFFSET: "offsets",
    Attribute.MASK: "mask",
}


def _timed(images: Any) -> Iterator[tuple[Float[Tensor, "H W 3"], float]]:
    """Pictures one by one, each with the seconds that drawing it took."""
    source = iter(images)
    while True:
        started = time.perf_counter()
        image = next(source, None)
        if image is None:
            return
        yield image, time.perf_counter() - started
