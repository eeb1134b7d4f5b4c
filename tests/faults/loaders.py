"""Damaged MERL files, settings, results and chains through the loaders."""

import ast
import io
import json
import os
import random
import struct
import sys
import tempfile
import tracemalloc
import zipfile
from collections import Counter
from contextlib import contextmanager
from pathlib import Path
from unittest import mock

import numpy as np
from merlfit.fitting.posterior.chain import ChainError, read_chain, write_chain
from merlfit.fitting.results.storage import ResultError, read_result, write_result
from merlfit.fitting.settings.config import Config, ConfigError, load
from merlfit.merl_io import binary

from ..support.made_results import made
from .stand_in import CHAIN

ROOT = Path(__file__).parents[2]
SMALL = (3, 4, 6)
FORBIDDEN = ("exec", "compile", "pickle.find_class", "subprocess.Popen", "os.system", "os.exec", "socket.connect")
ALLOWANCE = 2**20  # bytes, beside three times the file
HOSTILE = [0.0, -0.0, -1.0, 1e-320, 1e300, -1e300, np.inf, -np.inf, np.nan]

_watched: list[str] = []
_watching = [False]


def _hook(event, arguments):
    if _watching[0] and event in FORBIDDEN:
        code = arguments[0] if event == "exec" else None
        if Path(getattr(code, "co_filename", "")).is_file():
            return  # a module of Python's, imported when it is first needed
        if event == "compile" and sys._getframe(1).f_code.co_filename == ast.__file__:
            return  # of `ast.literal_eval`: parsed, never run
        _watched.append(event)


sys.addaudithook(_hook)


@contextmanager
def watched():
    """Audit events that should not be, and the largest memory allocated: a list that is filled at the end."""
    found: list = []
    _watched.clear()
    tracemalloc.reset_peak()
    before = tracemalloc.get_traced_memory()[0]
    _watching[0] = True
    try:
        yield found
    finally:
        _watching[0] = False
        found += [list(_watched), tracemalloc.get_traced_memory()[1] - before]


@contextmanager
def layout(dims):
    """MERL's layout with other numbers of bins, fewer than `--dims` takes."""
    with mock.patch.multiple(binary, DIMS=dims):
        yield


def one(path, read, refusal, check):
    """Read a file: what came of it, and what was wrong about that ('' if nothing)."""
    size = path.stat().st_size
    with watched() as seen:
        try:
            value, said = read(path), None
        except refusal as error:
            value, said = None, str(error)
        except Exception as error:  # what this looks for
            value, said = None, error
    events, peak = seen
    if isinstance(said, Exception):
        return "traceback", f"{type(said).__name__}: {said}"
    if events:
        return "executed", str(events)
    if peak > 3 * size + ALLOWANCE:
        return "memory", f"{peak} bytes of {size}"
    if said is None:
        return "accepted", check(value, path) or ""
    if "\n" in said or path.name not in said:
        return "message", said
    return "refused", ""


def trial(tried, what, make, read, refusal, check, count, suffix, section="loaders"):
    """``count`` files by ``make(rng) -> bytes``; one row."""
    came, wrong = Counter(), []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, f"damaged{suffix}")
        for n in range(count):
            content = make(random.Random(f"{what} {n}"))
            path.write_bytes(content)
            kind, error = one(path, read, refusal, check)
            came[kind] += 1
            if error:
                wrong.append(error)
                Path(tempfile.gettempdir(), f"wrong-{len(wrong)}{suffix}").write_bytes(content)
                print(f"{what} {n}: {kind}: {error}", flush=True)
    said = ", ".join(f"{times:,} {kind}" for kind, times in sorted(came.items()))
    tried.add(section, what, count, said, len(wrong))


