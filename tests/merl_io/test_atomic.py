"""Files that are whole, names of those that are not, and lines that are added."""

import os
import stat
import subprocess
import sys

import pytest
from merlfit.merl_io.atomic import UNFINISHED, WriteError, append, is_unfinished, unfinished, write_text


def test_a_name_for_what_is_not_whole_is_known_again_and_no_other_is(tmp_path):
    assert is_unfinished(unfinished(tmp_path))
    assert is_unfinished(unfinished(tmp_path).with_suffix(".binary"))
    swapped = UNFINISHED + "-".join(unfinished(tmp_path).name.removeprefix(UNFINISHED).split("-")[::-1])
    for name in (".merlfit-settings.toml", ".merlfit-cost", ".merlfit-half", ".merlfit-", ".merlfit-a1b2c3d4", swapped):
        assert not is_unfinished(tmp_path / name)


def test_files_have_the_permissions_of_the_umask_which_stays_as_it_is(tmp_path):
    """os.umask(0), even for a moment, would let other threads make files that everybody may write."""
    program = (
        "import os, sys, pathlib; os.umask(0o027); ours = os.umask; seen = []\n"
        "os.umask = lambda mask: seen.append(mask) or ours(mask)\n"
        "from merlfit.merl_io.atomic import write_text; write_text(pathlib.Path(sys.argv[1]), 'x'); assert not seen"
    )
    subprocess.run([sys.executable, "-c", program, str(tmp_path / "a")], check=True)
    assert stat.S_IMODE((tmp_path / "a").stat().st_mode) == 0o640
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


def test_a_file_in_the_place_of_a_link_leaves_what_that_leads_to(tmp_path):
    (tmp_path / "theirs").write_text("theirs")
    (tmp_path / "out").symlink_to("theirs")
    write_text(tmp_path / "out", "ours")
    assert (tmp_path / "theirs").read_text() == "theirs"


def test_lines_are_added_to_no_link_and_no_pipe(tmp_path):
    append(tmp_path / "log", b"one\n")
    append(tmp_path / "log", b"two\n")
    assert (tmp_path / "log").read_bytes() == b"one\ntwo\n"
    (tmp_path / "link").symlink_to("log")
    with pytest.raises(WriteError, match="link: cannot be written \\(it is a symbolic link\\)"):
        append(tmp_path / "link", b"three\n")
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(WriteError, match="pipe: cannot be written"):
        append(tmp_path / "pipe", b"three\n")
    assert (tmp_path / "log").read_bytes() == b"one\ntwo\n"
