"""Settings of the inpainting network; the defaults are the paper's (Sections 3.4 and 4.1.4)."""

from dataclasses import dataclass

from splatwire.arguments import check_fields
from splatwire.concealment.base import check_at_least
from splatwire.errors import InvalidValueError, whole_number

BASELINES = ("prior", "interpolation")
INTERPOLATIONS = ("cari", "idw", "kriging")
QUERY_INPUTS = ("idw", "interpolation")
METRICS = ("mahalanobis", "euclidean")


@dataclass(frozen=True)
class GnnSettings:
    """Settings of the inpainting network and of the use of its outputs.

    Attributes:
        neighbors: Number of known anchors connected to each lost anchor (query), k.
        metric: `mahalanobis` (with the covariance of the known anchor) or `euclidean`.
        hidden: Width of the network, d_h.
        layers: Number of EdgeConv layers.
        heads: Number of heads of the cross-attention; must divide `hidden`.
        cross_attention: False to disable the cross-attention, for an ablation study.
        interpolation: Interpolation method: `cari`, `kriging`, or `idw` over the graph's neighbours. Its result is
            blended with the network's output; at low confidence, it is used alone.
        query_input: Method that fills lost attributes in the network's inputs: `idw` (over the graph's neighbours), or
            `interpolation`.
        baseline: Values to which the network's residuals are added: `prior` (the mean that the hash grid predicts) or
            `interpolation`.
        clip: Maximum absolute residual in prior standard deviations, tau.
        sharpness: alpha of the confidence `exp(-alpha z)`, with the mean absolute residual z in prior standard
            deviations. 0 always gives full confidence, for an ablation study.
        feature_threshold: Minimum confidence for blending a feature, T_f; above 1 the interpolation is always used.
        scaling_threshold: As `feature_threshold`, for scalings, T_s.
        offset_threshold: As `feature_threshold`, for offsets and masks, T_o.
    """

    # The interpolation is also a training target (`LossWeights.distill`).

    neighbors: int = 24
    metric: str = "mahalanobis"
    hidden: int = 128
    layers: int = 2
    heads: int = 4
    cross_attention: bool = True
    interpolation: str = "cari"
    query_input: str = "idw"
    baseline: str = "prior"
    clip: float = 3.0
    sharpness: float = 0.5
    feature_threshold: float = 0.10
    scaling_threshold: float = 1.01
    offset_threshold: float = 1.01

    def __post_init__(self) -> None:
        check_fields(self)
        for label, value in (
            ("number of neighbours", self.neighbors), ("width", self.hidden), ("number of heads", self.heads),
        ):  # fmt: skip
            check_at_least(label, value, 1)
        check_at_least("number of layers", self.layers, 0)
        check_at_least("sharpness of the confidence", self.sharpness, 0)
        check_at_least("clip of residuals", self.clip, 0)
        for name in ("feature", "scaling", "offset"):
            check_at_least(f"{name} threshold", getattr(self, f"{name}_threshold"), 0)
        for name in ("hidden", "neighbors", "layers"):
            whole_number(getattr(self, name), name, 0, 4096)
        if self.hidden % self.heads:
            raise InvalidValueError(f"a width of {self.hidden} with {self.heads} heads is not possible")
        for label, name, known in (
            ("metric", self.metric, METRICS),
            ("interpolation", self.interpolation, INTERPOLATIONS),
            ("query input", self.query_input, QUERY_INPUTS),
            ("baseline", self.baseline, BASELINES),
        ):
            if name not in known:
                raise InvalidValueError(f"{label} must be one of {', '.join(known)}, not {name!r}")


GNN_PRESETS = {
    "paper": GnnSettings(),
    "full": GnnSettings(
        query_input="interpolation", baseline="interpolation", scaling_threshold=0.10, offset_threshold=0.10
    ),
    "compact": GnnSettings(hidden=16, query_input="interpolation", baseline="interpolation", interpolation="kriging"),
}
"""Named settings. `paper`: the paper's constants. `full`: the network predicts all attributes, as residuals added to
the interpolation. `compact`: a small network with few weights."""
