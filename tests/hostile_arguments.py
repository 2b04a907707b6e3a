"""Calls every public function and constructor with wrong arguments, one at a time, and prints the raw errors as JSON.

Runs as a program, because the suite's checks of annotations would precede those of the package.

Usage: python hostile_arguments.py FOLDER PACKAGE
"""

import dataclasses
import functools
import importlib
import inspect
import json
import logging
import re
import signal
import sys
import warnings
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

import splatwire
from moving_sequences import splatv
from scenes import tiny_cameras, tiny_causal_scene, tiny_scene
from splatwire.bitstream import PacketId, Packetization, PacketMembers
from splatwire.bitstream.tile_selection import Viewpoint
from splatwire.data import Dataset
from splatwire.errors import SplatwireError, shown
from splatwire.files.kinds import STREAM
from splatwire.types import SplatScene
from splatwire.types.splats import Splats

PACKAGES = (
    "", "io", "types", "io.formats", "bitstream", "channel", "codec", "concealment", "render", "data", "metrics",
    "evaluation", "sequence", "lod", "transport", "view", "planning", "calibration", "paper", "neural.training",
    "neural.importers",
)  # fmt: skip
"""Packages with public names to call; the empty name is `splatwire` itself."""
NAMES = {
    "planning": (
        "candidates.PlanConstraints", "candidates.arrival_within", "candidates.baseline_candidates",
        "candidates.candidates",
        "candidates.max_init_segment_bytes", "distortion.DistortionModel", "distortion.StreamVariant",
        "distortion.lost_fractions", "feedback.plan_retransmission", "measure.LossyPictures",
        "measure.received_elements", "measure.measure_distortion", "measure.measured_variant",
        "measure.packet_members", "measure.variant_of_stream",
        "plan_file.plan_content", "plan_file.read_plan", "planner.draw_transfer_losses", "planner.expected_result",
        "planner.plan_protection", "transfer_model.SimulatedTransfers", "transfer_model.StreamLoad",
        "transfer_model.draw_losses", "transfer_model.side_info_arrivals", "transfer_model.model_transfer",
        "transfer_model.simulate",
    ),
    "calibration": (
        "preview.PreviewConfig", "preview.preview_for_scene", "pseudo_loss.calibration_data",
        "pseudo_loss.dropped_packets", "pseudo_loss.pseudo_loss", "sketch.sketch_of", "sketch_config.SketchConfig",
        "sketch_fit.SketchFit", "views.CalibrationViews", "views.spread_evenly",
    ),
    "neural.importers": ("hacpp.import_hacpp", "scaffold.import_scaffold"),
}  # fmt: skip
"""Names of packages that export none: each with its module."""
RESULTS = frozenset(
    ("Attribute", "Scene", "LossModel", "Concealer", "Renderer", "SplatwireError", "ReadReport", "StreamSizes",
     "TransmitRecord", "TrackingReport", "PacketAssignment", "PacketBatch", "Cut", "MovingSplats", "LoadedScene",
     "SequenceFrame",
     "Pictures", "Scores", "Event", "Finished", "PacketArrived", "SideInfoArrived", "StreamReplaced", "Welcomed",
     "ServedStream", "Progress", "QualityReport", "TrainResult", "GnnWeights", "TrainingServer")
)  # fmt: skip
"""Names that are not called by users: protocols, an enumeration, and types of results."""
UNFINISHED = ("import_hacpp", "import_scaffold", "register_format", "register_schema", "Gnn", "train_scene")
"""Names that cannot be called with the values of `Pool`, because a valid call needs a model folder or a plug-in."""
SYNONYMS = {
    "width": "pixels", "height": "pixels", "arrival_bad": "bad state", "arrival_good": "good state",
    "data": "byte|JSON|not a|is no plan",
    "size_gain": "left_out", "gaps": "packet", "stream_id": "belongs to stream", "sections": "each item",
    "num_frames": "a number is for", "parts": "no Gaussian",
    "variants": "variants", "rendered_trials": "trials", "budget_bytes": "budget", "appearance": "not a model folder",
    "test": "at least 2 views", "options": "at least 2 views|Options", "state": "at least 2 views|TrainState",
    "listener": "at least 2 views",
}  # fmt: skip
"""Words by which messages name a parameter."""
SECONDS = 600
"""Time limit of a call. The first ones compile kernels, which takes minutes on a busy machine."""


