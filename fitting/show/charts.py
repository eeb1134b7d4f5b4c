"""Charts as Vega-Lite specifications: the browser makes them interactive, and what is drawn without it is the same.

Vega-Lite (Satyanarayan et al. 2017, doi:10.1109/TVCG.2016.2599030); `vl-convert` carries it along, for both.
"""

import json
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import count
from typing import Any

import vl_convert

from ..support.tables import as_csv
from .curves import PAGE_INCIDENCES_DEG, Rows
from .style import CHANNEL_COLOURS, DEGREES, OKABE_ITO

Spec = dict[str, Any]
SCALES = ("cube root", "logarithmic", "linear")
SHAPES = ("circle", "square", "triangle-up", "diamond", "cross")
WIDTH, HEIGHT = 840, 320  # of a plot without a browser, which makes them as wide as the page
INK, LINE, GRID = "currentColor", "#888c", "#8884"
COLOURS = (*OKABE_ITO[:-1], INK)
PADDING = 12  # pixels between marks and the plot's edges
NARROW = 8.0  # times its lower end, up to which a logarithmic axis has room for a word at each tick
DIGITS = 5  # of numbers
ELSEWHERE = "https://vega.github.io/vega-datasets/"  # where Vega puts links to pages beside this one
EXPOSED = "window.vegaEmbed = vegaEmbed;"


def script() -> str:
    """The library, for a file beside the pages."""
    return f"(function () {{{vl_convert.javascript_bundle(EXPOSED)}}})();\n"  # its names stay its own


def svg(spec: Spec, name: str = "chart") -> str:
    """The chart as it is before anybody touches it, a third of the length that Vega writes.

    Its place on the page is a picture with a label, so that labels of single marks are never read out.

    Args:
        name: of the chart on its page: two pictures must not share the names of their clipping paths.
    """
    drawn = vl_convert.vegalite_to_svg(json.dumps(spec)).replace(f'href="{ELSEWHERE}', 'href="')
    drawn = re.sub(r' (?:aria-[a-z]+|role)="[^"]*"', "", drawn)
    drawn = re.sub(r'(?<=["#(])clip(?=\d)', f"{name}-clip", drawn)
    return re.sub(r"(\d\.\d\d)\d+", r"\1", drawn)


