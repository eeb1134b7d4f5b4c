"""The report of a folder: its pages as files, and as a browser shows them."""

import hashlib
import json
import os
import re
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

import jax
import numpy as np
import pytest
from merlfit.fitting.batch.unit import Unit
from merlfit.fitting.commands import cli
from merlfit.fitting.pipeline.draws import chain_of
from merlfit.fitting.pipeline.synthesis import tabulate
from merlfit.fitting.results.manifest import Ending, Journal
from merlfit.fitting.results.schema_parameters import Quantiles, TotalScatter
from merlfit.fitting.results.schema_posterior import sha1_of_draws
from merlfit.fitting.results.storage import write_result
from merlfit.fitting.settings.config import Config
from merlfit.fitting.show import charts, curves, sheet
from merlfit.fitting.show.site import _units
from merlfit.fitting.show.subject import Subject
from merlfit.merl_io.binary import read, write
from merlfit.model.measured import Measured
from merlfit.model.reflectance import contributions
from merlfit.model.rivals.ggx import GGX
from merlfit.model.two_scale import TwoScale
from playwright.sync_api import expect, sync_playwright
from pypdf import PdfReader
from typer.testing import CliRunner

from tests.support import chromium
from tests.support.compiled import evaluate, from_half_difference
from tests.support.made_results import made

ROOT = Path(__file__).parents[2]
NICKEL = {"alpha": 0.1, "F0": np.array([0.6, 0.5, 0.4]), "albedo": np.array([0.05, 0.04, 0.03])}
NAMESPACES = {"http://www.w3.org/2000/svg", "http://www.w3.org/1999/xlink"}  # names, which nobody looks up
EVIL = "</script><script>document.title='owned'</script>"


@pytest.fixture(scope="module")
def run(tmp_path_factory, compiled_quickly):
    """A folder of five: fits of their file, one with a posterior, one without its file; one that failed."""
    folder = tmp_path_factory.mktemp("run")
    write(folder / "nickel.binary", tabulate(lambda g: evaluate(GGX(), NICKEL, g)))
    sha1 = hashlib.sha1((folder / "nickel.binary").read_bytes()).hexdigest()

    def put(name, path="nickel.binary", **options):
        result = made(name, str(folder / path), model=GGX(), sha1=sha1, **options)
        for q in result.parameters:
            value = NICKEL[q.parameter]
            q.value = float(value if q.channel is None else value["RGB".index(q.channel)])
        write_result(folder / f"{name}.json", result)
        return result

    put("nickel").fit.cautions.append(EVIL)
    told = put("red-plastic", posterior=True)
    told.posterior.draws_sha1 = chain(folder / "red-plastic.json", told)
    write_result(folder / "red-plastic.json", told)
    moved = put("white-fabric", "gone.binary")
    moved.fit.cautions, moved.metrics.rmse = [EVIL], 0.001
    write_result(folder / "white-fabric.json", moved)
    failed = Unit(folder / "brass.binary", folder, Config())
    Journal(folder).ended(failed.path, Ending.BAD_INPUT, None, "brass.binary: too short")
    (folder / "sub").mkdir()
    write_result(folder / "sub" / "a name.json", made("a name", str(folder / "nickel.binary"), model=GGX(), sha1=sha1))
    return folder


def chain(path, result):
    """Draws around the fit, as the sampler keeps them; returns their SHA-1."""
    rng, count = np.random.default_rng(1), len(result.parameters)
    values = np.array([q.value for q in result.parameters]) * (1 + 0.03 * rng.normal(size=(300, count)))
    draws, states = {"values": values, "weights": np.full(300, 1 / 300)}, rng.normal(size=(50, 32, count))
    np.savez(chain_of(path), names=[q.name for q in result.parameters], **draws, chain_free=states)
    return sha1_of_draws(**draws)


@pytest.fixture(scope="module")
def site(run):
    done = CliRunner().invoke(cli.app, ["report", str(run), "-o", str(run / "report"), "-j", "1"])
    assert done.exit_code == 0, done.output
    assert done.stdout.endswith(f"wrote {run}/report/index.html: 4 pages; open it in a browser\n")
    assert f"white-fabric: the file is not shown: {run}/gone.binary: " in done.stderr
    return run / "report"


