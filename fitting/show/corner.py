"""Corner plots of a posterior."""

import textwrap
from collections.abc import Iterator, Sequence

import corner as drawing
import numpy as np
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import FixedFormatter, FixedLocator, MaxNLocator, NullFormatter, NullLocator

from ..pipeline.draws import NoPicture
from ..results.schema import ParameterResult
from ..support.weighted import quantiles
from .style import COLUMN_INCHES, FITTED, LETTERS, PAGE_INCHES, SMALL, new, plain, printable, symbol
from .subject import Subject

WIDE_AXIS = 8.0  # times its lower end, from which on a logarithmic axis has ticks at 1, 3 or 10
WATERMARK = "CHAIN TOO SHORT"
UNITS = {"1": "", "um": "µm"}
MARGIN = 0.56  # inches, left and below
LINE = 1.25 * LETTERS / 72  # inches
EDGE = 0.05  # inches, to the right
GAP = 0.08  # between panels, of a panel
APART = 1.1 * SMALL / 72  # inches from the middle of a tick's digits to the next one's
MOST_TICKS = 3
LETTER = 0.58 * SMALL / 72  # inches of a digit


@printable
def corner(subject: Subject, parameters: Sequence[str] = ()) -> Figure:
    """Marginals of what all channels share and of the middle channel: as many parameters as a column has room for.

    Args:
        parameters: these instead, as the JSON has them (``n_R``), or with one for each channel (``n``).
    """
    if parameters:
        return _corner(subject, _chosen(subject, parameters), COLUMN_INCHES, "")
    middle = subject.model.channels[len(subject.model.channels) // 2]
    free = _free(subject)
    kept = [k for k in free if subject.result.parameters[k].channel in (None, middle)]
    return _corner(subject, kept, COLUMN_INCHES, f"; channel {plain(middle)}" if len(kept) < len(free) else "")


@printable
def corner_all(subject: Subject) -> Figure:
    """Marginals of all parameters that were fitted, as wide as a page."""
    return _corner(subject, _free(subject), PAGE_INCHES, "")


def _chosen(subject: Subject, parameters: Sequence[str]) -> list[int]:
    free, every = _free(subject), subject.result.parameters
    for name in parameters:
        if not any(name in (every[k].name, every[k].parameter) for k in free):
            known = ", ".join(every[k].name for k in free)
            raise NoPicture(f"there is no parameter {name!r} that was fitted; there are {known}")
    return [k for name in parameters for k in free if name in (every[k].name, every[k].parameter)]


def _free(subject: Subject) -> list[int]:
    """Parameters that were fitted, each by itself."""
    return [k for k, q in enumerate(subject.result.parameters) if q.fitted == "free"]


def _corner(subject: Subject, kept: Sequence[int], width: float, said: str) -> Figure:
    """A chain that is too short gets a watermark. Parameters with log-normal priors have logarithmic axes."""
    chain, names = subject.draws, [subject.result.parameters[k] for k in kept]
    weights, values = chain["weights"].ravel(), chain["values"][:, list(kept)]
    bounds = quantiles(values, weights, (0.005, 0.05, 0.95, 0.995)).T
    scales = [
        "log" if "log-normal" in q.prior and low > 0 else "linear" for q, (low, *_) in zip(names, bounds, strict=True)
    ]
    ranges = [
        _range(low, high, q.value, scale) for q, (low, _, _, high), scale in zip(names, bounds, scales, strict=True)
    ]
    heading = f"orange: fit; dashed, in brackets: 5 and 95 %{said}"
    if subject.titled:
        heading = f"{subject.heading}\n{heading}"
    head = LINE * len(heading.splitlines()) + 0.06
    figure = new(width + head - 0.05, width, layout=None)
    figure.set_label(subject.heading)
    figure.text(0.5, 1 - 0.03 / figure.get_figheight(), heading, ha="center", va="top")
    drawing.corner(
        values, weights=weights, truths=[q.value for q in names], fig=figure, range=ranges,
        axes_scale=scales,  # pyright: ignore[reportArgumentType] - a list is taken, too: its docstring
        smooth=1.0, plot_datapoints=False, fill_contours=True, truth_color=FITTED,
        hist_kwargs={"linewidth": 0.6},
        contour_kwargs={"linewidths": 0.4},
    )  # fmt: skip
    axes = np.array(figure.axes).reshape(len(names), len(names))
    for line in (line for axis in figure.axes for line in axis.lines if line.get_color() == FITTED):
        line.set(markersize=2, linewidth=0.6)  # which corner takes no word of
    for k, (q, (_, low, high, _)) in enumerate(zip(names, bounds, strict=True)):
        axes[-1, k].set_xlabel(label(q))
        axes[-1, k].xaxis.set_label_coords(0.5, -(MARGIN - 0.15) / _panel(width, len(names)))
        if k:
            axes[k, 0].set_ylabel(label(q))
            axes[k, 0].yaxis.set_label_coords(-(MARGIN - 0.15) / _panel(width, len(names)), 0.5)
        for x in (low, high):
            axes[k, k].axvline(x, color="black", linewidth=0.5, linestyle="--")
        _ticks_of(axes, k, _ticks(*ranges[k], scales[k], _panel(width, len(names))))
    high = figure.get_figheight()
    figure.subplots_adjust(
        left=MARGIN / width, bottom=MARGIN / high, right=1 - EDGE / width, top=1 - head / high, wspace=GAP, hspace=GAP
    )
    _table(figure, names, bounds, 1 - head / high)
    posterior = subject.result.posterior
    if posterior is not None and not posterior.sufficient:
        _watermark(figure, plain(posterior.message))
    return figure


def _panel(width: float, count: int) -> float:
    """Its inches."""
    return (width - MARGIN - EDGE) / (count + GAP * (count - 1))


def _table(figure: Figure, names: Sequence[ParameterResult], bounds: np.ndarray, top: float) -> None:
    """Values and intervals, where a corner plot has nothing."""
    line = 1.15 * SMALL / 72 / figure.get_figheight()
    texts = [f"[{low:.3g}, {high:.3g}]" for _, low, high, _ in bounds]
    room = max(0.7, LETTER * max(map(len, texts)))
    edges = [0.985 - x / figure.get_figwidth() for x in (room + 0.5, room + 0.08, 0.0)]
    for q, interval in zip(names, texts, strict=True):
        top -= line
        unit = UNITS.get(q.unit, q.unit)
        cells = (f"{label(q)}{f' ({unit})' if unit else ''}", f"{q.value:.3g}", interval)
        for edge, cell in zip(edges, cells, strict=True):
            figure.text(edge, top, cell, fontsize=SMALL, ha="right", va="baseline")


def label(q: ParameterResult) -> str:
    """Symbol and channel."""
    return symbol(q.symbol, q.parameter) + (f" {plain(q.channel)}" if q.channel else "")


def _ticks_of(axes: np.ndarray, k: int, ticks: list[float]) -> None:
    """Ticks of a row and its column, with words at the edges alone."""
    said = [f"{x:g}" for x in ticks]
    for j in range(len(axes)):
        if j >= k:
            _mark(axes[j, k].xaxis, ticks, said if j == len(axes) - 1 else [])
        if j < k:
            _mark(axes[k, j].yaxis, ticks, said if j == 0 else [])
    axes[-1, k].tick_params(axis="x", labelrotation=90)
    axes[k, 0].tick_params(axis="y", labelrotation=0)


def _range(low: float, high: float, value: float, scale: str) -> tuple[float, float]:
    """What an axis shows: nearly all draws and the fitted value, with a margin."""
    forward, back = (np.log, np.exp) if scale == "log" else (np.asarray, np.asarray)
    a, b = (float(forward(x)) for x in (min(low, value), max(high, value)))
    margin = 0.05 * (b - a) or 0.05 * abs(a) or 1e-3
    return float(back(a - margin)), float(back(b + margin))


def _ticks(low: float, high: float, scale: str, panel: float) -> list[float]:
    """Two or three round numbers, as far apart as letters need, the neighbour's included.

    Args:
        panel: inches.
    """
    forward = np.log if scale == "log" else np.asarray
    first, last = forward(low), forward(high)
    best: list[float] = []
    for found in _round_numbers(low, high, scale):
        places = {x: float((forward(x) - first) / (last - first)) * panel for x in found if low < x < high}
        inside = [
            x for x, place in places.items() if APART / 2 <= place + GAP * panel / 2 <= (1 + GAP) * panel - APART / 2
        ]
        for stride in range(1, max(len(inside), 1) + 1):
            kept = inside[::stride]
            if len(kept) <= MOST_TICKS and np.all(np.diff([places[x] for x in kept]) >= APART):
                if len(kept) > 1:
                    return kept
                best = best or kept
    return best or [float(np.sqrt(low * high)) if scale == "log" else (low + high) / 2]


def _round_numbers(low: float, high: float, scale: str) -> Iterator[list[float]]:
    """Series of them over an axis, the coarsest first."""
    if scale == "log" and high / low > WIDE_AXIS:
        decades = range(int(np.floor(np.log10(low))), int(np.ceil(np.log10(high))) + 1)
        for digits in ((1,), (1, 3), (1, 2, 5)):
            yield [float(f"{m}e{k}") for k in decades for m in digits]
    for count in range(2, 13):
        steps = MaxNLocator(count, steps=[1, 2, 2.5, 5, 10]).tick_values(low, high)
        yield [float(np.round(x, 12)) for x in steps]


def _mark(axis: Axis, ticks: list[float], said: list[str]) -> None:
    """Ticks of an axis, with or without words."""
    axis.set_major_locator(FixedLocator(ticks))
    axis.set_major_formatter(FixedFormatter(said) if said else NullFormatter())
    axis.set_minor_locator(NullLocator())


def _watermark(figure: Figure, message: str) -> None:
    """Across the picture, and why."""
    size = 4.5 * figure.get_figwidth()
    figure.text(0.5, 0.45, WATERMARK, fontsize=size, color="gray", alpha=0.4, rotation=35, ha="center", va="center")
    said = "\n".join(textwrap.wrap(message, 45))
    figure.text(0.985, 0.42, said, fontsize=LETTERS, color=FITTED, ha="right", va="top")
