"""The live view: its state without a browser, the page in one, the widget of notebooks."""

import base64
import http.client
import io
import json
import math
import os
import re
import signal
import subprocess
import sys
from dataclasses import replace
from hashlib import sha1
from urllib.parse import urlsplit

import anyio
import numpy as np
import pytest
from merlfit.fitting.commands import cli
from merlfit.fitting.fit_object import Fit
from merlfit.fitting.results.storage import read_result, write_result
from merlfit.fitting.show.prediction import Fitted, all_bins, plane_of_incidence
from merlfit.fitting.show.spheres import SIDE
from merlfit.fitting.view.frames import Look, Shown
from merlfit.fitting.view.live import Live
from merlfit.fitting.view.server import application
from merlfit.merl_io import inputs
from merlfit.merl_io.binary import write
from merlfit.model.measured import Measured
from merlfit.model.parameters import WAVELENGTHS_UM
from merlfit.model.two_scale import TwoScale
from PIL import Image
from playwright.sync_api import expect, sync_playwright
from typer.testing import CliRunner

from tests.support import chromium
from tests.support.compiled import evaluate, from_vectors
from tests.support.made_results import made

DIMS = (90, 30, 24)  # those of frames that move: a program for both
MODEL = Measured(TwoScale("lambert"))  # of a dielectric over a Lambert body, as the apparatus sees it
ALBEDOS = {"albedo_R": 0.4, "albedo_G": 0.2, "albedo_B": 0.05}


@pytest.fixture(scope="module")
def fitted(tmp_path_factory):
    """A file that a model describes entirely, and its result."""
    folder = tmp_path_factory.mktemp("view")
    result = made("paint", "paint.binary", model=MODEL)
    for q in result.parameters:
        q.value = ALBEDOS.get(q.name, q.value)
    result.source.dims = DIMS
    half = all_bins(Fitted.tabled(result.model, result.values()), DIMS)
    write(folder / "paint.binary", np.concatenate([half, half[..., ::-1]], -1), dims=DIMS)
    result.source.sha1 = sha1((folder / "paint.binary").read_bytes()).hexdigest()
    write_result(folder / "paint.json", result)
    return folder / "paint.json"


@pytest.fixture(scope="module")
def shown(fitted):
    return Shown(fitted, read_result(fitted))


@pytest.fixture
def live(shown, tmp_path):
    return Live([shown], tmp_path, ["gltf"])


def frame(values=(), **other):
    return {
        "ask": "frame",
        "result": 0,
        "values": dict(values),
        "theta_i": 40.0,
        "exposure": 0.0,
        "moving": False,
    } | other


def of_model(model, result, lobe, **changed):
    """What the model itself gives, without any table, in the directions of a lobe."""
    i, o = plane_of_incidence(np.radians(lobe["theta_i"]), np.radians(lobe["angles"]))
    names = {q.name for q in model.parameters}
    values = {name: x for name, x in {**result.values(), **changed}.items() if name in names}
    return np.asarray(evaluate(model, values, from_vectors(i, o), WAVELENGTHS_UM))


def test_a_slider_changes_the_lobe_to_what_the_model_gives(live, shown):
    before, after = live.answer(frame()), live.answer(frame({"beta": 0.2, "albedo_G": 0.6}))
    assert not {"error"} & (before.keys() | after.keys())
    np.testing.assert_allclose(before["lobe"]["fit"], of_model(MODEL, shown.result, before["lobe"]), rtol=2e-3)
    changed = of_model(MODEL, shown.result, after["lobe"], beta=0.2, albedo=np.array([0.4, 0.6, 0.05]))
    np.testing.assert_allclose(after["lobe"]["fit"], changed, rtol=2e-3)
    assert after["lobe"]["before"] == before["lobe"]["fit"]
    file = np.interp(before["lobe"]["at"], before["lobe"]["angles"], before["lobe"]["fit"][1])
    seen = np.abs(np.array(before["lobe"]["at"])) < 75
    np.testing.assert_allclose(np.array(before["lobe"]["file"][1])[seen], file[seen], rtol=0.1)