class Links(HTMLParser):
    def __init__(self):
        super().__init__()
        self.found, self.scripts = [], 0

    def handle_starttag(self, tag, attributes):
        self.scripts += tag == "script"
        self.found += [value for name, value in attributes if name in ("href", "src", "xlink:href") and value]


def links(page):
    parser = Links()
    parser.feed(page.read_text())
    return parser


@pytest.mark.parametrize("made_now", [True, False], ids=["made now", "the committed example"])
def test_every_link_leads_to_a_file_of_the_site(made_now, request):
    site = request.getfixturevalue("site") if made_now else ROOT / "docs" / "report" / "example"
    pages = [*site.glob("*.html"), *site.glob("materials/*.html")]
    assert len(pages) == (6 if made_now else 4)
    for page in pages:
        addresses = set(re.findall(r"\w+://[^\s\"'<>]+", page.read_text()))
        assert addresses <= NAMESPACES, page  # nor in the data of a chart, nor in a style
        for link in links(page).found:
            assert not re.match(r"(https?:)?//", link), link
            if not link.startswith(("#", "data:")):
                assert (page.parent / unquote(link.split("?")[0])).resolve().is_file(), f"{page}: {link}"


def test_a_sheet_is_printed_with_what_is_written_over_it(browser, tmp_path):
    """Of scattered directions: texts, TIS with its interval, and the scans beside the fit."""
    table = tmp_path / "paint.csv"
    signed = np.arange(-70.0, 71.0, 10.0)
    lines = [
        f"{i:g},{abs(s):g},{180 if s >= 0 else 0},0.1,{0.3 if s == i else 0.1},0.1" for i in (20, 40) for s in signed
    ]
    table.write_text("\n".join(["theta_i_deg,theta_o_deg,phi_deg,R,G,B", *lines]) + "\n")
    result = made("paint", str(table), model=GGX(), sha1=hashlib.sha1(table.read_bytes()).hexdigest())
    result.source.format, result.source.quantity, result.source.genuine_merl = "table", "brdf", None
    result.tis = [
        TotalScatter(
            theta_i_deg=20.0, channel="G", value=0.123, laplace=Quantiles(q05=0.111, q50=0.123, q95=0.137),
            quantiles=None, file=0.131, stated=None,
        )
    ]  # fmt: skip
    write_result(tmp_path / "paint.json", result)
    words = ["--title", "Scatter report 7", "--sample", "paint <B>", "--operator", "A. Meyer"]
    done = CliRunner().invoke(cli.app, ["report", str(tmp_path), "-j", "1", "--pdf", *words])
    assert done.exit_code == 0, done.output
    pages = PdfReader(tmp_path / "report" / "sheets" / "paint.pdf").pages
    assert (float(pages[0].mediabox.width), float(pages[0].mediabox.height)) == pytest.approx((595, 842), abs=1)
    text = " ".join(" ".join(page.extract_text() for page in pages).split()).replace("\ufb01", "fi")
    for said in ("Scatter report 7", "sample paint <B>", "operator A. Meyer", "20° G 0.123 0.111 .. 0.137 0.131 -",
                 "40° 15 0.3 40° "):  # fmt: skip
        assert said in text, said
    assert sum(len(page.images) for page in pages) >= 1
    assert "../sheets/paint.pdf" in links(tmp_path / "report" / "materials" / "paint.html").found


@pytest.mark.parametrize(
    ("words", "said"),
    [(["--operator", "A."], "add --pdf"), (["--pdf", "--sample", "A"], "--sample A: is of one result, and")],
)
def test_words_of_a_sheet_that_nothing_is_made_of(run, words, said):
    done = CliRunner().invoke(cli.app, ["report", str(run), "-o", str(run / "none"), *words])
    assert done.exit_code == 2
    assert said in " ".join(done.stderr.split())
    assert not (run / "none").exists()


