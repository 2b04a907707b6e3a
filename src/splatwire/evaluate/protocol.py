"""What an evaluation compares: methods, losses and seeds, as plain data."""

from dataclasses import dataclass

from splatwire.channel import LossModel, Nothing
from splatwire.errors import InvalidValueError

MAX_SEEDS = 1000
USUAL_ORDER = ("drop", "prior", "idw", "cari", "grow")
"""Rows of a table from the simplest concealer on; others follow in the order in which they are named."""


@dataclass(frozen=True)
class Method:
    """One row of a table.

    Attributes:
        name: What the row is called.
        stream: Which of the streams given to the runner it uses.
        concealer: Name of the concealer.
        lossless: Whether it is spared from losses (the reference row).
    """

    name: str
    stream: str = "stream"
    concealer: str = "drop"
    lossless: bool = False


@dataclass(frozen=True)
class Protocol:
    """An evaluation; every method meets the same losses.

    Attributes:
        methods: The rows, in the order of the table.
        loss: What the channel loses.
        seeds: One transmission per seed; PSNR is averaged over views, then over seeds.
        send_order: As in `splatwire.channel.transmit`.
        renderer: Name of the renderer.
        lpips_views: Most views that LPIPS is computed on (it is slow on a CPU), spread evenly; None for all.
        picture_views: Views whose pictures are kept for a report, hardest first.

    Raises:
        InvalidValueError: If there is no method, no seed, a negative or repeated seed, or a name is there twice.
    """

    methods: tuple[Method, ...]
    loss: LossModel = Nothing()  # noqa: RUF009 - frozen, without state
    seeds: tuple[int, ...] = (0,)
    send_order: str = "interleaved"
    renderer: str = "cpu"
    lpips_views: int | None = None
    picture_views: int = 2

    def __post_init__(self) -> None:
        names = [method.name for method in self.methods]
        if not names or len(set(names)) != len(names):
            raise InvalidValueError(f"methods must be there, and each once: {', '.join(names) or 'none'}")
        if not 1 <= len(self.seeds) <= MAX_SEEDS or len(set(self.seeds)) != len(self.seeds) or min(self.seeds) < 0:
            raise InvalidValueError(f"seeds must be 1 to {MAX_SEEDS} different numbers from 0, not {list(self.seeds)}")
        if self.lpips_views is not None and self.lpips_views < 1:
            raise InvalidValueError(f"LPIPS needs at least one view, not {self.lpips_views}")

    @property
    def lossy_methods(self) -> tuple[Method, ...]:
        """The methods that meet losses."""
        return tuple(method for method in self.methods if not method.lossless)


def concealment_methods(
    concealers: tuple[str, ...], *, complete: bool = True, contiguous: bool = False
) -> tuple[Method, ...]:
    """Builds the usual rows: no loss, contiguous drop, then one per concealer.

    Args:
        concealers: Names of concealers.
        complete: Whether the stream is complete, so that there can be a row without loss.
        contiguous: Whether a stream named `contiguous` is there for the ablation of the grouping.
    """
    rows = [Method("no loss", lossless=True)] if complete else []
    rows += [Method("contiguous drop", "contiguous")] if contiguous else []
    usual = {name: index for index, name in enumerate(USUAL_ORDER)}
    ordered = sorted(dict.fromkeys(concealers), key=lambda name: usual.get(name, len(usual)))
    return (*rows, *(Method(name, concealer=name) for name in ordered))
