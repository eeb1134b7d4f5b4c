"""Parameters as papers print them."""

import merlfit
import pytest
from merlfit.fitting.pipeline.editing import edited
from merlfit.fitting.results.schema import Quantiles
from merlfit.fitting.results.storage import write_result
from merlfit.fitting.show.parameter_table import as_html, as_latex, cell, heads

from tests.support.command import call
from tests.support.made_results import made


def one(name="beta", **changes):
    (found,) = [q for q in made().parameters if q.name == name]
    return found.model_copy(update=changes)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"laplace": Quantiles(q05=0.0812, q50=0.1, q95=0.1234)}, ("0.100", "0.023", "0.019", "")),
        ({"laplace": Quantiles(q05=0.08, q50=0.1, q95=9.0)}, ("0.100", "8.900", "0.020", "")),
        ({"laplace": Quantiles(q05=0.1 - 1e-12, q50=0.1, q95=0.2)}, ("0.10", "0.10", "0.00", "")),
        ({"value": 12.0, "laplace": Quantiles(q05=2.0, q50=12.0, q95=52.0)}, ("12", "40", "10", "")),
        ({"quantiles": Quantiles(q05=0.1, q50=0.2, q95=0.5)}, ("0.20", "0.30", "0.10", "")),
        ({"laplace": None}, ("0.1", "", "", "undecided")),
        ({"at_bound": "upper"}, ("0.1", "", "", "at bound")),
        ({"fitted": "fixed"}, ("0.1", "", "", "fixed")),
    ],
)
def test_a_value_has_the_digits_that_its_interval_leaves(changes, said):
    assert cell(made(), one(**changes)) == said


def test_results_of_one_material_and_model_are_numbered():
    assert heads([made(), made()]) == ["nickel, two-scale 1", "nickel, two-scale 2"]


def test_results_stand_side_by_side_with_what_they_are(tmp_path):
    plain, other = made(), edited(tmp_path / "nickel.json", made(), {"beta": 0.05})
    latex = as_latex([plain, other]).splitlines()
    assert latex[2] == r"parameter & nickel & nickel (edited) & unit \\"
    assert latex[4] == r"$\beta$ & $0.100^{+0.020}_{-0.020}$ & $0.05$ (edited) &  \\"
    assert r"$k$ B & $3.00^{+0.60}_{-0.60}$ & $3.00^{+0.60}_{-0.60}$ &  \\" in latex
    assert r"RMSE & $0.1$ & -- & sr$^{-1}$ \\" in latex
    assert "nickel (edited): edited from the fit nickel.json: beta 0.1 -$>$ 0.05" in as_latex([plain, other])
    html = as_html([made(material="a<b")])
    assert "σ<sub>s</sub>" in html
    assert "a&lt;b" in html
    assert "+0.020<br>−0.020" in html


def test_the_command_writes_them_and_a_notebook_shows_one(tmp_path):
    write_result(tmp_path / "nickel.json", made())
    for kind, ending in (("latex", "tex"), ("html", "html")):
        for _ in range(2):  # over its own
            shown = call("table", tmp_path, "--format", kind)
            assert shown.exit_code == 0, shown.output
            assert shown.stdout == f"wrote {tmp_path}/table.{ending}: 1 result\n"
    (tmp_path / "table.tex").write_text("mine")
    assert call("table", tmp_path / "nickel.json", "--format", "latex").exit_code == 2
    assert "should be csv, latex, html" in call("table", tmp_path, "--format", "xls").stderr
    shown = merlfit.load(tmp_path / "nickel.json")._repr_html_()
    assert shown.startswith("<p><strong>nickel</strong>: two-scale, conductor")
    assert "<table" in shown