def hostile() -> dict[str, Any]:
    """Wrong values for any parameter, by name."""
    return {
        "None": None,
        "object": object(),
        "text": "nonsense",
        "empty text": "",
        "number": 3,
        "True": True,
        "NaN": float("nan"),
        "infinity": float("inf"),
        "negative": -1,
        "huge": 10**30,
        "longer than Python prints": 10**5000,
        "bytes": b"nonsense",
        "list": [1, 2],
        "ragged list": [[1], [1, 2]],
        "tuple of None": (None, None, None),
        "dictionary": {"a": 1},
        "generator": (number for number in range(3)),
        "class": int,
        "empty array": np.zeros(0, np.float32),
        "NaN array": np.full((3, 3), np.nan, np.float32),
        "negative integers": np.full(300, -3),
        "array of objects": np.array([None, "a"], object),
        "array of text": np.array(["a", "b"]),
        "0-dimensional array": np.array(1.5),
        "module": json,
    }


class Pool:
    """Valid arguments of all public names."""

    def __init__(self, folder: Path) -> None:
        draw = np.random.default_rng(0)
        count = 300

        def random(*shape: int) -> np.ndarray:
            return draw.random(shape, np.float32)

        self.folder = folder
        self.splats = Splats(
            random(count, 3), random(count, 4), random(count, 3) * np.float32(0.05),
            random(count) * np.float32(0.9) + np.float32(0.05), random(count, 1, 3),
        )  # fmt: skip
        self.scene = SplatScene(self.splats)
        self.cameras = tiny_cameras(1, 16, 12)
        self.anchors = tiny_scene(num_anchors=60)
        self.causal = tiny_causal_scene(num_anchors=60)
        self.stream = splatwire.encode_scene(self.scene, "datagram")
        self.received_scene = splatwire.decode_stream(self.stream)
        self.ply, self.swz, self.views = folder / "scene.ply", folder / "scene.swz", folder / "cameras.json"
        splatwire.save_scene(self.scene, self.ply)
        splatwire.write_stream(self.stream, self.swz)
        importlib.import_module("splatwire.data").save_cameras(self.cameras, self.views)
        self.trace = folder / "trace.txt"
        self.trace.write_text("1 0 1\n")
        self.photo = folder / "dataset" / "0000.png"
        self.photo.parent.mkdir()
        for split, names in (("train", ("0001.png", "0002.png")), ("test", ("0000.png",))):
            frames = []
            for number, name in enumerate(names):
                Image.fromarray(np.full((16, 16, 3), len(split) + number, np.uint8)).save(self.photo.with_name(name))
                pose = np.eye(4)
                pose[:3, 3] = number
                frames.append({"file_path": name, "transform_matrix": pose.tolist()})
            transforms = {"camera_angle_x": 1.0, "frames": frames}
            (self.photo.parent / f"transforms_{split}.json").write_text(json.dumps(transforms))
        self.moving = folder / "clip.splatv"
        self.moving.write_bytes(splatv())
        self.frames = folder / "frames"
        self.frames.mkdir()
        for number in range(2):
            splatwire.save_scene(self.scene, self.frames / f"{number:03d}.ply")

    @functools.cached_property
    def clip(self) -> Any:
        """A stream of a sequence."""
        sequence = importlib.import_module("splatwire.sequence")
        return sequence.encode_sequence([self.splats, self.splats])[0]

    @functools.cached_property
    def levels(self) -> Any:
        """A stream with levels of detail."""
        return importlib.import_module("splatwire.lod").encode_levels(self.scene)

    def value(self, owner: str, name: str, *, optional: bool = False) -> Any:
        """A valid value of a parameter; with `optional`, only if it is given for this owner.

        Raises:
            KeyError: If none is known.
        """
        found = self._table.get(f"{owner}.{name}", KeyError if optional else self._table.get(name, KeyError))
        if found is KeyError:
            raise KeyError(f"{owner}.{name}")
        return found() if callable(found) and getattr(found, "__name__", "") == "<lambda>" else found

    @functools.cached_property
    def _table(self) -> dict[str, Any]:
        splats, anchors, manifest = self.splats, self.anchors.anchors, self.stream.manifest
        network, coding = self.anchors.heads.opacity, self.anchors.coding
        prior = splatwire.decode_stream(splatwire.encode_scene(self.anchors)).records[0]
        images = np.zeros((1, 16, 16, 3), np.float32)
        records = {
            name: value
            for record in (splats, anchors, self.anchors.heads, coding.context_model.grid, coding.context_model, coding,
                           network, network.hidden, self.causal.coding, self.cameras, manifest)
            for name, value in ((f"{type(record).__name__}.{f.name}", getattr(record, f.name))
                                for f in dataclasses.fields(record) if f.init)
        }  # fmt: skip
        return {
            **records,
            **{f"make_stream.{name.partition('.')[2]}": value for name, value in records.items()
               if name.startswith("Manifest.")},
            **{f"Prior.{f.name}": getattr(prior, f.name) for f in dataclasses.fields(prior)},
            **{f"AttributePrior.{f.name}": getattr(prior.feature, f.name) for f in dataclasses.fields(prior.feature)},
            **{f"SplatCoding.{f.name}": getattr(self.received_scene.scene.coding, f.name)
               for f in dataclasses.fields(self.received_scene.scene.coding)},
            **{f"Gaussians.{name}": getattr(splats, name) for name in ("means", "quats", "scales", "opacities")},
            "Gaussians.colors": splats.scales,
            "AnchorScene.anchors": anchors, "AnchorScene.heads": self.anchors.heads, "AnchorScene.coding": coding,
            "scene": self.scene, "scene_in_order.scene": self.anchors, "loaded": self.received_scene,
            "value": self.scene, "conceal.received": self.received_scene, "save_decoded.received": self.received_scene,
            "splats": splats, "parts": lambda: [splats], "fallback": splats,
            "loss_mask": self.received_scene.loss_mask, "cameras": self.cameras, "stream": self.stream,
            "manifest": manifest, "side_info": self.stream.side_info, "packets": self.stream.packets,
            "make_stream.packets": self.stream.packets,
            "path": self.ply, "read_stream.path": self.swz, "write_stream.path": self.folder / "written.swz",
            "save_scene.path": self.folder / "written.ply", "save_decoded.path": self.folder / "written.ply",
            "load_cameras.path": self.views, "save_cameras.path": self.folder / "written.json",
            "write_splats.path": self.folder / "written.ply", "Trace.path": self.trace,
            "model_dir": self.folder, "concealer": "drop", "decode_frame.concealer": "drop",
            "decode_frames.concealer": "drop", "SequenceDecoder.concealer": "drop", "save_decoded.concealer": None,
            "name": "drop", "with_section.name": "sketch", "without_section.name": "sketch",
            "create_renderer.name": "cpu", "packetization_named.name": "paper", "schema_named.name": "gaussians",
            "register_loss_model.name": "mine", "register_metric.name": "mine", "register_concealer.name": "mine",
            "spec": "bernoulli:0.2", "loss": "bernoulli:0.2", "base": self.stream,
            "update": lambda: splatwire.encode_update(self.stream, self.scene),
            **{f"{name}.loss": splatwire.parse_loss("bernoulli:0.2") for name in
               ("draw_mask", "draw_losses", "draw_transfer_losses", "plan_protection", "plan_retransmission")},

            "seed": 0, "packetization": Packetization(), "repack.packetization": Packetization(),
            "kind": STREAM, "schema": "gaussians", "register_schema.schema": lambda: None, "schema_name": "gaussians",
            "form": lambda: None, "content": b"", "classes": np.zeros(300, np.uint8),
            "num_elements": 300, "num_packets": 1, "id": PacketId(0, 0), "packet_id": PacketId(0, 0), "data": b"1234",
            "stream_from_bytes.data": importlib.import_module("splatwire.bitstream").stream_to_bytes(self.stream),
            "manifest_from_bytes.data": importlib.import_module("splatwire.bitstream").manifest_to_bytes(manifest),
            "packet_from_bytes.data": self.stream.packets[0].data, "stream_id": manifest.stream_id,
            "side_info_parts.data": self.stream.side_info, "payload": b"1234", "packet": self.stream.packets[0].data,
            "send_order": "interleaved", "tiers": np.zeros(300, np.uint8), "plan": manifest.plan,
            "x": np.arange(4, dtype=np.uint64),
            "block": 0, "index_in_block": 0, "lanes": 1, "rate": 0.2, "SequenceOptions.rate": Fraction(30),
            "mean_burst": 3.0,
            "received": np.ones((300, 4), np.bool_), "PacketLossMask.received": np.ones(3, np.bool_),
            "num_datagrams": 3, "num_lost_datagrams": 0,
            "size_gain": np.ones(300, np.float32), "left_out": np.zeros(300, np.bool_),
            "order": "morton", "images": images, "references": images, "masks": np.ones((1, 16, 16), np.bool_),
            "mse": np.ones(3), "source": "photos", "load": images.__getitem__,
            "ReferenceViews.load": images.__getitem__,
            "dataset": Dataset(self.cameras, (self.photo,)), "indices": None,
            "positions": splats.means, "colors": splats.means, "SparsePoints.positions": splats.means,
            "image_paths": (self.photo,), "load_photo.path": self.photo,
            "open_dataset.path": self.photo.parent, "read_splatv.path": self.moving,
            "Copies.indices": np.arange(300), "growth": (0.0, 0.0, 0.0),
            "sizes": np.ones(300, np.float32), "size": 1.0, "opacity": 1.0, "load_photo.size": (8, 8),
            "frames": lambda: [splats, splats], "files": sorted(self.frames.iterdir()), "folder": self.frames,
            "open_sequence.path": self.frames, "is_sequence.path": self.frames, "drawn": np.ones(300, np.bool_),
            "sequence": lambda: splatwire.decode_stream(self.clip).scene, "number": 0, "record": None,
            "SequenceDecoder.manifest": lambda: self.clip.manifest,
            "SequenceDecoder.side_info": lambda: self.clip.side_info,
            "tiles_of.stream": lambda: self.levels, "tiles": lambda: self._tiles,
            "cut_of.received": lambda: self._received,
            "cut_of.viewpoint": Viewpoint(np.eye(4), 100.0, 64, 64), "viewmat": np.eye(4), "focal": 100.0, "width": 64,
            "height": 64, "description": "a file", "Packetization.order": "morton", "SequenceOptions.order": "auto",
            "hidden": network.hidden,
            "url": "udp://127.0.0.1/scene", "streams": {"scene": self.stream}, "reference": self.scene,
            **self._of_transfers(), "starts": np.array([0, 300]), "symbols_digest": "0" * 64, "writer": "test",
            "members": PacketMembers(np.arange(300), np.array([0, 300])),
            **{f"Tiles.{name}": (lambda name=name: getattr(self._tiles, name)) for name in
               ("levels", "parents", "counts", "packets", "sizes", "errors", "low", "high")},
        }  # fmt: skip

    def _of_transfers(self) -> dict[str, Any]:
        """Valid arguments of transport, view, planning, calibration and training."""
        training = importlib.import_module("splatwire.neural.training")
        dataset = importlib.import_module("splatwire.data").open_dataset(self.photo.parent, split="train")
        return {
            "nonce": 1, "now": 0.0, "secret": b"0" * 32, "random": bytes,
            **{f"{owner}.streams": lambda: {"a": self._served}
               for owner in ("Server", "UdpServer", "QuicServer", "PageContent")},
            "ServerTransfer.stream": lambda: self._served, "session": 1, "limits": None, "host": "127.0.0.1",
            "ServerTransfer.limits": lambda: importlib.import_module("splatwire.transport").ServerLimits(),
            "receive": print, "relay": lambda: self._relay, "page_of_stream.name": "a",
            "page_of_relay.name": "a", "budget_bytes": 100_000, "load": lambda: self._load,
            "model": lambda: self._transfer, "traces": lambda: np.ones((20, 40), np.bool_),
            "constraints": lambda: importlib.import_module("splatwire.planning.candidates").PlanConstraints(100_000),
            "shares": np.array([0.0, 1.0]), "loss_shares": np.array([0.0, 1.0]), "base_mse": 1e-3,
            "DistortionModel.mse": np.array([[0.0, 0.1]]),
            "distortion": lambda: self._variant.distortion, "lost_fractions.packets": lambda: self._arrival.packets,
            "variants": lambda: [self._variant], "variant": lambda: self._variant, "arrival": lambda: self._arrival,
            "rendered_trials": 2, "trials": 4, "complete": self.received_scene, "LossyPictures.concealer": "drop",
            "measured_variant.progress": print, "num_views": 1, "measured_variant.concealer": "drop",
            "packet_members": lambda: importlib.import_module("splatwire.planning.measure").packet_members(self.stream),
            "received_elements.packets": lambda: np.ones(len(self.stream.packets), np.bool_),
            "pictures": lambda: self._pictures,
            "protection": importlib.import_module("splatwire.transport").Protection(), "facts": {},
            "read_plan.name": "a.plan",
            "read_plan.data": lambda: self._plan(),
            "SimulatedTransfers.side_info": lambda: self._arrival.side_info,
            "SimulatedTransfers.packets": lambda: self._arrival.packets,
            **{f"StreamLoad.{name}": (lambda name=name: getattr(self._load, name)) for name in
               ("init_segment_bytes", "packet_bytes", "elements", "tiers")},
            "num_datagrams": 3, "side_info_arrivals.received": lambda: np.ones((2, len(self._transfer.kind)), np.bool_),
            "simulate.received": lambda: np.ones((2, len(self._transfer.kind)), np.bool_),
            "preview_for_scene.config": lambda: importlib.import_module("splatwire.calibration.preview").PreviewConfig(
                steps=1, num_relocations=1, views=1, width=8, scored_views=1, scored_width=8),
            "sketch_of.config": lambda: importlib.import_module("splatwire.calibration.sketch_config").SketchConfig(
                num_losses=0, num_held_out_losses=0, views=1, width=8, probes=1),
            "views": lambda: self._views, "calibration_data.stream": lambda: self._tiny[0],
            "calibration_data.complete": lambda: self._tiny[1], "sketch_of.stream": lambda: self._tiny[0],
            "sketch_of.complete": lambda: self._tiny[1], "preview_for_scene.scene": self.anchors,
            "count": 3, "num_anchors": 300, "total": 5,
            "pseudo_loss.members": PacketMembers(np.arange(300), np.array([0, 100, 300])),
            "config": training.create_config(iterations=20), "state": lambda: self._state(training, dataset),
            "train": dataset, "test": None,
            "train_scene.train": dataset.select([0]),
            "load_checkpoint.path": lambda: self._checkpoint(training, dataset),
            "save_checkpoint.path": self.folder / "written.checkpoint",
        }  # fmt: skip

    def _plan(self) -> bytes:
        content = importlib.import_module("splatwire.planning.plan_file").plan_content
        return json.dumps(content(importlib.import_module("splatwire.transport").Protection(), 7, {})).encode()

    def _state(self, training: Any, dataset: Any) -> Any:
        return importlib.import_module("splatwire.neural.training.initial").initial_state(
            dataset, training.create_config(iterations=20)
        )

    def _checkpoint(self, training: Any, dataset: Any) -> Path:
        path = self.folder / "a.checkpoint"
        training.save_checkpoint(self._state(training, dataset), training.create_config(iterations=20), path)
        return path

    @functools.cached_property
    def _load(self) -> Any:
        return importlib.import_module("splatwire.planning.transfer_model").StreamLoad.of_stream(self.stream)

    @functools.cached_property
    def _variant(self) -> Any:
        distortion = importlib.import_module("splatwire.planning.distortion")
        tiers = self._load.num_tiers
        mse = np.tile([0.0, 0.01], (tiers, 1))
        return distortion.StreamVariant(self._load, distortion.DistortionModel(np.array([0.0, 1.0]), mse, 1e-3))

    @functools.cached_property
    def _transfer(self) -> Any:
        protection = importlib.import_module("splatwire.transport").Protection(init_repair=0.5)
        return importlib.import_module("splatwire.planning.transfer_model").model_transfer(self._load, protection)

    @functools.cached_property
    def _arrival(self) -> Any:
        model = importlib.import_module("splatwire.planning.transfer_model")
        return model.simulate(self._transfer, np.ones((2, len(self._transfer.kind)), np.bool_))

    @functools.cached_property
    def _pictures(self) -> Any:
        measure = importlib.import_module("splatwire.planning.measure")
        return measure.LossyPictures(self.received_scene, self.cameras, "drop")

    @functools.cached_property
    def _views(self) -> Any:
        return importlib.import_module("splatwire.calibration.views").CalibrationViews(self.cameras)

    @functools.cached_property
    def _tiny(self) -> Any:
        """Small scene of anchors with its stream of several packets, decoded."""
        stream = splatwire.encode_scene(self.anchors, Packetization(block_size=20))
        return stream, splatwire.decode_stream(stream)

    @functools.cached_property
    def _served(self) -> Any:
        return importlib.import_module("splatwire.transport").make_served_stream(self.stream)

    @functools.cached_property
    def _relay(self) -> Any:
        return importlib.import_module("splatwire.view").Relay("udp://127.0.0.1/a", lambda _: None)

    @functools.cached_property
    def _tiles(self) -> Any:
        return importlib.import_module("splatwire.lod").tiles_of(self.levels)

    @functools.cached_property
    def _received(self) -> Any:
        return np.ones(len(self._tiles.levels), np.bool_)


