"""Execution of one task of an evaluation: decoding, concealment, rendering, scoring and stored images."""

import dataclasses
import functools
import math
import sys
import time
from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numba
import numpy as np
from jaxtyping import Bool, Float
from threadpoolctl import threadpool_limits

from splatwire.anchors.appearance import scene_of
from splatwire.bitstream import SceneStream
from splatwire.codec import decode_stream
from splatwire.concealment import conceal_if_received, create_concealer
from splatwire.concealment.temporal.concealers import temporal_concealer
from splatwire.errors import InvalidValueError, SplatwireError
from splatwire.evaluation.lossmap import draw_loss_map
from splatwire.evaluation.pixels import png_bytes, to_pixels
from splatwire.evaluation.study.decoded import PICTURES, picture_paths, read_pictures
from splatwire.evaluation.study.definition import DEFAULT_METRICS, canonical
from splatwire.evaluation.study.input_files import keep
from splatwire.evaluation.study.records import CODE, Record, hardest
from splatwire.evaluation.study.sequences import concealed_pictures
from splatwire.evaluation.study.store import Store
from splatwire.evaluation.study.units import Unit
from splatwire.evaluation.views import Compared, ReferenceViews, spread
from splatwire.files.kinds import HACPP, file_kind
from splatwire.metrics.lpips import load_lpips
from splatwire.metrics.lpips_files import find_lpips_files
from splatwire.metrics.registry import LPIPS_SCALED
from splatwire.ops.arrays import to_numpy
from splatwire.ops.threads import use_single_thread
from splatwire.render import iterate_views
from splatwire.render.near_plane import warn_of_near_plane
from splatwire.types import Anchors, Attribute, LossMask
from splatwire.types.received_scene import ReceivedScene
from splatwire.types.scene import Scene

_MAX_FEATURE_BYTES = 1 << 30
"""Limit per worker of cached LPIPS features of reference images, bytes; an 800x600 image takes a quarter of it."""
_SCENES, _VIEWS = 2, 4
"""Cache sizes per worker: decoded scenes and sets of references."""
Decode = Callable[[SceneStream], ReceivedScene]
Progress = Callable[[str, float], None]


def run_unit(root: str, unit: Unit) -> str:
    """Computes the results of a task in a worker process and writes them into the store, unless already present.

    Args:
        root: Folder of the store.
        unit: The task.

    Returns:
        Key of the task.
    """
    store = Store(Path(root))
    if not unit.is_done(store):
        _WORKSHOPS.setdefault(root, UnitRunner(store, functools.partial(decode_stream, threads=1))).compute(unit)
    return unit.key


_WORKSHOPS: dict[str, "UnitRunner"] = {}
"""`UnitRunner` of a worker process for each store folder, with its caches."""


def _silent(task: str, share: float) -> None:
    """Progress callback that does nothing, the default."""


def use_one_thread() -> None:
    """Limits a worker process to one thread."""
    # Workers share the processors, and floating-point sums must not depend on the number of threads.
    use_single_thread()
    if "torch" in sys.modules:
        sys.modules["torch"].set_num_threads(1)
    numba.set_num_threads(1)
    threadpool_limits(limits=1)


@dataclass(frozen=True, eq=False)
class ReceivedInput:
    """Scene of a task as received, before concealment, and statistics of the simulated transmission.

    Attributes:
        scene: Received scene with losses marked; None if the task evaluates pictures of another codec.
        loss_mask: Mask of received attributes; None if nothing is transmitted.
        num_packets: Number of received packets.
        num_bytes: Number of received bytes.
        seconds: Decoding time in seconds.
    """

    scene: Scene | ReceivedScene | None
    loss_mask: LossMask | None
    num_packets: int
    num_bytes: int
    seconds: float

    @property
    def positions(self) -> Float[np.ndarray, "N 3"]:
        """Positions of the elements, world units; approximate for an element whose position was lost."""
        return np.empty((0, 3), np.float32) if self.scene is None else to_numpy(scene_of(self.scene).positions)

    @property
    def num_lost(self) -> int:
        """Number of elements with a lost attribute."""
        return 0 if self.loss_mask is None else self.loss_mask.num_lost