def test_spheres_are_those_of_the_file_until_something_is_changed(live):
    same, other = live.answer(frame()), live.answer(frame({"albedo_R": 0.6}))
    assert max(same["apart"].values()) < 0.05
    assert min(other["apart"].values()) > 3
    for light in ("lamp", "environment"):
        ours, theirs, changed = (picture(x[light]) for x in (same["pictures"], same["file"], other["pictures"]))
        assert ours.shape == (SIDE, SIDE, 3)
        assert np.abs(ours - theirs).max() <= 1
        assert (changed - ours)[..., 0].max() > 20
        assert np.abs(changed - ours)[..., 1:].max() <= 1
    brighter = live.answer(frame(exposure=1.0))
    middle = SIDE // 2, SIDE // 2
    assert linear(picture(brighter["file"]["lamp"])[middle]) == pytest.approx(
        2 * linear(picture(same["file"]["lamp"])[middle]), rel=0.03
    )  # fmt: skip


def picture(address):
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(address.partition(",")[2])))).astype(int)


def linear(bytes_of_srgb):
    return ((bytes_of_srgb / 255 + 0.055) / 1.055) ** 2.4


def test_a_frame_that_moves_is_nearly_the_fine_one(live):
    fine, quick = live.answer(frame({"beta": 0.15})), live.answer(frame({"beta": 0.15}, moving=True))
    assert (quick["file"], quick["apart"], quick["moving"]) == (None, None, True)
    np.testing.assert_allclose(quick["lobe"]["fit"], fine["lobe"]["fit"], rtol=0.02)
    inside = np.hypot(*(np.indices((SIDE, SIDE)) - SIDE / 2)) < 0.95 * SIDE / 2
    for light in ("lamp", "environment"):
        apart = np.abs(picture(quick["pictures"][light]) - picture(fine["pictures"][light])).max(-1)[inside]
        assert np.median(apart) <= 2
        assert np.quantile(apart, 0.99) < 12


def test_the_files_spheres_have_the_exposure_of_the_fits(live):
    assert live.answer(frame(moving=True, exposure=1.0))["file"]
    assert live.answer(frame(moving=True, exposure=1.0))["file"] is None  # they look the same
    brighter = live.answer(frame(moving=True, exposure=2.0))["file"]
    assert (
        picture(brighter["environment"]).mean()
        > picture(live.answer(frame(exposure=1.0))["file"]["environment"]).mean()
    )


def test_samples_of_scattered_directions_are_shown_where_they_lie(fitted):
    table = {
        "theta_i_deg": [45.0, 45.0, 45.0, 10.0], "theta_o_deg": [30.0, 45.0, 20.0, 10.0],
        "phi_deg": [180.0, 179.0, 90.0, 180.0], "values": [[1.0, 2.0, 3.0]] * 4,
        "wavelengths_um": [0.645, 0.526, 0.444],
    }  # fmt: skip
    shown = Shown(fitted, read_result(fitted))
    shown.subject = replace(shown.subject, scattered=inputs.read(table), measurement=None)
    lobe = shown.lobe(Look(shown.numbers({})), 45.0)
    assert lobe["at"] == [30.0, 45.0]  # neither across the plane nor at another incidence
    assert lobe["file"] == [[1.0, 1.0], [2.0, 2.0], [3.0, 3.0]]


def test_an_effect_that_is_off_is_not_simulated(live, shown):
    without = live.answer(frame(off=["diffraction"]))["lobe"]
    plain = Measured(MODEL.material.changed(diffraction="off"))
    np.testing.assert_allclose(without["fit"], of_model(plain, shown.result, without), rtol=2e-3)
    assert [e["name"] for e in live.about["results"][0]["effects"]][:2] == ["finest blur", "diffraction"]