def outcome(call: Any, arguments: dict[str, Any], parameter: inspect.Parameter | None = None) -> str:
    """Result of a call: empty if it works or raises a clear error, else the raw error.

    A clear error names the wrong argument, its type, or its value.
    """

    def late(*_: Any) -> None:
        raise TimeoutError(f"took more than {SECONDS} s")

    signal.signal(signal.SIGALRM, late)
    signal.alarm(SECONDS)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            found = call(**arguments)
            if inspect.isgenerator(found):
                next(found, None)
            if inspect.iscoroutine(found):
                found.close()  # arguments are checked before it runs
        return ""
    except (SplatwireError, OSError) as error:
        if parameter is None:
            return f"a valid call fails: {error}"
        return "" if _names(str(error), parameter, arguments[parameter.name]) else f"does not name it: {error}"
    except Exception as error:
        frames = inspect.getinnerframes(error.__traceback__)
        where = f"{Path(frames[-1].filename).name}:{frames[-1].lineno}"
        return f"{type(error).__name__}: {str(error)[:100]} ({where})"
    finally:
        signal.alarm(0)


def _names(text: str, parameter: inspect.Parameter, value: Any) -> bool:
    kinds = re.findall("[A-Z][A-Za-z]+", str(parameter.annotation))
    own = shown(value) if isinstance(value, int) else str(value)[:40]
    synonyms = SYNONYMS.get(parameter.name, parameter.name).split("|")
    words = (parameter.name, parameter.name.replace("_", " "), *synonyms, shown(value), own, *kinds)
    return any(word.lower() in text.lower() for word in words)


