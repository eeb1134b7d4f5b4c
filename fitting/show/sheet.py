"""A result on a few pages of paper, for whom it was measured: a page of the report's that a browser prints as PDF."""

import os
import shutil
import subprocess
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from ...merl_io.atomic import write_bytes

BROWSERS = (
    "chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome", "microsoft-edge", "msedge",
    "/Applications/Google Chrome.app/Contents/MacOS/Google Chrome",
    "/Applications/Microsoft Edge.app/Contents/MacOS/Microsoft Edge",
    r"C:\Program Files\Google\Chrome\Application\chrome.exe",
    r"C:\Program Files (x86)\Microsoft\Edge\Application\msedge.exe",
)  # fmt: skip
"""Browsers that print without a window, by name or where they are installed."""
LONGEST_S = 120  # that printing may take


class NotPrinted(Exception):
    """A sheet could not be printed; says why, and what to do."""


@dataclass(frozen=True)
class Head:
    """What the user writes over a sheet; what is None is not told, or follows from the result."""

    title: str | None = None
    sample: str | None = None
    operator: str | None = None

    def of(self, material: str) -> Mapping[str, str]:
        """Its texts for a result."""
        sample = self.sample or material
        return {"title": self.title or f"Scatter of {sample}", "sample": sample, "operator": self.operator or ""}


def printed(page: Path, pdf: Path) -> None:
    """Print a page as PDF.

    Raises:
        NotPrinted: there is no browser, or it fails.
        merlfit.merl_io.atomic.WriteError: the PDF cannot be written.
    """
    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    if browser is None:
        raise NotPrinted(
            f"no Chrome, Chromium or Edge was found to print with: open {page} in any browser and print it"
        )
    as_root = ["--no-sandbox"] if hasattr(os, "geteuid") and os.geteuid() == 0 else []
    with TemporaryDirectory(ignore_cleanup_errors=True) as scratch:  # a profile of its own, beside a browser that runs
        made = Path(scratch) / "page.pdf"
        command = [
            browser, "--headless", "--disable-gpu", "--no-pdf-header-footer", f"--user-data-dir={scratch}/profile",
            *as_root, f"--print-to-pdf={made}", page.resolve().as_uri(),
        ]  # fmt: skip
        try:
            done = subprocess.run(command, check=False, capture_output=True, timeout=LONGEST_S)
        except (OSError, subprocess.TimeoutExpired) as error:
            raise NotPrinted(f"{browser} does not print {page} ({error})") from None
        if not made.is_file():
            last = done.stderr.decode(errors="replace").strip().splitlines()[-1:] or [
                f"it ended with {done.returncode}"
            ]
            raise NotPrinted(f"{browser} does not print {page} ({last[0]})")
        write_bytes(pdf, made.read_bytes())