@dataclass(eq=False)
class UnitRunner:
    """Computes the results of tasks; caches decoded scenes, reference images and LPIPS features.

    Attributes:
        store: Store for records and images.
        decode: Decoder of received streams.
        progress: Called with the label of the task's method, and the finished share of the task's views, 0 to 1.
    """

    store: Store
    decode: Decode = decode_stream
    progress: Progress = _silent
    _arrived: "OrderedDict[tuple[str, str], ReceivedInput]" = field(default_factory=OrderedDict)
    _views: "OrderedDict[str, ReferenceViews]" = field(default_factory=OrderedDict)
    _features: "OrderedDict[tuple[str, int, bool], tuple[Any, ...]]" = field(default_factory=OrderedDict)
    _examined: set[str] = field(default_factory=set)
    _lpips: Any = None

    def compute(self, unit: Unit) -> None:
        """Computes the scores of each view and the requested images of one task, and writes them into the store."""
        # Scores are written last, because they mark the task as finished.
        arrived = self.arrived(unit)
        started = time.perf_counter()
        views = keep(self._views, unit.references.digest, _VIEWS, lambda: unit.references.open(self.store.root))
        images = self._images(unit, arrived, views)
        common = self._shared_fields(unit, arrived) | {"seconds_conceal": time.perf_counter() - started}
        wanted = spread(views.cameras.num_views, unit.lpips_views) if unit.lpips_digest else []
        records: list[Record] = []
        kept: dict[int, np.ndarray] = {}
        for view, (image, drawn) in enumerate(_timed(images)):
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

    def _images(
        self, unit: Unit, arrived: ReceivedInput, views: ReferenceViews
    ) -> Iterable[Float[np.ndarray, "H W 3"]]:
        """Returns one image per view to compare with the reference image: a render, or the picture of another codec.

        Args:
            unit: The task.
            arrived: The received scene of the task, before concealment.
            views: Cameras with the reference images.
        """
        if arrived.scene is None:
            paths = picture_paths(Path(unit.stream.path), unit.references)
            return read_pictures(paths, views.cameras.height, views.cameras.width, unit.references.background)
        if not unit.references.frames:
            scene = conceal_if_received(arrived.scene, create_concealer(unit.concealer, **unit.options))
            # Rendered references were already examined during rendering.
            if not unit.references.renders and unit.references.digest not in self._examined:
                self._examined.add(unit.references.digest)
                warn_of_near_plane(scene, views.cameras)
            return iterate_views(scene, views.cameras, renderer=unit.renderer, background=views.background)
        stream = self._stream(unit)
        assert stream is not None
        method = temporal_concealer(unit.concealer, **unit.options)
        return concealed_pictures(
            stream, unit.mask, unit.loss, unit.seed or 0, method, views.cameras, unit.references.chosen, unit.renderer
        )

    def _write_pictures(
        self, unit: Unit, kept: dict[int, np.ndarray], arrived: ReceivedInput, views: ReferenceViews
    ) -> None:
        for view, pixels in kept.items():
            self.store.write(unit.picture(view), png_bytes(pixels))
        loss_mask, hard = arrived.loss_mask, next(iter(kept), None)
        if (
            hard is None
            or loss_mask is None
            or unit.references.frames
            or unit.erode is not None
            or not (unit.loss or loss_mask.num_lost)
        ):
            return
        if not (self.store.root / unit.loss_map(hard)).is_file():
            reference = views.reference(hard)
            losses = draw_loss_map(arrived.positions, loss_mask.fully_received, views.cameras, hard, reference)
            self.store.write(unit.loss_map(hard), png_bytes(losses))

    def arrived(self, unit: Unit) -> ReceivedInput:
        """Returns the scene that a task scores: decoded from the packets that its loss mask leaves."""
        stream = self._stream(unit)
        sent = stream if stream is None or unit.mask is None else unit.mask.apply(stream)
        arrived = self._decoded(unit, unit.mask_digest, sent)
        if unit.erode is not None and unit.mask is not None and arrived.loss_mask is not None:
            whole = self._decoded(unit, "", stream).scene
            if not isinstance(whole, ReceivedScene) or Anchors not in whole.provides:
                raise InvalidValueError("only anchors lose one attribute alone: explicit Gaussians do not")
            eroded = erode(whole, ~arrived.loss_mask.fully_received, Attribute[unit.erode.upper()])
            arrived = dataclasses.replace(arrived, scene=eroded, loss_mask=eroded.loss_mask)
        return arrived

    def _stream(self, unit: Unit) -> SceneStream | None:
        """Returns the stream of a task; None for a scene file that is evaluated without transmission."""
        return self.store.files.stream(self.store.root / unit.stream.path) if unit.stream.num_packets else None

    def _decoded(self, unit: Unit, mask: str, sent: SceneStream | None) -> ReceivedInput:
        def decode() -> ReceivedInput:
            if unit.stream.elements == PICTURES:
                return ReceivedInput(None, None, 0, sum(unit.stream.parts.values()), 0.0)
            if sent is None:
                path, num_bytes = self.store.root / unit.stream.path, sum(unit.stream.parts.values())
                if file_kind(path) is HACPP:
                    return ReceivedInput(self.store.files.model(path), None, 0, num_bytes, 0.0)
                loaded_scene = self.store.files.loaded_scene(path)
                return ReceivedInput(loaded_scene.loaded, loaded_scene.loss_mask, 0, num_bytes, 0.0)
            started = time.perf_counter()
            received = self.decode(sent)
            seconds = time.perf_counter() - started
            return ReceivedInput(received, received.loss_mask, len(sent.packets), sent.num_bytes, seconds)

        return keep(self._arrived, (unit.stream.digest, mask), _SCENES, decode)

    def _shared_fields(self, unit: Unit, arrived: ReceivedInput) -> dict[str, Any]:
        """Returns the part of a task's results that is the same for all views, such as the number of lost packets."""
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
            "num_anchors": unit.stream.num_anchors if unit.references.frames else len(arrived.positions),
            "num_lost_anchors": arrived.num_lost,
            "num_packets": unit.stream.num_packets,
            "num_lost_packets": unit.stream.num_packets - arrived.num_packets,
            "num_datagrams": unit.mask and unit.mask.num_datagrams,
            "num_lost_datagrams": unit.mask and unit.mask.num_lost_datagrams,
            "num_bytes_received": arrived.num_bytes,
            "seconds_decode": arrived.seconds,
        }

    def _scores(self, unit: Unit, view: int, pictures: Compared, *, lpips: bool) -> dict[str, Any]:
        value = pictures.measure("psnr")
        equal = math.isinf(value)  # slower metrics are known then
        scores: dict[str, Any] = dict.fromkeys(DEFAULT_METRICS)
        if "psnr" in unit.metrics:
            scores["psnr"] = value
        if "ssim" in unit.metrics:
            scores["ssim"] = 1.0 if equal else pictures.measure("ssim")
        measured = [name for name in unit.metrics if name not in DEFAULT_METRICS]
        scores["others"] = {name: None if name in LPIPS_SCALED else pictures.measure(name) for name in measured}
        for name in LPIPS_SCALED.keys() & set(unit.metrics) if lpips else ():
            target = scores if name in scores else scores["others"]
            target[name] = 0.0 if equal else self._distance(unit, view, pictures, scaled=LPIPS_SCALED[name])
        return scores

    def _distance(self, unit: Unit, view: int, pictures: Compared, *, scaled: bool) -> float:
        if self._lpips is None:
            self._lpips = self._load_lpips()
        key = (unit.references.digest, view, scaled)
        features = self._features.get(key)
        if features is None:
            features = self._lpips.features(pictures.reference, scaled=scaled)
            size = sum(tensor.nbytes for tensor in features)
            while self._features and (len(self._features) + 1) * size > _MAX_FEATURE_BYTES:
                self._features.popitem(last=False)
            self._features[key] = features
        return float(self._lpips.distance(self._lpips.features(pictures.image, scaled=scaled), features)[0])

    @staticmethod
    def _load_lpips() -> Any:
        files = find_lpips_files()
        if files is None:
            raise SplatwireError("this worker has no LPIPS weights: set SPLATWIRE_LPIPS_DIR for it, too")
        return load_lpips(*files)