def test_without_a_browser_a_sheet_says_how_it_is_printed(monkeypatch, tmp_path):
    monkeypatch.setattr(sheet, "BROWSERS", ())
    with pytest.raises(sheet.NotPrinted, match=r"a\.html in any browser and print it"):
        sheet.printed(tmp_path / "a.html", tmp_path / "a.pdf")


def test_text_from_results_is_text(site):
    plain, edited = (links(site / "materials" / f"{name}.html").scripts for name in ("nickel", "white-fabric"))
    assert plain == edited
    assert "owned" in (site / "materials" / "white-fabric.html").read_text()


def test_what_a_page_says_without_a_script(site):
    page = (site / "materials" / "red-plastic.html").read_text()
    for said in (
        "not a genuine MERL measurement", "What each effect adds", "What was simulated",
        "width of the distribution of microfacet normals",
        "90 % interval", "merlfit fit", "Walter", "Corner plot", "<svg",
    ):  # fmt: skip
        assert said in page, said
    assert "was not sampled" in (site / "materials" / "nickel.html").read_text()
    assert "brass.binary: too short" in (site / "index.html").read_text()
    assert not (site / "pictures" / "white-fabric.errors.webp").exists()


def test_index_and_pages_are_small(site):
    thumbnails = [p for p in (site / "pictures").iterdir() if ".small-" in p.name]
    assert len(thumbnails) == 7
    size = sum(p.stat().st_size for p in [*thumbnails, site / "index.html", *(site / "assets").iterdir()])
    assert size < 1.5e6
    assert (site / "materials" / "nickel.html").stat().st_size < 8e5


def test_the_lobes_of_a_fit_that_is_the_file(run):
    result = made("nickel", model=GGX())
    for q in result.parameters:
        value = NICKEL[q.parameter]
        q.value = float(value if q.channel is None else value["RGB".index(q.channel)])
    subject = Subject(result, read(run / "nickel.binary"))
    plane, added = curves.lobe_rows(subject)
    seen = [row for row in plane if row["file"] is not None]
    assert len(seen) > 1000
    ratio = np.array([row["fit"] / row["file"] for row in seen])
    assert np.abs(np.median(ratio) - 1) < 0.01
    at = {(row["i"], row["o"], row["channel"]): row["fit"] for row in plane}
    parts = {}
    for row in added:
        parts[row["i"], row["o"]] = parts.get((row["i"], row["o"]), 0) + row["value"]
    assert all(abs(total / at[i, o, "G"] - 1) < 2e-3 for (i, o), total in parts.items())
    widths = curves.peak(subject)[1]
    assert [row["file"] for row in widths] == pytest.approx([row["fit"] for row in widths], rel=0.05)
    assert [row["wavelength"] for row in widths] == sorted((row["wavelength"] for row in widths), reverse=True)


@pytest.mark.parametrize("model", [TwoScale("none"), TwoScale("plastic", index="real"), Measured(TwoScale("lambert"))])
def test_contributions_add_up(model, compiled_quickly):
    geometry = from_half_difference(np.array([0.02, 0.4, 1.5]), np.array([0.3, 0.6, 0.5]), np.array([1.0, 2, 0]))
    values = {q.name: np.full(3, q.default) if q.per_channel else q.default for q in model.parameters}
    found = jax.jit(contributions, static_argnums=0)(model, values, geometry)
    assert set(found) >= {"specular", "diffracted"}
    np.testing.assert_allclose(sum(found.values()), evaluate(model, values, geometry), rtol=1e-12, atol=1e-15)


def test_half_width_of_a_known_peak():
    degrees = np.linspace(0.1, 10, 90)
    assert curves.half_width(degrees, np.exp(-((degrees - 0.1) ** 2))) == pytest.approx(
        0.1 + np.sqrt(np.log(2)), abs=0.01
    )
    assert curves.half_width(degrees, np.ones(90)) is None


