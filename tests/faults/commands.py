"""Readers of scenes, draws, manifests and maps, names of files, and command lines, all hostile; in this process."""

import io
import json
import os
import random
import tempfile
import time
import tracemalloc
from collections import Counter
from contextlib import redirect_stderr, redirect_stdout
from functools import cache
from pathlib import Path

import numpy as np
from merlfit.fitting.commands import cli
from merlfit.fitting.pipeline.draws import NoPicture, chain_file
from merlfit.fitting.results.manifest import NAME, lines
from merlfit.fitting.results.storage import write_result
from merlfit.merl_io.source import LONGEST
from merlfit.scene import description
from merlfit.scene.images import read_map

from ..support.made_results import made, made_draws
from .inputs import TABLE
from .loaders import ROOT, damaged, result, trial

SLOWEST = 20.0  # seconds that a command may take
NAMES = [
    "plain", "-o", "--help", "a b", "caf\udce9", "\x1b]52;c;aGk=\x07", "\u202egnp", "$\\frac{$", "=1+1", "x" * 246,
    "m\u00fcsli", "%2e%2e", ":smiley:", "[red]", "..", "", "{name}", "a\nb", "<b>&", "'\"", "/dev/zero", "/dev/null",
    "\0", "x" * 300,
]  # fmt: skip


@cache
def sampled():
    """A result with a posterior."""
    return made(posterior=True)


def scene(rng):
    """One of the shipped scenes, damaged as bytes or by a value of another kind."""
    content = rng.choice(sorted((ROOT / "configs" / "scenes").glob("*.toml"))).read_text()
    if rng.random() < 0.5:
        return damaged(rng, content.encode())
    rows = content.splitlines()
    at = rng.choice([n for n, row in enumerate(rows) if "=" in row])
    others = [
        "-1",
        "0",
        "1e999",
        "nan",
        "9" * 400,
        '"' + "x" * 900 + '"',
        "[]",
        "{}",
        "true",
        '"/dev/zero"',
        '"\\u0000"',
    ]
    rows[at] = f"{rows[at].split('=')[0]} = {rng.choice(others)}"
    return "\n".join(rows).encode()


def manifest(rng):
    """Lines of a manifest, damaged."""
    line = {"at": "x", "event": "file", "material": "a", "file": "a.binary", "ended": "failed", "error": "e"}
    return damaged(rng, (json.dumps(line) + "\n").encode() * 5)


def draws(rng):
    """Of a posterior, of the right names and shape: damaged, or with numbers that no fit has."""
    size = len(sampled().parameters)
    arrays = {
        "names": np.array([q.name for q in sampled().parameters]), **made_draws(size),
    }  # fmt: skip
    name = rng.choice(["values", "weights"])
    arrays[name] = arrays[name] * rng.choice([1.0, 1e300, -1e300, 0.0, np.nan, 1e-320])
    file = io.BytesIO()
    np.savez_compressed(file, **arrays)
    return file.getvalue() if rng.random() < 0.3 else damaged(rng, file.getvalue())


def picture(rng):
    """A map of light: an NPY, damaged."""
    file = io.BytesIO()
    np.save(file, np.ones((4, 8, 3), np.float32))
    return damaged(rng, file.getvalue())


def read_draws(path):
    """As pictures read them."""
    given = sampled()
    given.posterior.chain_file = path.name
    return chain_file(given, path.with_name("made.json"))


def read_manifest(path):
    """All of its lines that are whole."""
    path.replace(path.with_name(NAME))
    path.touch()
    return list(lines(path.parent))


