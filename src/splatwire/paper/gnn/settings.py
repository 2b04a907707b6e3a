"""What can be chosen about the inpainting network; the defaults are the paper's (Sections 3.4 and 4.1.4)."""

from dataclasses import dataclass

from splatwire.conceal.base import check_at_least
from splatwire.errors import InvalidValueError

BASELINES = ("prior", "interpolation")
INTERPOLATIONS = ("cari", "idw", "kriging")
QUERY_INPUTS = ("idw", "interpolation")
METRICS = ("mahalanobis", "euclidean")


@dataclass(frozen=True)
class GnnSettings:
    """The network and how its output is used.

    Attributes:
        neighbors: Known anchors that a query is connected to, k.
        metric: `mahalanobis` (by the covariance of the known anchor) or `euclidean`.
        hidden: Width of the network, d_h.
        layers: EdgeConv layers.
        heads: Heads of the cross-attention; divide `hidden`.
        cross_attention: Whether there is one (for the ablation).
        interpolation: The interpolation that teaches the network, is blended with and fallen back to: `cari`,
            `kriging`, or `idw` over the graph's neighbours.
        query_input: The interpolation that the input of a query holds: `idw` over the graph's neighbours, or
            `interpolation` for the one above.
        baseline: What a residual is added to: `prior`, or `interpolation`.
        clip: Largest residual in prior standard deviations, tau.
        sharpness: alpha of the confidence `exp(-alpha z)`; 0 trusts every residual (for the ablation).
        feature_threshold: Confidence from which a feature is blended, T_f; above 1 the interpolation is always taken.
        scaling_threshold: The same for scalings, T_s.
        offset_threshold: The same for offsets and masks, T_o.
    """

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
        for what, value in (
            ("number of neighbours", self.neighbors), ("width", self.hidden), ("number of heads", self.heads),
        ):  # fmt: skip
            check_at_least(what, value, 1)
        check_at_least("number of layers", self.layers, 0)
        check_at_least("sharpness of the confidence", self.sharpness, 0)
        check_at_least("clip of residuals", self.clip, 0)
        for name in ("feature", "scaling", "offset"):
            check_at_least(f"{name} threshold", getattr(self, f"{name}_threshold"), 0)
        if self.hidden % self.heads or max(self.hidden, self.neighbors, self.layers) > 4096:
            raise InvalidValueError(f"a width of {self.hidden} with {self.heads} heads is not possible")
        for what, name, known in (
            ("metric", self.metric, METRICS),
            ("interpolation", self.interpolation, INTERPOLATIONS),
            ("query input", self.query_input, QUERY_INPUTS),
            ("baseline", self.baseline, BASELINES),
        ):
            if name not in known:
                raise InvalidValueError(f"{what} must be one of {', '.join(known)}, not {name!r}")


GNN_PRESETS = {
    "paper": GnnSettings(),
    "full": GnnSettings(
        query_input="interpolation", baseline="interpolation", scaling_threshold=0.10, offset_threshold=0.10
    ),
    "compact": GnnSettings(hidden=16, query_input="interpolation", baseline="interpolation", interpolation="kriging"),
}
"""`paper`: the paper's constants. `full`: all attributes are predicted, on top of the interpolation. `compact`: few
weights."""
