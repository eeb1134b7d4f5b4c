"""Pictures of a fit: what their panels show, which marks, units and scales they have, and how they look in print."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from merlfit.fitting.pipeline.draws import NoPicture
from merlfit.fitting.show import corner, inspection, prediction, scans, style
from merlfit.fitting.show import residual_maps as residuals
from merlfit.fitting.show.labelled import labelled
from merlfit.fitting.show.lobes import INCIDENCES_DEG
from merlfit.fitting.show.pictures import OF_SCATTERED, PICTURES
from merlfit.fitting.show.spheres import of_file_and_fit, of_parts
from merlfit.fitting.show.subject import Subject
from merlfit.merl_io import inputs
from merlfit.merl_io.binary import DIMS, Measurement
from merlfit.merl_io.grid import merl_grid
from merlfit.model.measured import Measured
from merlfit.model.two_scale import TwoScale
from merlfit.scene.colour import cielab
from PIL import Image

from tests.support.compiled import evaluate, from_half_difference, from_vectors
from tests.support.made_results import made

LOBES = PICTURES["lobes"].draw
ORIGIN = "synthetic: a constant, $3_ to 4^$, \\foo{"
LEAST = 30  # CIELAB distance
FILE = np.array([0.3, 0.2, 0.1])


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
    return Measurement(
        Path("nickel.binary"), np.where(above, FILE[:, None, None, None], np.nan), above, 0, 0, 0, "", ""
    )


@pytest.fixture(scope="module")
def subject(measurement, compiled_quickly):
    """With all that a picture may want, of all names that are long."""
    result = made("gold-metallic-paint3", posterior=True, model=Measured(TwoScale("lambert")))
    assert result.posterior is not None
    result.posterior.message = f"too short: {ORIGIN}"
    result.config["input"] = {"origin": ORIGIN}
    walkers = np.random.default_rng(0).normal(size=(40, 8, len(result.parameters)))
    return Subject(result, measurement, chain(result), walkers, titled=True)


@pytest.fixture(autouse=True)
def few_draws(monkeypatch):
    """Of the posterior, for bands: a fifth of a second each."""
    monkeypatch.setattr(prediction, "BAND_DRAWS", 10)


@pytest.fixture(scope="module")
def printed(subject):
    """Each picture of the subject once, drawn in spite of a user's settings of matplotlib."""

    @cache
    def draw(name):
        with mpl.rc_context({"text.usetex": True, "font.size": 30.0}):
            figure = PICTURES[name].draw(subject)
        figure.draw_without_rendering()
        return figure

    return draw


@pytest.fixture(scope="module")
def corners():
    """Corner plots of a chain by its picture, how wide it is, and whether it is long enough; each drawn once."""

    @cache
    def draw(name, scale, sufficient):
        result = made(posterior=sufficient)
        return result, PICTURES[name].draw(Subject(result, None, chain(result, scale)))

    return draw


@pytest.mark.parametrize("name", [name for name in PICTURES if name not in OF_SCATTERED])
def test_a_picture_can_be_printed(name, printed):
    """It is as wide as a column, no letter is smaller than 6 points, none is cut off, and it says what the data are.

    Neither the user's settings of matplotlib nor what is a formula to it and is none in an origin changes that.
    """
    figure = printed(name)
    width = 17.8 if name == "corner-all" else 8.5
    assert figure.get_figwidth() * 2.54 == pytest.approx(width)
    assert figure.get_figheight() * 2.54 < 25
    seen = [text for text in figure.findobj(lambda artist: hasattr(artist, "get_fontsize")) if text.get_visible()]
    seen = [text for text in seen if text.get_text().strip() and text.get_window_extent().width > 0]
    assert len(seen) > 5
    assert min(text.get_fontsize() for text in seen) >= 6
    said = [*figure.texts, *(text for axis in figure.axes for text in (axis.title, axis.xaxis.label, axis.yaxis.label))]
    for text in [*said, *(text for legend in figure.legends for text in legend.get_texts())]:
        box = text.get_window_extent()
        assert box.x0 > -1, text
        assert box.x1 < figure.bbox.x1 + 1, text
    words = " ".join(text.get_text() for text in said).replace("\n", " ")
    assert "gold-metallic-paint3" in words
    assert ORIGIN.replace("$", r"\$") in words  # which is how matplotlib shows a dollar