def _public(package: str) -> list[tuple[str, Any]]:
    """Public names of a package and their values."""
    module = importlib.import_module(f"splatwire.{package}" if package else "splatwire")
    if package not in NAMES:
        return [(name, getattr(module, name)) for name in module.__all__]
    paths = [path.rpartition(".") for path in NAMES[package]]
    return [(name, getattr(importlib.import_module(f"splatwire.{package}.{file}"), name)) for file, _, name in paths]


def problems(package: str, pool: Pool) -> dict[str, str]:
    """Raw errors by call, such as `render_scene(background=NaN)`."""
    found = {}
    for name, call in _public(package):
        if not callable(call) or name in RESULTS or (isinstance(call, type) and issubclass(call, Exception)):
            continue
        parameters = [p for p in inspect.signature(call).parameters.values() if p.kind != p.VAR_KEYWORD]
        valid = {}
        for p in parameters:
            try:
                valid[p.name] = pool.value(name, p.name, optional=p.default is not p.empty)
            except KeyError:
                if p.default is p.empty:
                    found[f"{name}.{p.name}"] = "no valid value is known"
        if any(key.startswith(f"{name}.") for key in found):
            continue
        if name not in UNFINISHED and (own := outcome(call, valid)):
            found[f"{name}()"] = own
        for p in parameters:
            for what, value in hostile().items():
                if what == "class" and p.name in ("progress", "received") and name not in ("conceal", "save_decoded"):
                    continue  # a class is callable, and its errors are its own
                if own := outcome(call, {**valid, p.name: value}, p):
                    found[f"{name}({p.name}={what})"] = own
    return found


def main(folder: str, *packages: str) -> None:
    """Prints the raw errors of packages."""
    logging.disable(logging.CRITICAL)
    pool = Pool(Path(folder))
    print(json.dumps({package: problems(package, pool) for package in packages or PACKAGES}))


if __name__ == "__main__":
    main(*sys.argv[1:])