def test_a_chart_is_drawn_without_a_browser():
    rows = [{"material": "a", "model": "ggx", "page": "p", "seconds": 2.0, "rmse": 0.1}]
    drawn = charts.svg(charts.time_against_error(rows, {"rmse": "RMSE"}))
    assert drawn.startswith("<svg")
    assert "seconds a file" in drawn
    assert 'id="clip' not in drawn
    assert "aria-label" not in drawn


def test_axes_say_what_they_show_and_cut_nothing_off():
    rows = [
        {"material": name, "model": "two-scale", "page": "p", "seconds": 2.0, "rmse": rmse, "sigma_s": x, "p": x,
         "sigma_s_low": x / 2, "sigma_s_high": 2 * x, "p_low": x / 2, "p_high": 2 * x}
        for name, rmse, x in (("a", 0.1, 0.3), ("b", 0.2, 0.9))
    ]  # fmt: skip
    ranked = charts.svg(charts.sorted_errors(rows, {"rmse": "RMSE (1/sr)"}))
    assert ">RMSE (1/sr)</text>" in ranked
    assert ">1</text>" in ranked
    assert not re.search(r">\d?\.5</text>", ranked)
    names = ["sigma_s", "p", "n_R", "c_two"]
    units = _units({"two-scale"}, names)
    assert units == {"sigma_s": "µm"}
    shown = charts.svg(charts.parameters(rows, names, units))
    assert ">sigma_s (µm)</text>" in shown
    assert ">p</text>" in shown
    lines = [
        float(x)
        for x in re.findall(r'<line transform="translate\((\S+),\S+\)" x2="\S+" y2="0" stroke="#0072B2"', shown)
    ]
    assert len(lines) == 2
    assert min(lines) > charts.PADDING - 1


@pytest.mark.parametrize(
    ("last", "ticks"), [(1, [1]), (2, [1, 2]), (9, [1, 2, 4, 6, 8]), (100, [1, 20, 40, 60, 80, 100])]
)
def test_ranks_are_whole_numbers(last, ticks):
    assert charts._ranks(last) == ticks


@pytest.fixture(scope="module")
def browser():
    path = chromium.found()
    if path is None:
        (pytest.fail if os.environ.get("CI") else pytest.skip)(chromium.ABSENT)
    with sync_playwright() as driver:
        opened = driver.chromium.launch(executable_path=path, args=list(chromium.OPTIONS))
        yield opened
        opened.close()


@pytest.fixture
def opened(browser, site):
    """Opens a page of the site; in the end nothing may have been complained of, and nothing asked of a network."""
    complaints, asked, context = [], [], browser.new_context()

    def open_page(name, width=1280):
        page = context.new_page()
        page.set_viewport_size({"width": width, "height": 900})
        page.on("console", lambda message: complaints.append(message.text) if message.type == "error" else None)
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on("request", lambda request: asked.append(request.url))
        page.goto((site / name).as_uri())
        return page

    yield open_page
    context.close()
    assert complaints == []
    assert [url for url in asked if not url.startswith(("file:", "data:", "blob:"))] == []


def drawn(page):
    page.wait_for_function("document.documentElement.dataset.charts === 'drawn'")
    return page


def names(page):
    return page.locator("#results tbody tr:visible th").evaluate_all(
        "heads => heads.map(h => h.firstChild.textContent.trim())"
    )


def test_index_sorts_and_filters(opened):
    page = drawn(opened("index.html"))
    assert len(names(page)) == 5
    page.get_by_role("button", name="RMSE").click()
    assert names(page)[0] == "white-fabric"
    assert names(page)[-1] == "brass"  # has none
    page.get_by_role("button", name="RMSE").press("Enter")  # by the keyboard, the other way
    assert names(page)[-2:] == ["white-fabric", "brass"]
    expect(page.locator("th[aria-sort=descending]")).to_have_text("RMSE (1/sr)")
    page.get_by_role("searchbox").fill("NICK")
    assert names(page) == ["nickel"]
    expect(page.locator("#shown")).to_have_text("1 of 5 shown")
    page.get_by_role("searchbox").fill("")
    page.locator("[name=status]").select_option("bad input")
    assert names(page) == ["brass"]
    page.locator("[name=status]").select_option("")
    page.locator("[name=group]").select_option("fabrics")
    assert names(page) == ["white-fabric"]


