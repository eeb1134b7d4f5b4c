"""A headless Chromium for tests, the system's own; where there is none and this is root, Debian's is installed."""

import os
import shutil
import subprocess

NAMES = ("chromium", "chromium-browser", "google-chrome")
OPTIONS = (
    "--no-sandbox", "--disable-gpu", "--disable-background-networking", "--disable-component-update", "--disable-sync",
)  # fmt: skip
ABSENT = "no Chromium: install Debian's package chromium"


def found():
    """Its path; None if there is none and none can be installed."""
    path = next(filter(None, map(shutil.which, NAMES)), None)
    if path is None and os.geteuid() == 0 and shutil.which("apt-get"):
        for command in (("apt-get", "update", "-qq"), ("apt-get", "install", "-y", "-qq", "chromium")):
            subprocess.run(command, check=False, capture_output=True, timeout=300)
        path = next(filter(None, map(shutil.which, NAMES)), None)
    return path