def damaged(rng, content, most=8):
    """Bytes with some of them flipped, cut, repeated, inserted or moved."""
    data = bytearray(content)
    for _ in range(rng.randint(1, most)):
        at, kind = rng.randrange(len(data) + 1), rng.randrange(6)
        if kind == 0 and at < len(data):
            data[at] ^= 1 << rng.randrange(8)
        elif kind == 1 and at < len(data):
            data[at] = rng.randrange(256)
        elif kind == 2:
            del data[at : at + rng.choice([1, 8, 100, len(data)])]
        elif kind == 3:
            data[at:at] = rng.randbytes(rng.choice([1, 8, 100]))
        elif kind == 4:
            end = at + rng.choice([1, 8, 100])
            data[at:at] = data[at:end]
        elif at + 8 <= len(data):
            data[at : at + 8] = struct.pack("<d", rng.choice(HOSTILE))
        if not data:
            break
    return bytes(data)


def merl(rng, dims):
    """A file of MERL's layout, as random as can be."""
    bins = np.exp(np.random.default_rng(rng.getrandbits(32)).normal(size=3 * int(np.prod(dims))))
    return struct.pack("<3i", *dims) + bins.astype("<f8").tobytes()


def mutant(rng, dims):
    """Of a MERL file: damaged anywhere, in its header, in its values alone, or in its length."""
    content = merl(rng, dims)
    kind = rng.randrange(4)
    if kind == 0:
        return damaged(rng, content)
    if kind == 1:
        sizes = [0, 1, -1, 2**31 - 1, -(2**31), 90, 180, *dims, rng.getrandbits(31)]
        return struct.pack("<3i", *rng.choices(sizes, k=3)) + content[12:]
    if kind == 2:
        values = np.frombuffer(content, "<f8", offset=12).copy()
        at = [rng.randrange(values.size) for _ in range(rng.choice([1, 3, values.size]))]
        values[at] = rng.choices(HOSTILE, k=len(at))
        return content[:12] + values.tobytes()
    return content[: rng.randrange(len(content))] if rng.random() < 0.5 else content + rng.randbytes(rng.randint(1, 99))


def as_documented(measurement, path):
    """What is wrong with a measurement that was read."""
    valid, values = measurement.valid, measurement.values
    raw = np.frombuffer(path.read_bytes(), "<f8", offset=12).reshape(values.shape)
    scaled = raw * np.reshape(binary.SCALES, (-1, 1, 1, 1))
    with np.errstate(invalid="ignore"):
        expected = np.all((raw >= 0) & (scaled < binary.BRIGHTEST), axis=0)
    if not np.array_equal(valid, expected):
        return "other bins are valid"
    if not np.array_equal(values[:, valid], scaled[:, valid]) or not np.isnan(values[:, ~valid]).all():
        return "other values"
    return ""


def settings(rng):
    """The shipped settings, damaged as bytes or by a value of another kind."""
    content = (ROOT / "configs" / "default.toml").read_text()
    if rng.random() < 0.5:
        return damaged(rng, content.encode())
    lines = content.splitlines()
    at = rng.choice([n for n, line in enumerate(lines) if "=" in line])
    key = lines[at].split("=")[0]
    others = ["-1", "0", "1e999", "nan", "9" * 400, '"' + "x" * 9000 + '"', "[" * 500 + "]" * 500, "{}", "true", "''"]
    lines[at] = f"{key} = {rng.choice(others)}"
    return "\n".join(lines).encode()


def _places(value, path=()):
    """Where in a JSON document something can be replaced."""
    yield path
    for key, each in value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ():
        yield from _places(each, (*path, key))


def result(rng, content):
    """A result, damaged as bytes or by a value of another kind somewhere in it."""
    if rng.random() < 0.3:
        return damaged(rng, content)
    document = json.loads(content)
    for _ in range(rng.randint(1, 3)):
        *way, last = rng.choice([p for p in _places(document) if p])
        at = document
        for key in way:
            at = at[key]
        if rng.random() < 0.2:
            del at[last]
        else:
            deep = json.loads("[" * 200 + "]" * 200)
            at[last] = rng.choice(
                [
                    None,
                    True,
                    -1,
                    0,
                    1e308,
                    2**80,
                    "",
                    "x" * 5000,
                    "../../etc/x",
                    "\0",
                    "\ud800",
                    [],
                    {},
                    [1] * 999,
                    deep,
                ]
            )
    return json.dumps(document).encode()