# Machado, Oliveira & Fernandes 2009, severity 1, linear RGB
BLIND = {
    "protanopia": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deuteranopia": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
    "tritanopia": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
}  # fmt: skip


def least_distance(colours, matrix):
    """CIELAB distance of the two colours that are most alike, as seen through a matrix on linear RGB."""
    encoded = np.array([to_rgb(colour) for colour in colours])
    linear = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
    lab = cielab(np.clip(linear @ np.asarray(matrix).T, 0, 1))
    apart = np.linalg.norm(lab[:, None] - lab, axis=-1)
    return apart[np.triu_indices(len(colours), 1)].min()


@pytest.mark.parametrize("kind", BLIND)
def test_colours_of_the_channels_differ_for_everybody(kind):
    assert least_distance(style.CHANNEL_COLOURS.values(), BLIND[kind]) > LEAST
    assert least_distance(["#c0392b", "#2e8b57"], BLIND["deuteranopia"]) < LEAST, "it sees what is too alike"


def test_every_datum_of_a_peak_is_drawn():
    """A narrow peak: the brightest datum of every channel is among the marks, at its own angle and height."""
    grid, result = merl_grid(), made(model=TwoScale("none"))
    lobe = np.exp(-((np.degrees(grid.theta_h) / 0.6) ** 2))[:, None, None] + 0.01
    values = np.where(grid.above, lobe * np.ones((3, 1, 1, 1)), np.nan)
    file = Measurement(Path("nickel.binary"), values, np.isfinite(values[0]), 0, 0, 0, "", "")
    figure = LOBES(Subject(result, file))
    narrow = grid.theta_h[lobe[:, 0, 0] > 0.2]
    for k, incidence in enumerate(INCIDENCES_DEG[:4]):
        marked = [line for line in figure.axes[2 * k + 1].lines if line.get_marker() in style.MARKS]
        marked = [line for line in marked if len(line.get_xdata())]
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
    for incidence in INCIDENCES_DEG:
        angles, is_datum = prediction.viewers(incidence, rows)
        assert angles.shape == (357 + 180,)
        assert np.all(np.diff(angles) >= 0)
        expected = [2 * h for h in rows for side in (-2, 2) if abs(incidence + side * h) < prediction.WIDEST_DEG]
        np.testing.assert_allclose(np.sort(np.abs(angles - incidence)[is_datum]), np.sort(expected), atol=1e-12)


@pytest.mark.parametrize("acquisition", ["free", "off"])
def test_lobes_have_two_scales_and_a_dashed_line_without_the_loss(acquisition, measurement):
    result = made(model=Measured(TwoScale("none"), acquisition))
    figure = LOBES(Subject(result, measurement))
    assert {a.get_yscale() for a in figure.axes[::2]} == {"linear"}
    assert {a.get_yscale() for a in figure.axes[1::2]} == {"log"}
    for axis in figure.axes:
        assert any(line.get_linestyle() == "--" for line in axis.lines) == (acquisition == "free")


@pytest.mark.parametrize("sufficient", [True, False])
def test_only_a_chain_that_is_long_enough_gives_bands(sufficient, measurement):
    result = made(posterior=sufficient)
    figure = LOBES(Subject(result, measurement, chain(result)))
    assert all(bool(axis.collections) == sufficient for axis in figure.axes)


def test_bands_are_quantiles_of_what_the_draws_predict():
    """Each direction of each draw computed for itself, where bands look up in a table a draw."""
    result = made(posterior=True, model=Measured(TwoScale("none")))
    drawn, model = chain(result, count=10), result.model
    where = from_vectors(*prediction.plane_of_incidence(0.5, np.array([-0.9, 0.1, 0.5, 1.2])))
    each = [evaluate(model.measured, result.values(x), where, tuple(model.wavelengths_um)) for x in drawn["values"]]
    found = prediction.band(prediction.draws_of(result, drawn), where)
    np.testing.assert_allclose(found, np.quantile(each, [0.05, 0.95], axis=0), rtol=1e-3)
    assert np.all(found[0] < 0.95 * found[1])


