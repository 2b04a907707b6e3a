"""One unit of work, from a stream to the scores of its views and the pictures that are kept of them."""

import dataclasses
import functools
import math
import sys
import time
from collections import OrderedDict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Bool, Float

from splatwire.codec import decode_stream
from splatwire.conceal import concealed, create_concealer
from splatwire.errors import InvalidValueError, SplatwireError
from splatwire.evaluate.lossmap import draw_loss_map
from splatwire.evaluate.pixels import png_bytes, to_pixels
from splatwire.evaluate.study.definition import canonical
from splatwire.evaluate.study.records import CODE, Record, hardest
from splatwire.evaluate.study.store import Store
from splatwire.evaluate.study.units import Unit
from splatwire.evaluate.views import Compared, ReferenceViews, spread, views_of
from splatwire.metrics.lpips_files import find_lpips_files
from splatwire.model.appearance import Partial, Scene, scene_of
from splatwire.ops.arrays import to_numpy
from splatwire.ops.threads import use_single_thread
from splatwire.packets import SceneStream, read_stream
from splatwire.scene import Anchors, Attribute, Erasures
from splatwire.scene_io import read_scene_file

_MAX_FEATURE_BYTES = 1 << 30
"""LPIPS features of references that a worker keeps; those of one 800x600 picture take a quarter of this."""
_STREAMS, _SCENES, _VIEWS = 4, 2, 4
"""Streams, decoded scenes and sets of references that a worker keeps."""
Value = TypeVar("Value")
Decode = Callable[[SceneStream], Partial]
Progress = Callable[[str, float], None]


def run_unit(root: str, unit: Unit) -> str:
    """Computes a unit in a worker and writes its records into the store, unless they are there.

    Args:
        root: Folder of the store.
        unit: The unit.

    Returns:
        Its key.
    """
    store = Store(Path(root))
    if not unit.is_done(store):
        _WORKSHOPS.setdefault(root, Workshop(store, functools.partial(decode_stream, threads=1))).compute(unit)
    return unit.key


_WORKSHOPS: dict[str, "Workshop"] = {}
"""What a worker process keeps from one unit to the next, by store."""


def _silent(task: str, share: float) -> None:
    """Shows nothing."""


def use_one_thread() -> None:
    """Keeps a worker to one thread: workers share the processors, and sums must not depend on their number."""
    import numba
    from threadpoolctl import threadpool_limits

    use_single_thread()
    if "torch" in sys.modules:
        sys.modules["torch"].set_num_threads(1)
    numba.set_num_threads(1)
    threadpool_limits(limits=1)


@dataclass(frozen=True, eq=False)
class Arrived:
    """What is there of a scene before anything is concealed.

    Attributes:
        scene: The decoded scene, or one that can be drawn as it is.
        erasures: What of it was received; None for a scene that was never sent.
        num_packets: Packets that arrived.
        num_bytes: Bytes that arrived.
        seconds: Seconds that decoding took.
    """

    scene: Scene | Partial
    erasures: Erasures | None
    num_packets: int
    num_bytes: int
    seconds: float

    @property
    def positions(self) -> Float[np.ndarray, "N 3"]:
        """Where the elements are, or are expected to be."""
        return to_numpy(scene_of(self.scene).positions)

    @property
    def num_lost(self) -> int:
        """Elements that lost something."""
        return 0 if self.erasures is None else self.erasures.num_lost


