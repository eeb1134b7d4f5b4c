"""Files that change, or hold what no measurement holds, while or before they are read."""

import io
import os
import warnings
from pathlib import Path

import numpy as np
import pytest
from merlfit.merl_io import source
from merlfit.merl_io.binary import DIMS, HEADER, MerlError, plane_bytes, read, write


@pytest.fixture
def path(tmp_path):
    target = tmp_path / "material.binary"
    write(target, np.ones((3, *DIMS)))
    return target


def test_a_file_cut_short_while_it_is_read_is_an_error_and_no_crash(path, monkeypatch):
    """Mapped into memory, the second plane would have been a SIGBUS, which ends a whole batch."""

    class Cut(io.BufferedReader):
        def read(self, size=-1):
            found = super().read(size)
            if size == plane_bytes(DIMS):
                os.truncate(path, HEADER.size + size)
            return found

    monkeypatch.setattr(source, "open", lambda name, mode: Cut(io.FileIO(name)), raising=False)
    with pytest.raises(MerlError, match=r"material\.binary: became shorter while it was read"):
        read(path)


def test_signalling_nans_are_counted_without_a_warning(path):
    stored = np.memmap(path, "<u8", "r+", HEADER.size, (3, *DIMS))
    stored[1, 2, 3, 4] = 0x7FF0000000000001
    stored.flush()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert read(path).nan == 1


def test_a_file_without_a_valid_bin_says_which_channels_are_bad(path):
    stored = np.memmap(path, "<f8", "r+", HEADER.size, (3, *DIMS))
    stored[0] = -1
    stored[2, :9] = np.nan
    stored.flush()
    with pytest.raises(MerlError, match=r"no valid bin.*\(red 100%, green 0%, blue 10% of the bins\)"):
        read(path)


def test_a_name_with_nul_is_one_line():
    with pytest.raises(MerlError, match="is not the name of a file"):
        read("some\0file")


def test_what_cannot_be_written_is_named(tmp_path):
    target = tmp_path / "missing" / "x.binary"
    with pytest.raises(MerlError, match=r"x\.binary: cannot be written"):
        write(target, np.ones((3, *DIMS)))


def test_a_name_as_long_as_a_name_may_be_can_be_written(tmp_path):
    target = Path(tmp_path / ("x" * 248 + ".binary"))
    write(target, np.ones((3, *DIMS)))
    assert read(target).valid.all()