def test_the_slider_of_a_page_changes_its_plot(opened):
    page = drawn(opened("materials/nickel.html"))
    before = page.locator("#chart-lobes svg").first.inner_html()
    slider = page.locator("#chart-lobes input[type=range]")
    slider.focus()
    slider.press("ArrowRight")
    page.wait_for_function("before => document.querySelector('#chart-lobes svg').innerHTML !== before", arg=before)
    turned = page.locator("#chart-lobes svg").first.inner_html()
    page.locator("#chart-lobes select").select_option("logarithmic")
    page.wait_for_function("before => document.querySelector('#chart-lobes svg').innerHTML !== before", arg=turned)
    assert page.title() == "nickel - merlfit"


def test_the_line_over_a_sphere_follows_the_arrow_keys(opened):
    page = drawn(opened("materials/nickel.html"))
    slider = page.get_by_role("slider", name="Share of the sphere under a small lamp that shows the file")
    fit = page.get_by_alt_text("Sphere: fit, under a small lamp")
    expect(fit).to_have_css("clip-path", "inset(0px 0px 0px 50%)")
    slider.press("ArrowRight")
    expect(fit).to_have_css("clip-path", "inset(0px 0px 0px 51%)")
    slider.press("Home")
    expect(fit).to_have_css("clip-path", "inset(0px 0px 0px 0%)")
    assert page.locator(".wipe").first.bounding_box()["width"] > 250


def test_charts_are_as_wide_as_the_page_and_legible_in_the_dark(opened):
    page = opened("materials/nickel.html", width=1440)
    page.emulate_media(color_scheme="dark")
    drawn(page)
    widths = page.evaluate("[...document.querySelectorAll('svg.marks')].map(x => x.clientWidth)")
    assert min(widths) > 1250
    paper, words = page.evaluate(
        "[getComputedStyle(document.body).backgroundColor,"
        " getComputedStyle(document.querySelector('#chart-lobes svg.marks text')).fill]"
    )
    assert (paper, words) == ("rgb(21, 24, 28)", "rgb(230, 232, 234)")
    expect(page.get_by_alt_text("Isolines of the BRDF")).to_have_css("mix-blend-mode", "screen")
    page.set_viewport_size({"width": 390, "height": 900})
    page.wait_for_function("[...document.querySelectorAll('svg.marks')].every(x => x.clientWidth <= 370)")


def test_two_results_side_by_side(opened):
    page = opened("compare.html")
    expect(page.frame_locator("#left-page").locator("h1")).to_have_text("a name")
    page.locator("#right").select_option("white-fabric")
    expect(page.get_by_alt_text("Sphere: right result, under an environment")).to_have_js_property("naturalWidth", 384)
    errors = page.locator("#numbers tr", has_text="RMSE")
    expect(errors.locator("td")).to_have_text(["0.1", "0.001"])
    expect(errors.locator("strong")).to_have_text("0.001")
    expect(page.locator("#numbers tr", has_text="alpha").locator("td").first).to_have_text("0.1")
    expect(page.frame_locator("#right-page").locator("h1")).to_have_text("white-fabric")


def test_a_click_from_the_index_opens_a_page_and_no_page_is_wider_than_a_phone(opened):
    page = drawn(opened("index.html", width=390))
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    page.get_by_role("link", name="white-fabric", exact=True).click()
    drawn(page)
    assert page.title() == "white-fabric - merlfit"
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    assert json.loads(page.locator("script.spec").first.text_content())["vconcat"]


def test_from_the_readme_to_the_page_of_a_material_in_two_clicks(opened):
    first = re.search(r"\[An example of the report\]\(([^)]+)\)", (ROOT / "README.md").read_text())[1]
    page = drawn(opened(ROOT / first))
    page.get_by_role("link", name="nickel", exact=True).click()
    drawn(page)
    assert page.title() == "nickel - merlfit"
    expect(page.get_by_role("img", name="Corner plot of the posterior")).to_be_visible()
