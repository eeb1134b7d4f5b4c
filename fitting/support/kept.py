"""Functions that are compiled, whose programs are kept between processes before they are compiled, too.

JAX keeps what XLA has compiled (`compilation.use_persistent_cache`), but traces every function anew in each process to
find it: 15 s of the 20 that a first fit took. Here the traced program is kept as well, as StableHLO (`jax.export`), by
what it depends on: our source, the function, its static arguments, and the shapes of the others. A damaged file, or one
that another version has written, is made anew.
"""

import hashlib
import json
import os
import shutil
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import fields, is_dataclass
from functools import cache, partial, update_wrapper
from pathlib import Path
from threading import Lock
from time import perf_counter
from types import FunctionType
from typing import Any

import jax
import numpy as np
from jax import export
from jax.core import Tracer

from ...merl_io.atomic import WriteError, write_bytes, write_text
from .compilation import cache_folder, forgetting, use_cache
from .threads import CORES

PACKAGE = __name__.split(".")[0]
PARTS = "fitting", "merl_io", "model", "scene"  # of our source, on which programs may depend
# XLA's older CPU emitters compile these in half the time and run them as fast (CONTRIBUTING.md, compile times).
OLDER_EMITTERS = {"xla_cpu_use_fusion_emitters": False} if jax.__version_info__ < (0, 11) else {}  # JAX 0.11 has none
SOURCES = 3  # versions of our source of which programs are kept
LEAST = 0.1  # seconds of tracing that are worth a file


class Unnamed(Exception):
    """An argument of which no text says all."""


class Kept:
    """A function as `jax.jit` has it, with its program kept on disk.

    Called while another one is traced it is a part of that. On other devices than CPUs, and with arguments of which no
    text says all, it is what `jax.jit` makes.
    """

    def __init__(self, function: Callable, static: int = 1) -> None:
        self._function, self._static = function, static
        self._jitted = jax.jit(function, static_argnums=tuple(range(static)))  # nested, it takes no options of XLA
        self._programs: dict[Any, Callable] = {}
        self._one: dict[Any, Lock] = {}
        forgetting.append(self._programs.clear)
        update_wrapper(self, function)

    def __call__(self, *arguments: Any) -> Any:  # noqa: ANN401 - as of the function
        """The function's value."""
        static, dynamic = arguments[: self._static], arguments[self._static :]
        leaves, structure = jax.tree.flatten(dynamic)
        if jax.default_backend() != "cpu" or any(isinstance(x, Tracer) for x in leaves):
            return self._jitted(*arguments)
        shapes = tuple(map(_shape, leaves))
        key = static, structure, shapes
        if (program := self._programs.get(key)) is None:
            with self._one.setdefault(key, Lock()):
                if (program := self._programs.get(key)) is None:
                    program = self._programs[key] = self._found(static, structure, shapes, leaves)
        return program(*leaves)

    def _found(self, static: tuple, structure: Any, shapes: tuple, leaves: list) -> Callable:  # noqa: ANN401 - of JAX
        def flat(*leaves: Any) -> Any:  # noqa: ANN401
            return self._function(*static, *jax.tree.unflatten(structure, leaves))

        update_wrapper(flat, self._function)
        plain = jax.jit(flat, compiler_options=OLDER_EMITTERS)
        try:
            said = _said(self._function), _said(static), _without_addresses(str(structure)), repr(shapes)
            name = _digest(*said, str(jax.config.jax_enable_x64))  # pyright: ignore[reportAttributeAccessIssue] - made when it runs
        except Unnamed:
            return plain
        loading = _ahead.loading.get(name)
        with suppress(Exception):  # there is none, or it is damaged in any way
            program = loading.result() if loading is not None else _read(name)
            _ahead.used.append(name)
            return program
        begun = perf_counter()
        try:
            exported = export.export(plain)(*[jax.ShapeDtypeStruct(*shape) for shape in shapes])
            if perf_counter() - begun > LEAST:
                _write(name, bytes(exported.serialize()))
            return _compiled(exported)
        except ValueError:  # it holds or returns what JAX does not export
            return plain


def _compiled(exported: export.Exported) -> Callable:
    def called(*leaves: Any) -> Any:  # noqa: ANN401
        return exported.call(*leaves)

    called.__name__ = exported.fun_name
    shapes = [jax.ShapeDtypeStruct(x.shape, x.dtype) for x in exported.in_avals]
    return jax.jit(called, compiler_options=OLDER_EMITTERS).lower(*shapes).compile()


def _read(name: str) -> Callable:
    """A program, compiled; its file begins with the digest of what follows.

    Raises:
        Exception: of any kind; the file is not there, or damaged.
    """
    held = _path(name).read_bytes()
    digest, program = held[: len(_digest())], held[len(_digest()) :]
    if digest != hashlib.sha1(program).hexdigest().encode():
        raise ValueError(f"{_path(name)} is damaged")
    return _compiled(export.deserialize(bytearray(program)))


