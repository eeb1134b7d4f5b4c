"""The table of the scaled lobe on disk."""

import re
from concurrent.futures import ThreadPoolExecutor
from inspect import getsource as source
from pathlib import Path

import jax
import numpy as np
import pytest
from merlfit.fitting.support import tables
from merlfit.model import scaled

from tests.support.arrays import j
from tests.support.lobes import INSIDE


@pytest.fixture
def small(monkeypatch, tmp_path):
    """A table of few nodes, in a folder of its own."""
    before = scaled._keep
    monkeypatch.setattr(scaled, "NODES", (4, 3, 3, 3))
    tables.keep_in(tmp_path / "tables")
    yield tmp_path / "tables"
    scaled.keep_by(before)


def test_table_is_kept_and_read_again(small, monkeypatch):
    made = scaled.table()
    (path,) = small.iterdir()
    assert path.suffix == ".npz"
    assert made.shape == (2, 4, 3, 3, 3)
    tables.keep_in(small)  # forgets what is in memory
    monkeypatch.setattr(scaled, "_build", lambda: pytest.fail("made again"))
    np.testing.assert_array_equal(scaled.table(), made)


def broken(path, how):
    data = path.read_bytes()
    if how == "cut short":
        path.write_bytes(data[: len(data) // 2])
    elif how == "no archive":
        path.write_bytes(b"nothing of the kind")
    elif how == "one bit":
        middle = len(data) // 2
        path.write_bytes(data[:middle] + bytes([data[middle] ^ 1]) + data[middle + 1 :])
    elif how == "other shape":
        np.savez(path, table=np.zeros((2, 3, 3, 3, 3)))
    elif how == "not finite":
        np.savez(path, table=np.full((2, 4, 3, 3, 3), np.nan))
    else:
        np.savez(path, other=np.zeros(3))


@pytest.mark.parametrize("how", ["cut short", "no archive", "one bit", "other shape", "not finite", "other name"])
def test_broken_file_is_made_anew(small, how):
    made = scaled.table()
    (path,) = small.iterdir()
    broken(path, how)
    tables.keep_in(small)
    np.testing.assert_array_equal(scaled.table(), made)
    assert [x.name for x in small.iterdir()] == [path.name]
    with np.load(path) as file:
        np.testing.assert_array_equal(file["table"], made)


def test_file_of_other_code_is_not_read(small, monkeypatch):
    name, read = tables.file_name(), Path.read_bytes
    imported = {name for maker in tables.MAKERS for name in re.findall(r"^from \.(\w+) import", source(maker), re.M)}
    makers = {maker.__name__.rpartition(".")[2] for maker in tables.MAKERS}
    assert imported <= makers
    for changed in makers:
        with monkeypatch.context() as patch:
            patch.setattr(Path, "read_bytes", lambda path: read(path) + b"#" * (path.stem == changed))
            assert tables.file_name() != name


def test_a_folder_that_cannot_be_written_is_told_and_the_table_used(tmp_path, small):
    (tmp_path / "file").write_text("in the way")
    tables.keep_in(tmp_path / "file" / "tables")
    with pytest.warns(UserWarning, match="cannot be kept"):
        assert scaled.table().shape == (2, 4, 3, 3, 3)


def test_two_threads_make_one_table(small, monkeypatch):
    build, made = scaled._build, []
    monkeypatch.setattr(scaled, "_build", lambda: made.append(1) or build())
    with ThreadPoolExecutor(2) as pool:
        first, second = pool.map(lambda _: scaled.table(), range(2))
    assert first is second
    assert len(made) == 1


def test_table_can_be_made_while_a_program_is_traced(small):
    values = j(0.3, *INSIDE.values())
    traced = jax.jit(scaled.convolve)(*values)
    assert isinstance(scaled.table(), np.ndarray)
    np.testing.assert_allclose(traced, scaled.convolve(*values), rtol=1e-12)
