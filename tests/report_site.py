"""The report of all 100 reconstructions: `make report` fits them (about five minutes) and writes the pages.

`python -m tests.report_site --pictures SITE` takes the screenshots of docs/report/ from a site, `--example RESULTS`
copies two results with posteriors there, as a site of their own.
"""

import argparse
import os
import shutil
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from merlfit.fitting.results.storage import read_result, write_result
from PIL import Image
from playwright.sync_api import sync_playwright

from .bench.materials import every, file
from .bench.processes import MERLFIT
from .support import chromium
from .support.reconstructions import ORIGIN

DOCS = Path(__file__).parents[1] / "docs" / "report"
EXAMPLE = ("gray-plastic", "nickel")
SHOTS = {  # page, width, height, colour scheme
    "index-desktop": ("index.html", 1280, 900, "light"),
    "page-phone": ("materials/{material}.html", 390, 1500, "light"),
    "page-dark": ("materials/{material}.html", 1280, 1500, "dark"),
    "sheet": ("sheets/{material}.html", 800, 1000, "light"),
}


def fit_and_report(out):
    """Fit what has no result yet, then write the pages; MERL_RECONSTRUCTIONS may name a folder for the files."""
    folder = Path(os.environ.get("MERL_RECONSTRUCTIONS", out / "files"))
    folder.mkdir(parents=True, exist_ok=True)
    files = [str(file(folder, material)) for material in every()]
    fitted = [MERLFIT, "fit", *files, "-o", str(out), "--no-posterior", "--resume", "--origin", ORIGIN]
    if subprocess.run(fitted, check=False).returncode not in (0, 1):  # 1: a fit ended at its step limit
        sys.exit("not all files could be fitted")
    subprocess.run([MERLFIT, "report", str(out)], check=True)


def pictures(site, out, material=EXAMPLE[1]):
    """Screenshots as small PNGs."""
    out.mkdir(parents=True, exist_ok=True)
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=chromium.found(), args=list(chromium.OPTIONS))
        for name, (page, width, height, scheme) in SHOTS.items():
            context = browser.new_context(viewport={"width": width, "height": height}, color_scheme=scheme)
            opened = context.new_page()
            opened.goto((site / page.format(material=material)).resolve().as_uri())
            if name != "sheet":  # of paper: what is drawn stays as it is
                opened.wait_for_function("document.documentElement.dataset.charts === 'drawn'", timeout=120_000)
            opened.screenshot(path=out / f"{name}.png")
            context.close()
            shrink(out / f"{name}.png")
        browser.close()


def shrink(path):
    """Without transparency: a palette would change the channels' colours, or the spheres'."""
    Image.open(path).convert("RGB").save(path, optimize=True)


def example(results, out):
    """A site of two materials from a folder of results with posteriors, which are copied there without its name.

    Their chains are not kept beside the pages, which show them.
    """
    files = os.environ["MERL_RECONSTRUCTIONS"]
    with TemporaryDirectory() as scratch:
        kept = Path(scratch) / "two materials"
        kept.mkdir()
        for material in EXAMPLE:
            result = read_result(results / f"{material}.json")
            result.source.path = f"{material}.binary"
            result.config["input"] = {**result.config.get("input", {}), "origin": ORIGIN}
            result.run.folder = None
            result.run.command = ["merlfit", "fit", result.source.path, "-o", "fits", "--origin", ORIGIN]
            write_result(kept / f"{material}.json", result)
            shutil.copy(results / result.posterior.chain_file, kept)
        shutil.rmtree(out, ignore_errors=True)
        shutil.copytree(kept, out)
        subprocess.run([MERLFIT, "report", str(out), "-o", str(out), "-j", "1", "--files", files, "--pdf"], check=True)
        for chain in out.glob("*.npz"):
            chain.unlink()


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out/merl100"), help="folder for results and pages")
    parser.add_argument("--pictures", type=Path, metavar="SITE")
    parser.add_argument("--example", type=Path, metavar="RESULTS")
    asked = parser.parse_args()
    if asked.pictures:
        pictures(asked.pictures, DOCS)
    elif asked.example:
        example(asked.example, DOCS / "example")
    else:
        fit_and_report(asked.out)


if __name__ == "__main__":
    main()
