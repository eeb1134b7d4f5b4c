"""Files that change while they are read, and names that are no files'."""

import io
import os

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

    monkeypatch.setattr(source, "open", lambda name, mode, **_: Cut(io.FileIO(name)), raising=False)
    with pytest.raises(MerlError, match=r"material\.binary: became shorter while it was read"):
        read(path)


def test_a_file_in_whose_place_there_is_a_pipe_when_it_is_opened_is_not_waited_for(tmp_path, monkeypatch):
    os.mkfifo(tmp_path / "a.binary")
    (tmp_path / "b.binary").touch()
    regular = (tmp_path / "b.binary").stat()
    monkeypatch.setattr(source, "_status", lambda path, refusal: regular)
    with pytest.raises(MerlError, match=r"a\.binary: is not a regular file"):
        read(tmp_path / "a.binary")


def test_a_file_that_is_larger_than_any_is_refused_whatever_reads_it(tmp_path):
    with open(tmp_path / "a.npz", "wb") as file:
        file.truncate(source.LARGEST + 1)
    with (
        pytest.raises(MerlError, match="has 2048 MiB; such a file has 2048 at the most"),
        source.opened(tmp_path / "a.npz"),
    ):
        pass


def test_a_name_with_nul_is_one_line():
    with pytest.raises(MerlError, match="is not the name of a file"):
        read("some\0file")