def erode(whole: ReceivedScene, anchors: Bool[np.ndarray, "N"], attribute: Attribute) -> ReceivedScene:
    """Sets one attribute of the given anchors to zero, to measure the effect of losing only this attribute.

    Section 3.2.1 of the paper (`docs/paper-map.md`) calls this a partial loss.

    Args:
        whole: The complete scene.
        anchors: Mask of anchors that lose the attribute.
        attribute: The attribute.

    Returns:
        The scene with the lost values set to zero.
    """
    received = whole.loss_mask.received.copy()
    received[:, int(attribute)] &= ~anchors
    field = _FIELDS[attribute]
    lost = to_numpy(getattr(whole.scene.anchors, field)).copy()
    lost[anchors] = 0
    eroded = dataclasses.replace(whole.scene.anchors, **{field: lost})
    return dataclasses.replace(whole, scene=whole.scene.with_elements(eroded), loss_mask=LossMask(received))


_FIELDS = {
    Attribute.FEATURE: "features",
    Attribute.SCALING: "scalings",
    Attribute.OFFSET: "offsets",
    Attribute.MASK: "mask",
}


def _timed(images: Any) -> Iterator[tuple[Float[np.ndarray, "H W 3"], float]]:
    """Yields images with the rendering time of each in seconds."""
    source = iter(images)
    while True:
        started = time.perf_counter()
        image = next(source, None)
        if image is None:
            return
        yield image, time.perf_counter() - started
