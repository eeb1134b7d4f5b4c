"""Files that a command writes: what it may write over."""

import os
import re
import time
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import IO

from ...merl_io.atomic import WriteError, appendable
from ...merl_io.source import MerlError, opened

LOOK = 2**14  # bytes at both ends of a file
MARKS = {
    "manifest.jsonl": rb'\A\{"at": "[^"\n]*", "event": "(began|file|ended)"',
    "table.csv": rb"\Amaterial,status,model,variant,genuine_merl,",
    "table.tex": rb"\A% [^\n]* by merlfit ",
    "metrics.csv": rb"\Aresult,against,data,model,",
    "by_incidence.csv": rb"\Atheta_i_deg,[^\n]*\.json",
    "comparison.csv": rb"\Agroup,material,",
    "comparison.md": rb"\A# [^\n]*\n\nData: [^\n]*\. Errors over [^\n]* bins of \(theta_h",
    "cost.md": rb"\A# What accuracy costs in time\n",
    "frontier.json":
        rb'\A\{\s*"schema_version": "[\d.]+",\s*("objective": \d+,\s*)?"data": "([^"\\]|\\.)*",'
        rb'\s*"(directions|materials)":',
    "rows.json": rb'\A\{\s*"made of": \{',
    "render.json": rb'\A\{\s*"seconds": \{[^}]*\},\s*"difference": \{[^}]*\},\s*"within":',
    ".material.json": rb'\A\{\s*"format": "merlfit-material ',
    ".stacked.json": rb'\A\{\s*"format": "merlfit-stacked ',
    ".abg.json": rb'\A\{\s*"format": "merlfit-abg ',
    ".k-correlation.json": rb'\A\{\s*"format": "merlfit-k-correlation ',
    ".zemax.bsdf": rb"\A# [^\n]* by merlfit ",
    ".bsdf": rb"\Atensor_file\x00[\s\S]*tabulated by merlfit ",
    ".rgl.xml": rb"\A<\?xml[^>]*>\n<!-- ((?!-->)[\s\S])* by merlfit ",
    ".blender.py": rb"\A# [^\n]* by merlfit ",
    ".pbrt": rb"\A# [^\n]* by merlfit ",
    ".json": rb'\A\s*\{\s*"schema_version"\s*:\s*"\d+\.\d+",\s*"(run|source)"\s*:',
    ".mitsuba.npz": rb"\APK\x03\x04[\s\S]{26}brdf\.npy[\s\S]*share\.npy[\s\S]*below\.npy",
    ".principled.xml": rb"\A<\?xml[^>]*>\n<!-- ((?!-->)[\s\S])* by merlfit ",
    ".xml": rb"\A<\?xml[^>]*>\n<!-- ((?!-->)[\s\S])*python -m merlfit\.scene\.mitsuba ",
    ".gltf": rb'\A\{\s*"asset": \{\s*"version": "2\.0",\s*"generator": "merlfit"',
    ".mtlx": rb"\A<\?xml[^>]*>\n<!-- ((?!-->)[\s\S])* by merlfit ",
    ".html":
        rb'\A<!doctype html>[\s\S]*?(<meta name="generator" content="merlfit">|<title>[^<]*merlfit</title>\s*<(link '
        rb'rel="icon" href="data:,">|p>These pages are being written,))',
    ".png": rb"\A\x89PNG\r\n\x1a\n[\s\S]{29,200}?tEXtSoftware\0merlfit",
    ".pdf": rb"\A%PDF-[\s\S]*/Creator \(merlfit\)",
    ".svg": rb"\A<\?xml[\s\S]*?<dc:creator>\s*<cc:Agent>\s*<dc:title>merlfit</dc:title>",
    ".exr": rb"\Av/1\x01[\s\S]*?software\0string\0[\s\S]{4}merlfit",
}  # fmt: skip
"""What outputs of commands are known by, by the end of their names, the first that fits: a key or a head at its place
in the first lines; of binary files where their format says who made them."""


def log_of(out: Path, name: str) -> Path:
    """The log of a material in a folder of results: what was done when, and where in the code something went wrong."""
    return out / "logs" / f"{name}.log"


def log(path: Path, text: str) -> None:
    """Add a line to a log, if that can be written into the folder of results itself."""
    line = f"{time.strftime('%Y-%m-%dT%H:%M:%S')} {text.strip()}\n"
    with suppress(OSError), open_log(path) as file:
        file.write(line.encode(errors="backslashreplace"))


def open_log(path: Path) -> IO[bytes]:
    """A log, open at its end.

    Raises:
        OSError: there cannot be one, or it, or its folder, is a link.
    """
    path.parent.mkdir(exist_ok=True)  # not the folder for results: one that goes away is not to come back empty
    if path.parent.is_symlink():
        raise OSError("its folder is a symbolic link")
    return appendable(path)


def refuse_others(paths: Iterable[Path], force: bool = False, kind: str | None = None) -> None:
    """Leave alone what stands where a command writes, unless an earlier one wrote it.

    Args:
        paths: that it will write. force: write over anything. kind: as of `is_ours`.

    Raises:
        WriteError: one of them is no earlier output.
    """
    for path in () if force else paths:
        if os.path.exists(path) and not is_ours(path, kind):
            raise WriteError(
                f"{path}: is there already, and no earlier output of this command: move it, write elsewhere (-o), or "
                "overwrite it (--force), as what an older merlfit wrote without its mark"
            )


def refuse_present(path: Path, force: bool = False) -> None:
    """Leave a MERL file alone, which has no mark: whether it was measured cannot be told.

    Raises:
        WriteError: it is there.
    """
    if os.path.exists(path) and not force:
        raise WriteError(f"{path}: is there already, and may be a measurement; --force overwrites it")


def is_ours(path: Path, kind: str | None = None) -> bool:
    """Whether a regular file has the mark of an output; an empty one has nothing to lose.

    Args:
        kind: which of `MARKS`; by the file's name if it is none.
    """
    try:
        with opened(path) as (file, size):
            text = file.read(LOOK)
            file.seek(max(LOOK, size - LOOK))
            text += file.read(LOOK)
    except MerlError:
        return False
    return not size or re.search(_mark(kind or path.name), text) is not None


def _mark(name: str) -> bytes:
    """What a file of this name is known by; nothing is, where no command writes such files."""
    return next((mark for ending, mark in MARKS.items() if name.endswith(ending)), rb"(?!)")
