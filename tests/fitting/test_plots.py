"""Pictures of a fit: what their panels show, and which marks, units and scales they have."""

from pathlib import Path

import numpy as np
import pytest
from made_results import made
from merlfit.fitting.output import plots
from merlfit.fitting.output.plots import corner_figure, lobe_figure
from merlfit.merl_io.binary import DIMS, Measurement
from merlfit.merl_io.grid import merl_grid
from merlfit.model.measured import Measured
from merlfit.model.two_scale import TwoScale


def chain(result, scale=0.1, count=400):
    rng, best = np.random.default_rng(0), np.array([q.value for q in result.parameters])
    return {
        "names": np.array([q.name for q in result.parameters]),
        "values": best * np.exp(scale * rng.normal(size=(count, len(best)))),
        "weights": np.full(count, 1 / count),
    }


@pytest.fixture(scope="module")
def measurement():
    above = np.broadcast_to(merl_grid().above, DIMS)
    values = np.where(above, np.array([0.3, 0.2, 0.1])[:, None, None, None], np.nan)
    return Measurement(Path("nickel.binary"), values, above, 0, 0, 0, "", "")


def test_every_datum_of_a_peak_is_drawn():
    """A narrow peak: the brightest datum of every channel is among the marks, at its own angle and height."""
    grid, result = merl_grid(), made(model=TwoScale("none"))
    lobe = np.exp(-((np.degrees(grid.theta_h) / 0.6) ** 2))[:, None, None] + 0.01
    values = np.where(grid.above, lobe * np.ones((3, 1, 1, 1)), np.nan)
    figure = lobe_figure(result, Measurement(Path("nickel.binary"), values, np.isfinite(values[0]), 0, 0, 0, "", ""))
    narrow = grid.theta_h[lobe[:, 0, 0] > 0.2]
    for k, incidence in enumerate(plots.INCIDENCES_DEG[:4]):
        marked = [line for line in figure.axes[5 + k].lines if line.get_marker() == "o"]
        assert len(marked) == 3
        for line in marked:
            x, y = line.get_data()
            for sign in (-1, 1):
                assert set(np.round(incidence + sign * 2 * np.degrees(narrow), 6)) <= set(np.round(x, 6))
            assert y.max() == pytest.approx(values[0, 0, 20, 90], rel=1e-6)
            far = np.abs(x - incidence) > 10
            assert 10 < far.sum() < 60  # of some 150 rows
            assert np.all(np.isfinite(y[far]))


def test_all_incidences_have_as_many_viewers():
    rows = np.degrees(merl_grid().theta_h)
    for incidence in plots.INCIDENCES_DEG:
        angles, is_datum = plots.viewers(incidence, rows)
        assert angles.shape == (357 + 180,)
        assert np.all(np.diff(angles) >= 0)
        expected = [2 * h for h in rows for side in (-2, 2) if abs(incidence + side * h) < plots.WIDEST_DEG]
        np.testing.assert_allclose(np.sort(np.abs(angles - incidence)[is_datum]), np.sort(expected), atol=1e-12)