@dataclass(eq=False)
class Workshop:
    """Computes units; streams, decoded scenes, references and the metric's features are kept from one to the next.

    Attributes:
        store: Where records and pictures go.
        decode: How a received stream becomes a scene.
        progress: Called with the row and the share of its views that is done.
    """

    store: Store
    decode: Decode = decode_stream
    progress: Progress = _silent
    _streams: "OrderedDict[str, SceneStream]" = field(default_factory=OrderedDict)
    _arrived: "OrderedDict[tuple[str, str], Arrived]" = field(default_factory=OrderedDict)
    _views: "OrderedDict[str, ReferenceViews]" = field(default_factory=OrderedDict)
    _features: "OrderedDict[tuple[str, int], tuple[Any, ...]]" = field(default_factory=OrderedDict)
    _lpips: Any = None

    def compute(self, unit: Unit) -> None:
        """Conceals, draws and scores; writes the pictures that are asked for, and then the records."""
        arrived = self.arrived(unit)
        started = time.perf_counter()
        scene = concealed(arrived.scene, create_concealer(unit.concealer, **unit.options))
        common = self._common(unit, arrived) | {"seconds_conceal": time.perf_counter() - started}
        views = self._keep(self._views, unit.references.digest, _VIEWS, lambda: unit.references.open(self.store.root))
        wanted = spread(views.cameras.num_views, unit.lpips_views) if unit.lpips_digest else []
        records: list[Record] = []
        kept: dict[int, np.ndarray] = {}
        for view, (image, drawn) in enumerate(_timed(views_of(scene, views.cameras, unit.renderer, views.background))):
            began, both = time.perf_counter(), views.compared(view, image)
            scores = self._scores(unit, view, both, lpips=view in wanted)
            scores |= {"seconds_render": drawn, "seconds_score": time.perf_counter() - began}
            records.append(Record(**common, **scores, view=views.cameras.names[view], view_index=view))
            if view in unit.pictures or unit.hardest:
                kept[view] = to_pixels(both.image[0])
                shown = unit.pictures or hardest(records, unit.hardest)
                kept = {view: kept[view] for view in shown if view in kept}
            self.progress(unit.label, (view + 1) / views.cameras.num_views)
        self._write_pictures(unit, kept, arrived, views)
        self.store.put_records(unit.key, records)

    def _write_pictures(self, unit: Unit, kept: dict[int, np.ndarray], arrived: Arrived, views: ReferenceViews) -> None:
        for view, pixels in kept.items():
            self.store.write(unit.picture(view), png_bytes(pixels))
        erasures, hard = arrived.erasures, next(iter(kept), None)
        if hard is None or erasures is None or unit.erode is not None or not (unit.loss or erasures.num_lost):
            return
        if not (self.store.root / unit.loss_map(hard)).is_file():
            reference = views.reference(hard)
            losses = draw_loss_map(arrived.positions, erasures.known, views.cameras, hard, reference)
            self.store.write(unit.loss_map(hard), png_bytes(losses))

    def arrived(self, unit: Unit) -> Arrived:
        """What arrived of the unit's stream, decoded."""
        stream = self._stream(unit)
        sent = stream if stream is None or unit.mask is None else unit.mask.apply(stream)
        arrived = self._decoded(unit, unit.mask_digest, sent)
        if unit.erode is not None and unit.mask is not None and arrived.erasures is not None:
            whole = self._decoded(unit, "", stream).scene
            if not isinstance(whole, Partial) or Anchors not in whole.offers:
                raise InvalidValueError("only anchors lose one attribute alone: explicit Gaussians do not")
            eroded = erode(whole, ~arrived.erasures.known, Attribute[unit.erode.upper()])
            arrived = dataclasses.replace(arrived, scene=eroded, erasures=eroded.erasures)
        return arrived

    def _stream(self, unit: Unit) -> SceneStream | None:
        """The stream of a unit; None for a scene that is scored as it is."""
        path = self.store.root / unit.stream.path
        if not unit.stream.num_packets:
            return None
        return self._keep(self._streams, unit.stream.digest, _STREAMS, lambda: read_stream(path)[0])

    def _decoded(self, unit: Unit, mask: str, sent: SceneStream | None) -> Arrived:
        def decode() -> Arrived:
            if sent is None:
                found = read_scene_file(self.store.root / unit.stream.path)
                return Arrived(found.loaded, found.erasures, 0, sum(unit.stream.parts.values()), 0.0)
            started = time.perf_counter()
            partial = self.decode(sent)
            seconds = time.perf_counter() - started
            return Arrived(partial, partial.erasures, len(sent.packets), sent.num_bytes, seconds)

        return self._keep(self._arrived, (unit.stream.digest, mask), _SCENES, decode)

    def _common(self, unit: Unit, arrived: Arrived) -> dict[str, Any]:
        """What the records of all views say."""
        return {
            "unit": unit.key,
            "scene": unit.scene,
            "stream": Path(unit.stream.path).stem,
            "mask": unit.mask_digest,
            "loss": "none" if unit.loss is None else unit.loss.model,
            "loss_unit": None if unit.loss is None else unit.loss.unit,
            "send_order": None if unit.loss is None else unit.loss.send_order,
            "seed": unit.seed,
            "conceal": unit.conceal,
            "options": canonical(unit.options),
            "erode": unit.erode,
            "renderer": unit.renderer,
            "code": CODE,
            "num_anchors": len(arrived.positions),
            "num_lost_anchors": arrived.num_lost,
            "num_packets": unit.stream.num_packets,
            "num_lost_packets": unit.stream.num_packets - arrived.num_packets,
            "num_datagrams": unit.mask and unit.mask.num_datagrams,
            "num_lost_datagrams": unit.mask and unit.mask.num_lost_datagrams,
            "num_bytes_received": arrived.num_bytes,
            "seconds_decode": arrived.seconds,
        }

    def _scores(self, unit: Unit, view: int, both: Compared, *, lpips: bool) -> dict[str, Any]:
        value = both.psnr()
        equal = math.isinf(value)  # then the slower metrics need not be computed
        scores: dict[str, Any] = dict.fromkeys(("psnr", "ssim", "lpips"))
        if "psnr" in unit.metrics:
            scores["psnr"] = value
        if "ssim" in unit.metrics:
            scores["ssim"] = 1.0 if equal else both.ssim()
        if lpips:
            scores["lpips"] = 0.0 if equal else self._distance(unit, view, both)
        return scores

    def _distance(self, unit: Unit, view: int, both: Compared) -> float:
        if self._lpips is None:
            self._lpips = self._load_lpips()
        key = (unit.references.digest, view)
        features = self._features.get(key)
        if features is None:
            features = self._lpips.features(both.reference)
            size = sum(tensor.nbytes for tensor in features)
            while self._features and (len(self._features) + 1) * size > _MAX_FEATURE_BYTES:
                self._features.popitem(last=False)
            self._features[key] = features
        return float(self._lpips.distance(self._lpips.features(both.image), features)[0])

    @staticmethod
    def _load_lpips() -> Any:
        files = find_lpips_files()
        if files is None:
            raise SplatwireError("this worker has no LPIPS weights: set SPLATWIRE_LPIPS_DIR for it, too")
        from splatwire.metrics.lpips import load_lpips  # needs torch

        return load_lpips(*files)

    @staticmethod
    def _keep(cache: "OrderedDict[Any, Value]", key: Any, most: int, make: Callable[[], Value]) -> Value:
        """Takes a value from a cache, or makes it and lets the oldest go."""
        if key not in cache:
            while len(cache) >= most:
                cache.popitem(last=False)
            cache[key] = make()
        cache.move_to_end(key)
        return cache[key]