def refused(words):
    """What is wrong about a command ('' if nothing), and its exit code."""
    begun = time.monotonic()
    out, err = (io.TextIOWrapper(io.BytesIO(), "utf-8", errors="backslashreplace") for _ in range(2))  # as `run` does
    code = 0
    with redirect_stdout(out), redirect_stderr(err):
        try:
            cli.app([str(word) for word in words])
        except SystemExit as end:
            code = end.code or 0
        except Exception as error:  # what this looks for
            return f"traceback: {type(error).__name__}: {error}", 1
    printed, said = (stream.buffer.getvalue().decode() for stream in (out, err) if stream.flush() is None)
    if (took := time.monotonic() - begun) > SLOWEST:
        return f"{took:.0f} s", code
    if code not in (0, 1, 2):
        return f"exit code {code}", code
    if code and not said:
        return "nothing is said", code
    if any((ord(c) < 0x20 and c != "\n") or 0x7F <= ord(c) < 0xA0 or c == "\u202e" for c in said + printed):
        return "the terminal is steered", code
    if max(map(len, said.splitlines()), default=0) > LONGEST + 20:
        return "a long line", code
    return "", code


def line_of(rng, folder, content):
    """A command with a hostile name, and what is there of that name."""
    name = rng.choice(NAMES)
    ending = rng.choice([".json", ".csv", ".binary", ".toml", ".npz", ".bsdf", ""])
    path = Path(name if name.startswith("/dev") else folder / f"{name}{ending}")
    try:
        kind = rng.randrange(5)
        if kind == 0:
            path.mkdir()
        elif kind == 1:
            os.mkfifo(path)
        elif kind == 2 and not path.exists():
            path.symlink_to("/dev/zero")
        elif not name.startswith("/dev"):
            path.write_bytes(result(rng, content) if ending == ".json" else damaged(rng, TABLE.encode()))
    except (OSError, ValueError):  # there is no such name
        pass
    out = folder / rng.choice(["out", "plain.json", "x" * 300])
    own = folder / "whole.json"
    return rng.choice([
        ["check", path], ["table", folder], ["table", folder, "-o", path], ["table", path],
        ["report", folder, "-j", 1, "--files", path], ["report", path, "-o", out], ["report", folder, "-o", path],
        ["inspect", path, "--pictures", "none"], ["metrics", path, "--against", own],
        ["metrics", own, "--against", path],
        ["sample", path], ["synth", path, "-o", out], ["synth", name, "--source", name, "-o", out],
        ["export", path, "--to", "json", "-o", out], ["export", own, "--to", "json", "-o", path], ["effects", path],
        ["render", path, "-o", out], ["fit", path, "--config", path], ["fit", path, "--model", name],
        ["fit", path, "--executor", name], ["compare", path, "--models", name], [name, path],
    ])  # fmt: skip


def command_lines(tried, count):
    """``count`` of them; one row."""
    came, wrong, before = Counter(), 0, os.getcwd()
    for n in range(count):
        rng = random.Random(f"command {n}")
        with tempfile.TemporaryDirectory() as place:
            folder = Path(place)
            whole = made()
            whole.source.format = "table"  # whose page has no pictures
            write_result(folder / "whole.json", whole)
            words = line_of(rng, folder, (folder / "whole.json").read_bytes())
            os.chdir(folder)
            try:
                error, code = refused(words)
            finally:
                os.chdir(before)
        came[f"exit code {code}"] += 1
        if error:
            wrong += 1
            print(f"command {n}: {[str(word)[-60:] for word in words]}: {error[:300]!r}", flush=True)
    said = ", ".join(f"{times:,} {what}" for what, times in sorted(came.items()))
    tried.add("commands", "command lines with hostile names, files and folders", count, said, wrong)


def run(tried, few=False):
    """All of them."""
    share = 20 if few else 1
    command_lines(tried, 500 // share)
    tracemalloc.start()
    for what, make, read, refusal, suffix in (
        ("scenes", scene, description.load, description.SceneError, ".toml"),
        ("draws", draws, read_draws, NoPicture, ".npz"),
        ("manifests", manifest, read_manifest, (), ".jsonl"),
        ("maps of light", picture, read_map, description.SceneError, ".npy"),
    ):
        trial(tried, what, make, read, refusal, lambda *_: "", 500 // share, suffix, "commands")
    tracemalloc.stop()