@pytest.mark.parametrize(
    ("message", "said"),
    [
        (frame({"betta": 0.1}), "there is no free parameter 'betta'; there are beta, p, "),
        (frame({"beta": 1.5}), "beta: 1.5 is outside its bounds, 0.001 to 1"),
        (frame({"beta": math.nan}), "values.beta: Input should be a finite number"),
        (frame(off=["magic"]), "there is no effect magic"),
        (frame(theta_i=89.0), "theta_i: Input should be less than or equal to 85"),
        (frame(result=1), "there is no result 1"),
        ({"ask": "frame"}, "frame.result: Field required"),
        ({"ask": "dance"}, "Input tag 'dance' found using 'ask' does not match"),
        ({"ask": "save", "result": 0, "values": {}, "name": "x"}, "nothing was changed: there is nothing to save"),
        ({"ask": "save", "result": 0, "values": {"beta": 0.2}, "name": "../x"}, "'../x' is not the name of a file"),
        ({"ask": "save", "result": 0, "values": {"beta": 0.2}, "name": ".json"}, "name: String should match pattern"),
        ({"ask": "save", "result": 0, "values": {"beta": 0.2}, "name": "-o"}, "name: String should match pattern"),
        ({"ask": "export", "result": 0, "path": "/etc/passwd", "to": "gltf"}, "save first, and choose a format"),
    ],
)  # fmt: skip
def test_what_cannot_be_answered_is_said(message, said, live, tmp_path):
    found = live.answer(message)
    assert said in found["error"]
    assert found["answer"] == message["ask"]
    assert not list(tmp_path.iterdir())


def test_what_is_saved_says_that_it_was_edited(live, fitted, tmp_path):
    ask = {"ask": "save", "result": 0, "values": {"beta": 0.2}, "name": "paint.edited"}
    found = live.answer(ask)
    saved = read_result(found["path"])
    assert found["path"] == str(tmp_path / "paint.edited.json")
    assert saved.values()["beta"] == 0.2
    assert (saved.edited_from.result, saved.edited_from.fitted) == (str(fitted), {"beta": 0.1})
    assert saved.metrics.rmse is None
    assert found["name"] == "paint.edited-2"
    assert live.answer(ask)["error"].endswith("paint.edited.json: is there already; give it another name")


def test_tied_channels_move_and_are_saved_together(fitted, tmp_path):
    result = read_result(fitted)
    for q in result.parameters:
        if q.parameter == "albedo":
            q.fitted, q.value = "free" if q.channel == "G" else "tied", 0.2
    shown = Shown(fitted, result)
    assert shown.changes({"albedo_G": 0.3}) == {"albedo": 0.3}
    live = Live([shown], tmp_path)
    assert [q["name"] for q in live.about["results"][0]["parameters"] if q["parameter"] == "albedo"] == ["albedo_G"]
    found = live.answer({"ask": "save", "result": 0, "values": {"albedo_G": 0.3}, "name": "tied"})
    assert read_result(found["path"]).values()["albedo"].tolist() == [0.3, 0.3, 0.3]


def test_the_widget_of_a_notebook_answers_as_the_page_is_answered(fitted, live, monkeypatch):
    widget = Fit(read_result(fitted), fitted).view()
    sent = []
    monkeypatch.setattr(widget, "send", sent.append)
    widget._heard(widget, frame({"beta": 0.2}, moving=True), [])
    assert sent[0]["lobe"]["fit"] == live.answer(frame({"beta": 0.2}, moving=True))["lobe"]["fit"]
    assert widget.values == [{"beta": 0.2}]
    assert "function render" in widget._esm
    assert widget.about["results"][0]["name"] == "paint"


def test_the_extra_that_is_missing_is_named(fitted, monkeypatch):
    monkeypatch.setitem(sys.modules, "uvicorn", None)
    monkeypatch.delitem(sys.modules, "merlfit.fitting.view.server", raising=False)
    done = CliRunner().invoke(cli.app, ["view", str(fitted)])
    assert done.exit_code == 2
    assert "pip install 'merlfit[view]'" in done.stderr