def erode(whole: Partial, anchors: Bool[np.ndarray, "N"], attribute: Attribute) -> Partial:
    """Attribute erosion (paper 3.2.1, "partial loss"): some anchors lose one attribute and keep the others.

    Args:
        whole: The complete scene.
        anchors: True where the attribute is lost.
        attribute: Which one.

    Returns:
        The scene with the attribute set to zero there, so that no concealer can see what it must guess.
    """
    received = whole.erasures.received.copy()
    received[:, int(attribute)] &= ~anchors
    field = _FIELDS[attribute]
    lost = to_numpy(getattr(whole.scene.anchors, field)).copy()
    lost[anchors] = 0
    eroded = dataclasses.replace(whole.scene.anchors, **{field: lost})
    return dataclasses.replace(whole, scene=whole.scene.with_elements(eroded), erasures=Erasures(received))


_FIELDS = {
    Attribute.FEATURE: "features",
    Attribute.SCALING: "scalings",
    Attribute.OFFSET: "offsets",
    Attribute.MASK: "mask",
}


def _timed(images: Any) -> Iterator[tuple[Float[np.ndarray, "H W 3"], float]]:
    """Pictures one by one, each with the seconds that drawing it took."""
    source = iter(images)
    while True:
        started = time.perf_counter()
        image = next(source, None)
        if image is None:
            return
        yield image, time.perf_counter() - started
