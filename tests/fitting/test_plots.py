"""Pictures of a fit: what their panels show, and which marks, units and scales they have."""

from pathlib import Path

import numpy as np
import pytest
from made_results import made
from merlfit.fitting import plots
from merlfit.fitting.plots import corner_figure, lobe_figure
from merlfit.merl_io.binary import DIMS, Measurement
from merlfit.merl_io.grid import merl_grid
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
        assert axes[k, k].get_title().startswith(f"{q.name}\n{q.value:.3g}\n[")
        assert axes[-1, k].get_xscale() == ("linear" if q.name.startswith("grazing") else "log")
        assert ("(µm)" in axes[-1, k].get_xlabel()) == (q.unit == "um")
        low, high = axes[-1, k].get_xlim()
        ticks = axes[-1, k].get_xticks()
        assert 1 < sum((ticks > low) & (ticks < high)) < 6
        said = [label.get_text() for label in axes[-1, k].get_xticklabels()]
        assert len(set(said)) == len(said) == len(ticks)
        assert all(float(text) == pytest.approx(tick, rel=1e-4) for text, tick in zip(said, ticks, strict=True))


def test_a_chain_too_short_for_intervals_is_drawn_and_gives_the_lobes_no_band(tmp_path, measurement, monkeypatch):
    from merlfit.fitting import inspection

    result, seen = made(posterior=False), []
    np.savez(tmp_path / result.posterior.chain_file, **chain(result))
    monkeypatch.setattr(inspection, "use_persistent_cache", lambda: None)
    monkeypatch.setattr(inspection, "read", lambda *_: measurement)
    monkeypatch.setattr(plots, "lobe_figure", lambda *words: seen.append(words[2]) or corner_figure(result, drawn))
    drawn = chain(result)
    assert inspection.show(tmp_path / "nickel.json", result, Path("nickel.binary"), tmp_path)
    assert seen == [None]
    assert (tmp_path / "nickel.corner.png").stat().st_size > 20_000


@pytest.mark.parametrize("acquisition", ["free", "off"])
def test_the_lobe_plot_has_a_log_view_a_peak_and_residuals(acquisition, measurement):
    result = made(effects=TwoScale("none", acquisition=acquisition))
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
    result = made(effects=TwoScale("none"))
    file = np.array([0.3, 0.2, 0.1])
    monkeypatch.setattr(
        plots, "_predicted", lambda model, values, h, d, p: 2 * np.ones((3, 90, 45, 7)) * file[:, None, None, None]
    )
    figure = plots.Figure()
    plots._ratios(*figure.subplots(1, 2), result, measurement)
    for axis in figure.axes:
        drawn = [line.get_ydata() for line in axis.lines if len(line.get_xdata()) > 10]
        assert len(drawn) == 3
        np.testing.assert_allclose(np.concatenate(drawn), 2.0)
        assert axis.get_ylim() == pytest.approx((0.5, 2.0))