def test_the_peak_has_every_row_above_the_horizon(measurement):
    figure = PICTURES["peak"].draw(Subject(made(model=TwoScale("none")), measurement))
    whole, widths = figure.axes
    assert (whole.get_xscale(), whole.get_yscale(), widths.get_xscale()) == ("log", "log", "linear")
    marked = [line for line in whole.lines if line.get_marker() in style.MARKS]
    assert [line.get_ydata()[0] for line in marked] == pytest.approx(FILE)
    assert len({line.get_marker() for line in marked}) == 3
    assert min(len(line.get_xdata()) for line in marked) > 80
    assert all(line.get_ydata()[0] == pytest.approx(1) for line in widths.lines if len(line.get_xdata()))


def test_residuals_are_fit_over_file(measurement, monkeypatch):
    """A fit that is twice the file everywhere."""
    twice = 2 * np.ones((3, 90, 45, 7)) * FILE[:, None, None, None]
    monkeypatch.setattr(residuals.prediction, "brdf_of", lambda *_: twice)
    figure = PICTURES["residuals"].draw(Subject(made(model=Measured(TwoScale("none"), "off")), measurement))
    for axis in figure.axes:
        drawn = [line.get_ydata() for line in axis.lines if len(line.get_xdata()) > 10]
        assert len(drawn) == 3
        np.testing.assert_allclose(np.concatenate(drawn), 2.0)
        assert axis.get_ylim() == pytest.approx((0.5, 2.0))


def test_error_maps_are_of_fit_and_file(measurement):
    twice = Subject(made(model=TwoScale("none")), measurement)
    vars(twice)["predicted"] = 2 * np.ones((3, 90, 90, 90)) * FILE[:, None, None, None]
    relative, absolute = (axis.collections[0].get_array() for axis in PICTURES["errors"].draw(twice).axes[:2])
    np.testing.assert_allclose(relative.compressed(), 1.0)  # log2
    assert 3000 < relative.count() < 8100  # below the horizon there is nothing
    expected = np.sqrt(np.mean((np.cbrt(2 * FILE) - np.cbrt(FILE)) ** 2))
    np.testing.assert_allclose(absolute.compressed(), expected)


def test_a_fit_that_is_the_file_is_a_sphere_without_difference(measurement):
    same = Subject(made(model=TwoScale("none")), measurement)
    vars(same)["predicted"] = np.ones((3, 90, 90, 90)) * FILE[:, None, None, None]
    for pictures in of_file_and_fit(same).values():
        np.testing.assert_array_equal(pictures["file"], pictures["fit"])
        assert pictures["fit"].shape == (384, 384, 4)
        opaque = pictures["fit"][192, :12, 3]  # a rim without steps, where data begin
        assert opaque[0] == 0
        assert opaque[-1] == 255
        assert np.any((opaque > 0) & (opaque < 255))
        assert pictures["difference"][..., :3].max() == pytest.approx(3, abs=3)  # the first colour of inferno


def test_shares_of_the_effects_are_all_of_the_light(subject):
    pictures, shares = of_parts(subject)
    assert set(shares) == set(pictures) == {"specular", "diffracted", "body"}
    np.testing.assert_allclose(sum(shares.values()), 1.0)
    assert all(np.all(share > 0) for share in shares.values())


@pytest.mark.parametrize("name", ["lobes", "spheres", "isolines", "peak", "effects"])
def test_a_fit_without_its_file_is_still_drawn(name, subject):
    assert PICTURES[name].draw(replace(subject, measurement=None)).axes


@pytest.mark.parametrize(
    ("name", "words"), [("errors", "gone"), ("residuals", "gone"), ("corner", "not sampled"), ("trace", "not sampled")]
)
def test_what_cannot_be_drawn_says_why(name, words):
    with pytest.raises(NoPicture, match=words):
        PICTURES[name].draw(Subject(made(), lacks={"measurement": "nickel.binary is gone"}))