def _write(name: str, program: bytes) -> None:
    """Keep a program, if it is that of the source which is there; where it cannot be written it is not kept."""
    with suppress(OSError, WriteError):
        if _source() != SOURCE:  # was changed since it was imported
            return
        _make_folder()
        write_bytes(_path(name), hashlib.sha1(program).hexdigest().encode() + program)
        _ahead.used.append(name)


class _Ahead:
    """Programs that are loaded before they are asked for.

    Attributes:
        occasion: for which; None while there is none. loading: by name, compiled. used: names of what was asked for, in
            this order.
    """

    def __init__(self) -> None:
        self.occasion: str | None = None
        self.loading: dict[str, Future] = {}
        self.used: list[str] = []


_ahead = _Ahead()


@contextmanager
def loaded_ahead(occasion: str, remember: bool = True) -> Iterator[None]:
    """Load what was used on the last such occasion, all cores at work, while it is still being read and prepared.

    Within such an occasion there is no other.

    Args:
        occasion: word for what programs depend on. remember: whether to load the next time what is used now.
    """
    use_cache()
    if _ahead.occasion or jax.default_backend() != "cpu" or _ahead.used:  # a process that has begun has its programs
        yield
        return
    listed, names = _folder() / f"{_digest(occasion)}.json", []
    with suppress(OSError, ValueError, TypeError):
        names = [str(name) for name in json.loads(listed.read_text())]
    pool = ThreadPoolExecutor(CORES, "merlfit-programs")
    _ahead.occasion, _ahead.loading = occasion, {name: pool.submit(_read, name) for name in names}
    try:
        yield
        if remember and _ahead.used and set(_ahead.used) != set(names):
            with suppress(OSError, WriteError):
                write_text(listed, json.dumps(_ahead.used))
    finally:
        pool.shutdown(wait=False, cancel_futures=True)
        _ahead.occasion, _ahead.loading = None, {}


def kept(static: int = 1) -> Callable[[Callable], Kept]:
    """Decorator that makes `Kept` of a function, of whose arguments the first ``static`` are no arrays."""
    return partial(Kept, static=static)


def _shape(x: Any) -> tuple[tuple[int, ...], str]:  # noqa: ANN401 - an array, or a number of Python
    """Shape and type. Not whether it is weak: a number is or is not by which program it came from."""
    return np.shape(x), (x if hasattr(x, "dtype") else jax.typeof(x)).dtype.name


def _path(name: str) -> Path:
    return _folder() / f"{name}.bin"


def _source() -> str:
    """Digest of our source as it is on disk, and of the version of JAX."""
    digest = hashlib.sha1(jax.__version__.encode())
    for path in sorted(path for part in PARTS for path in (Path(__file__).parents[2] / part).rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


SOURCE = _source()  # of what this process has imported, or soon will


@cache
def _folder() -> Path:
    """Where programs of this source are."""
    folder = cache_folder() / "programs" / SOURCE
    with suppress(OSError):
        os.utime(folder)  # in use
    return folder


def _make_folder() -> None:
    """The folder, and no more than `SOURCES` of them, those that were in use last."""
    if not _folder().is_dir():
        _folder().mkdir(parents=True, exist_ok=True)
        for old in sorted(_folder().parent.iterdir(), key=lambda path: path.stat().st_mtime)[:-SOURCES]:
            shutil.rmtree(old, ignore_errors=True)


def _without_addresses(said: str) -> str:
    if " at 0x" in said:  # of something that has no text of its own
        raise Unnamed(said)
    return said


def _digest(*said: str) -> str:
    return hashlib.sha1("\n".join(said).encode()).hexdigest()


def _said(x: Any) -> str:  # noqa: ANN401 - a static argument
    """Everything that a static argument is, as text.

    Raises:
        Unnamed: it is, or holds, what has no name in our source.
    """
    if x is None or isinstance(x, str | bool | int | float):
        return repr(x)
    if isinstance(x, tuple | list):
        return f"{type(x).__name__}({', '.join(map(_said, x))})"
    if isinstance(x, Mapping):
        return f"{{{', '.join(f'{_said(name)}: {_said(value)}' for name, value in x.items())}}}"
    if isinstance(x, slice):
        return repr(x)
    if isinstance(x, np.ndarray):
        return f"{x.dtype}{x.shape}{hashlib.sha1(x.tobytes()).hexdigest()}"
    if isinstance(x, partial):
        return f"partial({_said(x.func)}, {_said(x.args)}, {_said(x.keywords)})"
    kind = x if isinstance(x, FunctionType | type) else type(x)
    name = f"{kind.__module__}.{kind.__qualname__}"
    if kind.__module__.split(".")[0] not in (PACKAGE, "jax") or "<" in name:
        raise Unnamed(name)
    if kind is x:
        return name
    if is_dataclass(x):
        return f"{name}({', '.join(f'{f.name}={_said(getattr(x, f.name))}' for f in fields(x))})"
    raise Unnamed(name)
