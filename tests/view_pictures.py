"""Screenshots of `merlfit view` in docs/view/, and how many frames a second it shows while a slider is dragged.

`python -m tests.view_pictures RESULT OTHER` of two results of one file, the first with a posterior. Frames are counted
as they arrive in a real browser, whose pointer moves all the time.
"""

import argparse
import json
import math
import os
import signal
import statistics
import subprocess
import time
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from playwright.sync_api import expect, sync_playwright

from .bench.processes import MERLFIT
from .support import chromium

DOCS = Path(__file__).parents[1] / "docs" / "view"
SECONDS = 6.0  # of dragging
WAIT_MS = 180_000


@contextmanager
def served(*results):
    """The address of the page."""
    with TemporaryDirectory() as folder:
        command = [MERLFIT, "view", *map(str, results), "--no-browser", "-o", folder]
        running = subprocess.Popen(command, text=True, stdout=subprocess.PIPE)
        try:
            yield running.stdout.readline().strip()
        finally:
            running.send_signal(signal.SIGINT)
            running.wait()


def opened(browser, address, panels, width=1280, height=800, scheme="light"):
    """A page with its first fine frame."""
    page = browser.new_context(viewport={"width": width, "height": height}, color_scheme=scheme).new_page()
    page.goto(address)
    rested(page, panels)
    return page


def rested(page, panels=1):
    """When nothing moves any more, and every picture is fine."""
    page.wait_for_timeout(700)
    expect(page.locator(".panel[data-frame=fine]")).to_have_count(panels, timeout=WAIT_MS)


def shot(page, name):
    page.screenshot(path=DOCS / f"{name}.jpg", type="jpeg", quality=85)  # 256 colours make bands on spheres


def held(page, name, share):
    """Press the pointer on a slider and pull it to a share of its width; it stays pressed."""
    place = page.get_by_role("slider", name=f"{name}: ").first.bounding_box()
    middle = place["y"] + place["height"] / 2
    page.mouse.move(place["x"] + place["width"] / 2, middle)
    page.mouse.down()
    for step in range(9):
        page.mouse.move(place["x"] + place["width"] * (0.5 + (share - 0.5) * step / 8), middle)
        page.wait_for_timeout(40)


def film(browser, result, other):
    """Six pictures of one sitting."""
    DOCS.mkdir(parents=True, exist_ok=True)
    with served(result) as address:
        shot(opened(browser, address, 1), "light")
        page = opened(browser, address, 1, scheme="dark")
        held(page, "beta", 0.72)
        page.wait_for_timeout(300)
        shot(page, "dragged")
        page.mouse.up()
        page = opened(browser, address, 1)
        page.get_by_role("radio", name="logarithmic").check(force=True)
        light = page.get_by_role("slider", name="theta_i, the angle of the light", exact=True)
        for _ in range(2):
            light.press("PageUp")
        page.get_by_role("button", name="Measure what each costs").click()
        expect(page.get_by_role("button", name="Measure again")).to_be_visible(timeout=WAIT_MS)
        page.get_by_role("switch").nth(1).click()
        rested(page)
        page.locator(".keep").scroll_into_view_if_needed()
        shot(page, "effects")
        page = opened(browser, address, 1, 390, 844)
        page.get_by_role("slider", name="sigma_s: ").press("PageUp")
        rested(page)
        page.get_by_role("slider", name="sigma_s: ").evaluate("x => x.scrollIntoView({block: 'center'})")
        shot(page, "phone")
        page = opened(browser, address, 1, 390, 844, "dark")
        shot(page, "phone-dark")
    with served(result, other) as address:
        shot(opened(browser, address, 2, height=900, scheme="dark"), "side-by-side")


def rates(browser, result, name):
    """Frames a second, milliseconds of the server for each, and for the fine one that follows."""
    with served(result) as address:
        page, got = opened(browser, address, 1), []
        page.on("websocket", lambda socket: socket.on("framereceived", lambda text: got.append(json.loads(text))))
        page.reload()
        rested(page)
        for warm in (True, False):  # the first time programs are compiled
            held(page, name, 0.5)
            place = page.get_by_role("slider", name=f"{name}: ").first.bounding_box()
            x, y = place["x"] + place["width"] / 2, place["y"] + place["height"] / 2
            got.clear()
            start, k = time.perf_counter(), 0
            while (passed := time.perf_counter() - start) < (2.0 if warm else SECONDS):
                k += 1
                page.mouse.move(x + 60 * math.sin(k / 25), y)
                page.wait_for_timeout(10)
            moving = [each["ms"] for each in got if each.get("moving")]
            page.mouse.up()
            rested(page)
        fine = [each["ms"] for each in got if each.get("moving") is False][-1]
    return len(moving) / passed, statistics.median(moving), max(moving), fine


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("result", type=Path)
    parser.add_argument("other", type=Path)
    parser.add_argument("--rates", action="store_true", help="frames a second alone")
    asked = parser.parse_args()
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=chromium.found(), args=list(chromium.OPTIONS))
        if not asked.rates:
            film(browser, asked.result, asked.other)
        for each in (asked.result, asked.other):
            for name in ("beta", "p"):
                rate, median, longest, fine = rates(browser, each, name)
                print(
                    f"{each.stem} {name}: {rate:.1f} frames/s, {median:.0f} ms each (longest {longest:.0f}), fine "
                    f"{fine:.0f} ms; load {os.getloadavg()[0]:.1f} of {os.cpu_count()} cores",
                    flush=True,
                )
        browser.close()


if __name__ == "__main__":
    main()