@pytest.mark.parametrize("sufficient", [True, False])
def test_a_chain_that_is_too_short_has_a_watermark(sufficient, corners):
    found = [text.get_text() for text in corners("corner", 0.1, sufficient)[1].texts]
    assert (corner.WATERMARK in found) == (not sufficient)
    assert any("9 autocorrelation times" in text for text in found) == (not sufficient)


@pytest.mark.parametrize(
    ("name", "scale"), [("corner", 0.003), ("corner", 0.1), ("corner", 1.0), ("corner-all", 0.003)]
)
def test_the_corner_plot_has_units_scales_values_and_ticks(name, scale, corners):
    result, figure = corners(name, scale, True)
    shown = [q for q in result.parameters if name == "corner-all" or q.channel in (None, "G")]
    assert len(shown) < len(result.parameters) or name == "corner-all"
    axes = np.array(figure.axes).reshape(len(shown), len(shown))
    texts = [text.get_text() for text in figure.texts]
    for k, q in enumerate(shown):
        assert f"{q.value:.3g}" in texts
        assert corner.label(q) + (" (µm)" if q.unit == "um" else "") in texts
        assert axes[-1, k].get_xscale() == ("linear" if q.name.startswith("grazing") else "log")
        low, high = axes[-1, k].get_xlim()
        ticks = axes[-1, k].get_xticks()
        assert 1 < sum((ticks > low) & (ticks < high)) < 6
        said = [label.get_text() for label in axes[-1, k].get_xticklabels()]
        assert len(set(said)) == len(said) == len(ticks)
        assert all(float(text) == pytest.approx(tick, rel=1e-4) for text, tick in zip(said, ticks, strict=True))


@pytest.mark.parametrize(("scale", "forward"), [("linear", np.asarray), ("log", np.log)])
@pytest.mark.parametrize("panel", [0.24, 0.28, 0.4, 1.5])
def test_ticks_of_neighbours_do_not_collide(panel, scale, forward):
    rng = np.random.default_rng(1)
    room = panel * (1 + corner.GAP)  # to where the next panel begins
    for low, wide in zip(10 ** rng.uniform(-5, 2, 200), 10 ** rng.uniform(0.02, 4, 200), strict=True):
        ticks = corner._ticks(low, low * wide, scale, panel)
        places = (forward(ticks) - forward(low)) / (forward(low * wide) - forward(low)) * panel
        assert 1 <= len(ticks) <= 3
        assert np.all((places > 0) & (places < panel))
        assert np.min(np.diff([*places, places[0] + room])) >= 0.99 * corner.APART or len(ticks) == 1