def lobes(plane: Rows, parts: Rows, channels: Sequence[str]) -> Spec:
    """Lobes in the plane of incidence, and under them what the middle channel consists of; one slider for both."""
    scaled = ("fit", "file", "alone", "low", "high")
    across = {"field": "o", "type": "quantitative", "title": "θo (degrees), mirror side positive",
              "scale": {"domain": [-90, 90], "nice": False}, "axis": {"values": list(range(-90, 91, 30))}}  # fmt: skip
    up = _scaled_axis()
    there = {name for name in scaled if any(row[name] is not None for row in plane)}

    def layer(mark: str, looks: Spec, name: str, **more: object) -> Spec:
        encoding = {"x": across, "y": up | {"field": f"y_{name}"}, "color": _by_channel(channels), **more}
        return {"mark": {"type": mark, **looks}, "encoding": encoding}

    layers = [layer("area", {"opacity": 0.2}, "low", y2={"field": "y_high"})] if "low" in there else []
    layers.append(layer("line", {"strokeWidth": 1.3}, "fit"))
    if "alone" in there:
        layers.append(layer("line", {"strokeDash": [4, 3], "strokeWidth": 1, "clip": True}, "alone"))
    if "file" in there:
        tips = [_tip("channel", "channel", None), _tip("o", "θo (degrees)", ".3~r"), _tip("file", "file (1/sr)"),
                _tip("fit", "fit (1/sr)"), _tip("ratio", "fit over file")]  # fmt: skip
        looks = {"size": 14, "strokeWidth": 0.8, "opacity": 0.8}
        points = layer("point", looks, "file", shape=_shape(channels), tooltip=tips)
        layers.append(points | {"transform": [{"filter": "isValid(datum.file)"}]})
    rule = {"transform": [{"filter": "datum.i == incidence"}, {"aggregate": [{"op": "max", "field": "i", "as": "i"}]}],
            "mark": {"type": "rule", "strokeDash": [2, 2], "color": "gray"},
            "encoding": {"x": across | {"field": "i"}}}  # fmt: skip
    over = {
        "width": WIDTH, "height": HEIGHT, "data": _data(plane),
        "transform": [
            {"filter": "datum.i == incidence"},
            *({"calculate": _scaled(name), "as": f"y_{name}"} for name in scaled),
            {"calculate": "datum.fit / datum.file", "as": "ratio"},
        ],
        "layer": [*layers, rule],
    }  # fmt: skip
    names, middle = list(dict.fromkeys(row["part"] for row in parts)), channels[len(channels) // 2]
    under = {
        "width": WIDTH, "height": HEIGHT * 2 // 3, "data": _data(parts),
        "title": f"What the fit consists of (channel {middle}, without the grazing loss)",
        "transform": [{"filter": "datum.i == incidence"}, {"calculate": _scaled("value"), "as": "y"}],
        "mark": {"type": "line", "strokeWidth": 1.5, "tooltip": True},
        "encoding": {
            "x": across, "y": up | {"field": "y"},
            "color": {"field": "part", "type": "nominal", "title": None,
                      "scale": {"domain": names, "range": list(COLOURS[: len(names)])}},
            "strokeDash": {"field": "part", "type": "nominal", "title": None, "scale": {"domain": names}},
            "tooltip": [_tip("part", "part", None), _tip("o", "θo (degrees)", ".3~r"), _tip("value", "1/sr")],
        },
    }  # fmt: skip
    first, second, *_, last = PAGE_INCIDENCES_DEG
    slider = {"input": "range", "min": first, "max": last, "step": second - first, "name": "θi (degrees)"}
    return _chart() | {
        "params": [
            {"name": "incidence", "value": 30, "bind": slider},
            {"name": "scale", "value": SCALES[0], "bind": {"input": "select", "options": SCALES, "name": "scale"}},
        ],
        "vconcat": [over, under], "resolve": {"scale": {"color": "independent", "strokeDash": "independent"}},
    }  # fmt: skip


def peak(rows: Rows, channels: Sequence[str], theta_d: float) -> Spec:
    """Every datum of the peak; beside it the same over its value at the origin, where widths are compared."""
    return _chart() | {
        "data": _data(rows), "resolve": {"scale": {"color": "independent"}},
        "hconcat": [
            _peak(channels, "", "BRDF (1/sr)", f"peak, θd = {theta_d:.0f}°", "log", {"type": "log"}, "true"),
            _peak(channels, "_rel", "over its first value", "width by channel", "linear", {"zero": True}, "datum.near"),
        ],
    }  # fmt: skip


def _peak(channels: Sequence[str], ending: str, up: str, title: str, across: str, scale: Spec, kept: str) -> Spec:
    x = {"field": "h", "type": "quantitative", "title": "θh (degrees)", "scale": {"type": across, "nice": False},
         "axis": {"values": DEGREES, "format": "~g"} if across == "log" else {}}  # fmt: skip
    tips = [_tip("channel", "channel", None), _tip("h", "θh (degrees)", ".3~r"), _tip(f"file{ending}", "file"),
            _tip(f"fit{ending}", "fit")]  # fmt: skip
    y = {"type": "quantitative", "title": up, "scale": scale, "axis": {"format": "~g", "tickCount": 6}}
    encoding = {"x": x, "color": _by_channel(channels)}
    return {
        "width": WIDTH // 2 - 50, "height": HEIGHT * 5 // 6, "title": title,
        "transform": [{"filter": kept}],
        "layer": [
            {"mark": {"type": "line", "strokeWidth": 1.2}, "transform": [{"filter": f"datum.fit{ending} > 0"}],
             "encoding": encoding | {"y": y | {"field": f"fit{ending}"}}},
            {"mark": {"type": "point", "size": 18, "strokeWidth": 0.8},
             "transform": [{"filter": f"datum.file{ending} > 0"}],
             "encoding": encoding | {"y": y | {"field": f"file{ending}"}, "shape": _shape(channels), "tooltip": tips}},
        ],
    }  # fmt: skip


def sorted_errors(rows: Rows, figures: Mapping[str, str]) -> Spec:
    """Errors of all results, of each model sorted by themselves (HP17 Fig. 11); a click opens the page.

    Args:
        rows: ``material``, ``model``, ``page``, the figures. figures: what each is, by name.
    """
    ranks: Counter[tuple[str, str]] = Counter()
    long: Rows = []
    for name, words in figures.items():
        for row in sorted((r for r in rows if r[name] is not None), key=lambda r: r[name]):
            ranks[name, row["model"]] += 1
            common = {key: row[key] for key in ("material", "model", "page")}
            long.append({"figure": words, "rank": ranks[name, row["model"]], "value": row[name]} | common)
    last = max(ranks.values())
    across = {"field": "rank", "title": "results, the best first", "axis": {"values": _ranks(last), "format": "d"},
              "scale": {"domain": [0.5, last + 0.5], "nice": False}}  # fmt: skip
    return _against_errors(rows, long, figures, across, [{"filter": "datum.figure == figure"}])


def time_against_error(rows: Rows, figures: Mapping[str, str]) -> Spec:
    """Seconds of every fit against an error; a click opens the page."""
    fields = "{" + ", ".join(f"{json.dumps(words)}: datum.{name}" for name, words in figures.items()) + "}"
    transform = [{"calculate": f"{fields}[figure]", "as": "value"}, {"filter": "isValid(datum.value)"}]
    across = {"field": "seconds", "title": "seconds a file",
              "scale": {"zero": False, "nice": False, "padding": PADDING}}  # fmt: skip
    return _against_errors(rows, rows, figures, across, transform, _tip("seconds", "seconds"))


def _against_errors(
    rows: Rows, data: Rows, figures: Mapping[str, str], across: Spec, transform: list[Spec], *tips: Spec
) -> Spec:
    """Points of all results up to an error, which is chosen."""
    choice = {"input": "select", "options": list(figures.values()), "name": "error"}
    return _chart() | {
        "data": _data(data), "params": [{"name": "figure", "value": next(iter(figures.values())), "bind": choice}],
        "transform": transform, "width": WIDTH // 2 - 40, "height": HEIGHT * 3 // 4,
        "mark": {"type": "point", "filled": True, "size": 26, "cursor": "pointer"},
        "encoding": {
            "x": {"type": "quantitative"} | across, "y": {"field": "value"} | _log_axis("y", "figure"),
            "color": _by_model(rows), "href": {"field": "page"},
            "tooltip": [_tip("material", "material", None), _tip("model", "model", None), _tip("value", "error"),
                        *tips],
        },
    }  # fmt: skip


def parameters(rows: Rows, names: Sequence[str], units: Mapping[str, str]) -> Spec:
    """Two parameters of all results with their intervals; a click opens the page.

    Args:
        rows: ``material``, ``model``, ``page``, and ``NAME``, ``NAME_low``, ``NAME_high`` of the parameters it has.
        units: by name, of the parameters that have one.
    """
    first, second = (*names, *names)[:2]
    transform: list[Spec] = []
    for axis in "xy":
        for ending in ("", "_low", "_high"):
            transform.append({"calculate": f"datum[{axis}_name + '{ending}']", "as": f"{axis}{ending}"})
    transform.append({"filter": "isValid(datum.x) && isValid(datum.y) && datum.x > 0 && datum.y > 0"})
    of = json.dumps({name: f" ({unit})" for name, unit in units.items()}, ensure_ascii=False)
    both = {axis: {"field": axis} | _log_axis(axis, f"{axis}_name + ({of}[{axis}_name] || '')") for axis in "xy"}

    def interval(axis: str) -> Spec:
        low, high = f"{axis}_low", f"{axis}_high"
        return {
            "transform": [{"filter": f"isValid(datum.{low}) && datum.{low} > 0"}],
            "mark": {"type": "rule", "opacity": 0.35},
            "encoding": both
            | {axis: both[axis] | {"field": low}, f"{axis}2": {"field": high}, "color": _by_model(rows)},
        }

    options = {"input": "select", "options": list(names)}
    return _chart() | {
        "data": _data(rows),
        "params": [{"name": "x_name", "value": first, "bind": options | {"name": "across"}},
                   {"name": "y_name", "value": second, "bind": options | {"name": "up"}}],
        "transform": transform, "width": WIDTH - 60, "height": HEIGHT,
        "layer": [interval("x"), interval("y"), {
            "mark": {"type": "point", "filled": True, "size": 30, "cursor": "pointer"},
            "encoding": both | {
                "color": _by_model(rows), "href": {"field": "page"},
                "tooltip": [_tip("material", "material", None), _tip("model", "model", None), _tip("x", "across"),
                            _tip("y", "up")],
            },
        }],
    }  # fmt: skip


def _log_axis(axis: str, title: str) -> Spec:
    """Logarithmic, with room at both ends; more than most of a decade has words at 1, 2 and 5 alone.

    Args:
        title: an expression.
    """
    first = "round(datum.value / pow(10, floor(log(datum.value) / LN10 + 1e-9)))"
    narrow = f"domain('{axis}')[1] < {NARROW:g} * domain('{axis}')[0]"
    words = f"{narrow} || indexof([1, 2, 5], {first}) >= 0 ? format(datum.value, '.3~g') : ''"
    return {"type": "quantitative", "scale": {"type": "log", "nice": False, "padding": PADDING},
            "axis": {"title": {"expr": title}, "labelExpr": words}}  # fmt: skip


def _ranks(last: int) -> list[int]:
    """Round whole numbers from 1 to the last, about eight."""
    step = next(step for k in count() for m in (1, 2, 5) if last <= 8 * (step := m * 10**k))
    return sorted({1, *range(step, last + 1, step)})


def _chart() -> Spec:
    """What all have in common: colours that are legible on the page, light or dark."""
    words = {"labelColor": INK, "titleColor": INK, "labelFontSize": 11}
    axis = words | {"domainColor": LINE, "tickColor": LINE, "gridColor": GRID}
    legend = words | {
        "orient": "top",
        "titleOrient": "left",
        "symbolOpacity": 1,
        "columns": 6,
    }  # not as faint as a band
    return {"background": None, "config": {
        "view": {"stroke": GRID}, "font": "system-ui, sans-serif", "axis": axis, "legend": legend,
        "title": {"color": INK, "fontSize": 12, "anchor": "start"},
    }}  # fmt: skip


def _data(rows: Rows) -> Spec:
    """Rows as CSV, a third of the length of JSON; no value is null."""
    words = {head for row in rows for head in row if isinstance(row[head], str)}
    heads = list(dict.fromkeys(head for row in rows for head in row))
    types = {head: "string" if head in words else "number" for head in heads}
    return {"values": as_csv(heads, rows, DIGITS, spreadsheet=False), "format": {"type": "csv", "parse": types}}


def _tip(field: str, title: str, form: str | None = ".4~g") -> Spec:
    if form is None:
        return {"field": field, "type": "nominal", "title": title}
    return {"field": field, "type": "quantitative", "title": title, "format": form}


def _scaled(name: str) -> str:
    """Expression: a value on the scale that is chosen; none where there is none."""
    x = f"datum.{name}"
    return (
        f"!isValid({x}) ? null : scale == '{SCALES[0]}' ? pow(max({x}, 0), 1 / 3) : "
        f"scale == '{SCALES[1]}' ? log(max({x}, 1e-9)) / LN10 : {x}"
    )


def _scaled_axis() -> Spec:
    back = (
        f"scale == '{SCALES[0]}' ? format(pow(datum.value, 3), '.2~r') : "
        f"scale == '{SCALES[1]}' ? format(pow(10, datum.value), '.1~e') : format(datum.value, '.2~g')"
    )
    return {"type": "quantitative", "title": "BRDF (1/sr)", "axis": {"labelExpr": back}, "scale": {"zero": False}}


def _by_channel(channels: Sequence[str]) -> Spec:
    own = all(channel in CHANNEL_COLOURS for channel in channels)
    scale = {"range": [CHANNEL_COLOURS[c] for c in channels]} if own else {"scheme": "turbo"}
    return {"field": "channel", "type": "nominal", "title": None, "scale": {"domain": list(channels), **scale}}


def _shape(channels: Sequence[str]) -> Spec:
    shapes = [SHAPES[k % len(SHAPES)] for k in range(len(channels))]
    return {"field": "channel", "type": "nominal", "legend": None, "scale": {"domain": list(channels), "range": shapes}}


def _by_model(rows: Rows) -> Spec:
    names = sorted({str(row["model"]) for row in rows})
    colours = [COLOURS[k % len(COLOURS)] for k in range(len(names))]
    return {"field": "model", "type": "nominal", "title": None, "scale": {"domain": names, "range": colours}}