@pytest.fixture
def served(fitted, tmp_path):
    """The command itself; in the end Ctrl-C ends it, and nothing was complained of."""
    command = [sys.executable, "-m", "merlfit", "view", str(fitted), "--no-browser", "-o", str(tmp_path)]
    running = subprocess.Popen(command, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    address = running.stdout.readline().strip()
    assert re.fullmatch(r"http://127\.0\.0\.1:\d+/[\w-]{22}/", address), running.communicate()
    yield address
    running.send_signal(signal.SIGINT)
    printed, said = running.communicate(timeout=60)
    assert running.returncode == 0, said
    assert printed.endswith("ended\n"), (printed, said)
    assert "Traceback" not in said


def status(address, path, **headers):
    """Of a request, with headers of its own."""
    where = urlsplit(address)
    connection = http.client.HTTPConnection(where.hostname, where.port, timeout=30)
    connection.request("GET", path, headers=headers)
    found = connection.getresponse()
    connection.close()
    return found.status


def test_a_slider_of_the_page_moves_the_lobe_and_what_is_saved_holds_its_value(served, tmp_path):
    page_of, own = urlsplit(served).path, urlsplit(served).netloc
    upgrade = {
        "Upgrade": "websocket",
        "Connection": "Upgrade",
        "Sec-WebSocket-Version": "13",
        "Sec-WebSocket-Key": "A" * 22 + "==",
    }
    assert status(served, page_of) == 200
    assert status(served, "/") == status(served, "/guessed/") == 404
    assert status(served, page_of, Host="rebound.example") == 403
    assert status(served, page_of, Origin="http://elsewhere.example") == 403
    assert status(served, f"{page_of}live", Origin="http://elsewhere.example", **upgrade) == 403
    assert status(served, f"{page_of}live", **upgrade) == 403
    assert status(served, f"{page_of}live", Origin=f"http://{own}", **upgrade) == 101
    path = chromium.found()
    if path is None:
        (pytest.fail if os.environ.get("CI") else pytest.skip)(chromium.ABSENT)
    asked, complaints = [], []
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=path, args=list(chromium.OPTIONS))
        page = browser.new_page(viewport={"width": 390, "height": 844})
        page.on("request", lambda request: asked.append(request.url))
        page.on("websocket", lambda socket: asked.append(socket.url))
        page.on("console", lambda message: complaints.append(message.text) if message.type == "error" else None)
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.goto(served)
        panel = page.locator(".panel[data-frame=fine]")
        expect(panel).to_have_count(1, timeout=120_000)
        assert page.evaluate("document.documentElement.scrollWidth") <= 390
        green = page.locator("path.fit[data-channel=G]")
        before, sphere = (
            green.get_attribute("d"),
            page.get_by_alt_text("Sphere of the fit under the lamp").get_attribute("src"),
        )
        slider = page.get_by_role("slider", name="beta: width")
        slider.scroll_into_view_if_needed()
        place = slider.bounding_box()
        middle = place["y"] + place["height"] / 2
        page.mouse.move(place["x"] + 8 + (place["width"] - 16) * 2 / 3, middle)  # beta = 0.1 of 0.001 to 1
        page.mouse.down()
        for step in range(6):
            page.mouse.move(place["x"] + place["width"] * (0.7 + 0.02 * step), middle)
        page.mouse.up()
        expect(green).not_to_have_attribute("d", before)
        expect(page.get_by_alt_text("Sphere of the fit under the lamp")).not_to_have_attribute("src", sphere)
        page.get_by_role("slider", name="albedo, channel G").press("PageUp")  # by the keyboard
        typed = page.get_by_label("beta, number")
        typed.fill("0.25")
        typed.press("Enter")
        page.get_by_role("radio", name="logarithmic").check(force=True)
        light = page.get_by_role("slider", name="theta_i, the angle of the light", exact=True)
        light.press("ArrowLeft")
        expect(light).to_have_attribute("aria-valuenow", "46")
        page.get_by_role("button", name="Save as a result").click()
        expect(page.locator(".said")).to_contain_text("paint.edited.json")
        browser.close()
    assert complaints == []
    assert {urlsplit(url).netloc for url in asked if not url.startswith("data:")} == {own}
    saved = read_result(tmp_path / "paint.edited.json")
    assert saved.values()["beta"] == 0.25
    assert saved.values()["albedo"][1] > 0.2
    assert json.loads((tmp_path / "paint.edited.json").read_text())["edited_from"]["fitted"].keys() == {
        "beta",
        "albedo_G",
    }


def asked(app, path):
    """Status and headers of what is answered."""
    sent = []

    async def send(message):
        sent.append(message)

    scope = {
        "type": "http",
        "method": "GET",
        "path": path,
        "query_string": b"",
        "headers": [(b"host", b"127.0.0.1:80")],
    }
    anyio.run(app, scope, None, send)
    return sent[0]["status"], dict(sent[0]["headers"])


def test_what_a_browser_is_started_with_leads_to_the_page_once():
    """Everybody on the machine can read it."""
    app = application(None, "token", 80, "once")
    status, headers = asked(app, "/once")
    assert (status, headers[b"location"]) == (307, b"/token/")
    assert asked(app, "/once")[0] == asked(app, "/")[0] == 404
    assert asked(app, "/token/")[0] == 200