@pytest.mark.parametrize("name", ["corner", "corner-all"])
def test_no_letters_of_the_corner_plot_lie_on_a_panel(name, printed):
    figure = printed(name)
    size = int(np.sqrt(len(figure.axes)))
    panels = [axis.get_window_extent() for k, axis in enumerate(figure.axes) if k // size >= k % size]
    axes = np.array(figure.axes).reshape(size, size)
    words = [*figure.texts, *(axis.xaxis.label for axis in axes[-1]), *(axis.yaxis.label for axis in axes[1:, 0])]
    words += [tick for axis in axes[-1] for tick in axis.get_xticklabels()]
    for text in words:
        if text.get_text():
            box = text.get_window_extent()
            assert not any(box.overlaps(panel.padded(-1)) for panel in panels), text
            assert box.x0 >= 0, text
            assert box.y0 >= 0, text


@pytest.mark.parametrize("kind", ["png", "pdf", "svg"])
def test_pictures_are_written_in_the_format_asked_for(kind, tmp_path):
    figure = Figure(figsize=(1, 1))
    style.save(figure, tmp_path / f"a.{kind}")
    assert (tmp_path / f"a.{kind}").read_bytes().startswith({"png": b"\x89PNG", "pdf": b"%PDF", "svg": b"<?xml"}[kind])


def test_inspect_draws_what_it_is_asked_for(tmp_path, subject, monkeypatch):
    monkeypatch.setattr(inspection, "subject_of", lambda *_: subject)
    asked = ["peak", "trace"]
    assert inspection.show(tmp_path / "x.json", subject.result, Path("x.binary"), tmp_path, "pdf", asked)
    assert {p.name for p in tmp_path.iterdir()} == {f"gold-metallic-paint3.two-scale.{name}.pdf" for name in asked}


def test_pictures_show_what_the_model_says_at_every_bin(subject):
    """Tables and a few azimuths a row stand for what each bin would compute for itself."""
    model, grid = subject.model, subject.grid
    rng = np.random.default_rng(3)
    seen = np.argwhere(grid.above[..., :90] & (np.minimum(grid.cos_i, grid.cos_o)[..., :90] > np.cos(1.4)))
    h, d, p = rng.choice(seen, 300).T
    where = from_half_difference(grid.theta_h[h], grid.theta_d[d], grid.phi_d[p])
    exact = np.asarray(evaluate(model.measured, subject.values, where, tuple(model.wavelengths_um)))
    np.testing.assert_allclose(subject.predicted[:, h, d, p], exact, rtol=2e-3)
    alone = np.asarray(evaluate(model.material, subject.values, where, tuple(model.wavelengths_um)))
    np.testing.assert_allclose(sum(x[:, h, d, p] for x in subject.parts.values()), alone, rtol=2e-3)
    assert [*subject.parts] == ["specular", "diffracted", "body"]
    assert not subject.predicted[:, ~grid.above[..., :90]].any()


@pytest.mark.parametrize("name", ["a $b$", "$\\foo{$", "a\x1b]0;b", "caf\udce9", "$", r"\$"])
def test_a_name_is_shown_as_it_is(name, tmp_path):
    """Whatever it holds, nothing of it is a formula; the same with the user's LaTeX switched on."""
    with mpl.rc_context({"text.usetex": True}):
        figure = labelled(np.zeros((40, 40, 3), np.uint8), [name], [name], name, name)
        assert not any(text.get_usetex() or text._preprocess_math(text.get_text())[1] for text in figure.texts)
        style.save(figure, tmp_path / "a.png")
    shown = figure.texts[0]._preprocess_math(figure.texts[0].get_text())[0]
    assert shown == name.replace("\x1b", "\ufffd").replace("\udce9", r"\udce9")


def test_a_symbol_that_is_no_formula_is_replaced_by_the_name():
    assert style.symbol(r"\sigma_s", "sigma_s") == r"$\sigma_s$"
    assert style.symbol(r"\foo{", "si$gma") == r"si\$gma"


def test_letters_of_a_pdf_are_outlines_that_journals_take(tmp_path):
    with mpl.rc_context({"pdf.fonttype": 3}):
        style.save(labelled(np.zeros((40, 40, 3), np.uint8), ["letters"]), tmp_path / "a.pdf")
    assert b"/Type3" not in (tmp_path / "a.pdf").read_bytes()
    assert b"/FontFile2" in (tmp_path / "a.pdf").read_bytes()


def test_a_picture_without_a_title_says_in_its_file_what_it_is_of(subject, tmp_path):
    bare = replace(subject, titled=False)
    figure = LOBES(bare, theta=[40], channels=["G"])
    assert figure.get_suptitle() == ""
    assert len(figure.axes) == 2
    style.save(figure, tmp_path / "lobes.png")
    with Image.open(tmp_path / "lobes.png") as image:
        said = image.info["Description"]
    assert said.startswith("gold-metallic-paint3: fit of two-scale")
    assert "data: synthetic: a constant" in said


def test_models_are_drawn_on_the_same_lobes_and_no_row_is_flattened_by_another(subject):
    other = replace(subject, chain=None, walkers=None)
    figure = LOBES(other, theta=[0, 80], models={"one": other, "another": other})
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert labels == ["one", "another", "G: file"]
    roots = figure.axes[::2]
    for axis in roots:  # each as high as its own lobe
        highest = max(np.nanmax(line.get_ydata()) for line in axis.lines if len(line.get_xdata()) > 2)
        assert axis.get_ylim()[1] == pytest.approx(1.1 * highest)
    for wrong in ({"theta": [90]}, {"channels": ["X"]}):
        with pytest.raises(NoPicture):
            LOBES(other, **wrong)


def test_where_the_file_has_no_datum_the_fit_is_drawn_alone(measurement):
    blank = replace(measurement, values=np.full_like(measurement.values, np.nan))
    (root, _) = LOBES(Subject(made(model=TwoScale("none")), blank), theta=[80]).axes
    highest = max(np.nanmax(line.get_ydata()) for line in root.lines if len(line.get_xdata()) > 2)
    assert root.get_ylim()[1] == pytest.approx(1.1 * highest)


def test_a_corner_plot_has_the_parameters_that_were_asked_for(subject):
    figure = PICTURES["corner"].draw(subject, parameters=["eta_R", "beta"])
    assert len(figure.axes) == 4
    assert [axis.get_xlabel() for axis in figure.axes[2:]] == [r"$\eta$ R", r"$\beta$"]
    with pytest.raises(NoPicture, match="there is no parameter 'gamma' that was fitted; there are beta, p,"):
        PICTURES["corner"].draw(subject, parameters=["gamma"])


def test_scans_are_drawn_by_incidence_against_the_signed_angle_of_the_viewer(subject):
    signed = np.arange(-70.0, 71.0, 5.0)
    theta_i = np.repeat([10.0, 40.0], len(signed))
    value = 0.1 + np.exp(-(((np.tile(signed, 2) - theta_i) / 10) ** 2))
    table = {
        "theta_i_deg": theta_i, "theta_o_deg": np.abs(np.tile(signed, 2)),
        "phi_deg": np.where(np.tile(signed, 2) >= 0, 178.5, 0.0), "wavelengths_um": [0.645, 0.526, 0.444],
        "values": np.stack([value] * 3, -1),
    }  # fmt: skip
    figure = PICTURES["scans"].draw(replace(subject, scattered=inputs.read(table), measurement=None))
    for axis, degrees in zip(figure.axes, (10, 40), strict=True):
        marked = [line for line in axis.lines if line.get_linestyle() == "None" and len(line.get_xdata()) > 2]
        assert len(marked) == 3
        x, y = marked[0].get_data()
        assert sorted(x) == pytest.approx([*signed])
        assert x[np.argmax(y)] == pytest.approx(degrees)
        azimuth = np.radians(np.where(x >= 0, 178.5, 0.0))  # of the samples, which the fit is drawn for
        i = np.array([-np.sin(np.radians(degrees)), 0, np.cos(np.radians(degrees))])
        sine, cosine = np.sin(np.radians(np.abs(x))), np.cos(np.radians(x))
        o = np.stack([-sine * np.cos(azimuth), -sine * np.sin(azimuth), cosine], -1)
        fit = prediction.predicted_lobe(subject.fitted, np.broadcast_to(i, o.shape), o)
        (line, *_) = [line for line in axis.lines if line.get_linestyle() == "-" and len(line.get_xdata()) == len(x)]
        np.testing.assert_allclose(line.get_ydata(), fit[2], rtol=1e-6)  # blue is the first one
    told = scans.in_numbers(replace(subject, scattered=inputs.read(table), measurement=None))
    assert (told["channel"], [row["degrees"] for row in told["table"]]) == ("G", pytest.approx([10, 40]))
    for row, rows in zip(told["table"], told["samples"], strict=True):
        assert (row["count"], row["brightest"], row["at"]) == (29, pytest.approx(1.1), pytest.approx(row["degrees"]))
        ratios = [fit / file for _, file, fit in rows["rows"]]
        assert row["median"] == pytest.approx(np.median(ratios))
    with pytest.raises(NoPicture, match="does not hold scattered directions"):
        PICTURES["scans"].draw(subject)