def test_letters_of_the_corner_plot_are_readable_and_lie_on_no_panel():
    result = made(posterior=True)
    figure = corner_figure(result, chain(result))
    figure.draw_without_rendering()
    size, panels = len(result.parameters), [axis.get_window_extent() for axis in figure.axes]
    axes = np.array(figure.axes).reshape(size, size)
    for k in range(size):
        ticks = axes[-1, k].get_xticklabels() + axes[k, 0].get_yticklabels() * bool(k)
        words = [axes[k, k].title, axes[k, k]._left_title, axes[-1, k].xaxis.label, axes[k, 0].yaxis.label, *ticks]
        words = [text for text in words if text.get_text()]
        assert min(text.get_fontsize() for text in words) * 1.4 > 0.11 * 72 * plots.CORNER_INCHES  # a 13th of a panel
        shown = [panels[i] for i in range(size**2) if i // size >= i % size]
        for text in words:
            box = text.get_window_extent()
            assert not any(box.overlaps(panel.padded(-1)) for panel in shown), text
            assert figure.bbox.padded(1).containsx(box.x0)
            assert figure.bbox.padded(1).containsx(box.x1)


def texts(figure):
    return [text.get_text() for text in figure.texts]


@pytest.mark.parametrize("sufficient", [True, False])
def test_a_chain_that_is_too_short_has_a_watermark(sufficient):
    result = made(posterior=sufficient)
    found = texts(corner_figure(result, chain(result)))
    assert (plots.WATERMARK in found) == (not sufficient)
    assert any("9 autocorrelation times" in text for text in found) == (not sufficient)


@pytest.mark.parametrize("scale", [0.003, 0.1, 1.0])
def test_the_corner_plot_has_units_scales_values_and_ticks(scale):
    result = made(posterior=True)
    figure = corner_figure(result, chain(result, scale))
    size = len(result.parameters)
    axes = np.array(figure.axes).reshape(size, size)
    for k, q in enumerate(result.parameters):
        assert axes[k, k].get_title("left").startswith(f"{q.name}\n{q.value:.3g}\n[")
        assert axes[-1, k].get_xscale() == ("linear" if q.name.startswith("grazing") else "log")
        assert ("(µm)" in axes[-1, k].get_xlabel()) == (q.unit == "um")
        low, high = axes[-1, k].get_xlim()
        ticks = axes[-1, k].get_xticks()
        assert 1 < sum((ticks > low) & (ticks < high)) < 6
        said = [label.get_text() for label in axes[-1, k].get_xticklabels()]
        assert len(set(said)) == len(said) == len(ticks)
        assert all(float(text) == pytest.approx(tick, rel=1e-4) for text, tick in zip(said, ticks, strict=True))


def test_a_chain_too_short_for_intervals_is_drawn_and_gives_the_lobes_no_band(tmp_path, measurement, monkeypatch):
    from merlfit.fitting.output import inspection

    result, seen = made(posterior=False), []
    np.savez(tmp_path / result.posterior.chain_file, **chain(result))
    monkeypatch.setattr(inspection, "use_persistent_cache", lambda: None)
    monkeypatch.setattr(type(result.source), "read", lambda *_: measurement)
    monkeypatch.setattr(plots, "lobe_figure", lambda *words: seen.append(words[2]) or corner_figure(result, drawn))
    drawn = chain(result)
    assert inspection.show(tmp_path / "nickel.json", result, Path("nickel.binary"), tmp_path)
    assert seen == [None]
    assert (tmp_path / "nickel.corner.png").stat().st_size > 20_000


@pytest.mark.parametrize("acquisition", ["free", "off"])
def test_the_lobe_plot_has_a_log_view_a_peak_and_residuals(acquisition, measurement):
    result = made(model=Measured(TwoScale("none"), acquisition))
    figure = lobe_figure(result, measurement)
    cubic, logarithmic, (peak, by_half, by_difference) = figure.axes[:5], figure.axes[5:10], figure.axes[10:]
    assert {a.get_yscale() for a in cubic} == {"linear"}
    assert {a.get_yscale() for a in [*logarithmic, peak, by_half, by_difference]} == {"log"}
    assert (peak.get_xscale(), by_half.get_xscale()) == ("log", "log")
    marked = [line for line in peak.lines if line.get_marker() in "os^"]
    assert [line.get_ydata()[0] for line in marked] == pytest.approx([0.3, 0.2, 0.1])
    assert len({line.get_marker() for line in marked}) == 3
    assert min(len(line.get_xdata()) for line in marked) > 80  # every row of theta_h that is above the horizon
    for axis in (*cubic, *logarithmic, by_half, by_difference):
        assert any(line.get_linestyle() == "--" for line in axis.lines) == (acquisition == "free")


def test_residuals_are_fit_over_file(measurement, monkeypatch):
    """A fit that is twice the file everywhere."""
    result = made(model=TwoScale("none"))
    file = np.array([0.3, 0.2, 0.1])
    twice = 2 * np.ones((3, 90, 45, 7)) * file[:, None, None, None]
    monkeypatch.setattr(plots, "_predicted", lambda *_, loss: twice)
    figure = plots.Figure()
    plots._ratios(*figure.subplots(1, 2), result, measurement)
    for axis in figure.axes:
        drawn = [line.get_ydata() for line in axis.lines if len(line.get_xdata()) > 10]
        assert len(drawn) == 3
        np.testing.assert_allclose(np.concatenate(drawn), 2.0)
        assert axis.get_ylim() == pytest.approx((0.5, 2.0))