def chain(rng, content):
    """A chain, damaged as bytes, or a whole archive with an array of another kind in it."""
    if rng.random() < 0.5:
        return damaged(rng, content)
    arrays, name = dict(CHAIN), rng.choice(sorted(CHAIN))
    size = max(arrays[name].size, 1)
    shape = arrays[name].shape
    shaped = [np.empty(0), np.full(size, np.nan), np.full(shape, np.inf), np.arange(size + 1), np.ones((2, 2, 2))]
    typed = [np.array("x" * 99), np.zeros(shape, complex), np.array([Executed()], object), HEADER, None]
    other = rng.choice([*shaped, *typed])
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for each, array in (arrays | {name: other}).items():
            if isinstance(array, bytes):
                archive.writestr(f"{each}.npy", array)
            elif array is not None:
                member = io.BytesIO()
                np.lib.format.write_array(member, array)
                archive.writestr(f"{each}.npy", member.getvalue())
    return file.getvalue()


class Executed:
    """What runs when it is unpickled."""

    def __reduce__(self):
        return os.system, ("true",)


def _header(shape):
    """Of an array that says to be larger than its file."""
    file = io.BytesIO()
    np.lib.format.write_array_header_1_0(file, {"descr": "<f8", "fortran_order": False, "shape": shape})
    return file.getvalue()


HEADER = _header((10**6, 8, 3))


def same_chain(value, path):
    """What is wrong with a chain that was read: only arrays that say the same are accepted."""
    found = value.arrays()
    wrong = [name for name, array in CHAIN.items() if not np.array_equal(found[name], array)]
    return f"other arrays: {', '.join(wrong)}" if wrong else ""


def same_again(value, path):
    """An accepted result is written and read again as the same."""
    again = path.with_name("again.json")
    write_result(again, value)
    return "" if read_result(again).model_dump() == value.model_dump() else "it is another when it is read again"


def names(tried):
    """File names that would leave the output directory."""
    from merlfit.fitting.batch.unit import Unit

    hostile = [
        "..",
        "../x",
        "../../etc/passwd",
        "..\n",
        "~",
        "-o",
        "a b",
        "x" * 200,
        "\u202egnp",
        "%2e%2e",
        "C:\\x",
        ".json",
    ]
    wrong = 0
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder, "out").resolve()
        for name in hostile:
            for path in (Path(f"{name}.binary"), Path(name), Path(folder, f"{name}.binary")):
                unit = Unit(path, out, Config())
                inside = all(p.resolve().is_relative_to(out) for p in (unit.target, unit.log))
                wrong += not inside
    tried.add("loaders", "names of files that would lead out of the folder for results", 3 * len(hostile),
              "all results and logs inside", wrong)  # fmt: skip


def run(tried, few=False):
    """All of them."""
    share = 20 if few else 1
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "made.json")
        write_result(path, made())
        content = path.read_bytes()
        read_result(path)
        load(ROOT / "configs" / "default.toml")
        path = Path(folder, "chain.npz")
        write_chain(path, CHAIN)
        read_chain(path, CHAIN["fit_free"])
        chained = path.read_bytes()
    tracemalloc.start()
    with layout(SMALL):
        trial(tried, "MERL files, fewer bins", lambda rng: mutant(rng, SMALL), binary.read, binary.MerlError,
              as_documented, 10_000 // share, ".binary")  # fmt: skip
    trial(tried, "MERL files, full size", lambda rng: mutant(rng, binary.DIMS), binary.read, binary.MerlError,
          as_documented, 40 // share, ".binary")  # fmt: skip
    trial(tried, "settings", settings, load, ConfigError, lambda *_: "", 2_000 // share, ".toml")
    trial(tried, "results", lambda rng: result(rng, content), read_result, ResultError, same_again, 2_000 // share,
          ".json")  # fmt: skip
    trial(tried, "chains", lambda rng: chain(rng, chained), lambda path: read_chain(path, CHAIN["fit_free"]),
          ChainError, same_chain, 2_000 // share, ".npz")  # fmt: skip
    tracemalloc.stop()
    names(tried)
