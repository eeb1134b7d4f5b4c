"""Batches of files and the folder that they are written to; fits are stood in for, none is compiled."""

import errno
import json
from pathlib import Path

import numpy as np
import pytest
import typer
from merlfit.fitting.batch import here, unit
from merlfit.fitting.commands import compare as comparisons
from merlfit.fitting.commands import fit as files
from merlfit.fitting.pipeline import place as keeping
from merlfit.fitting.pipeline.draws import chain_of
from merlfit.fitting.pipeline.place import Completeness, completeness, place_of
from merlfit.fitting.pipeline.run import fit_file
from merlfit.fitting.results import manifest
from merlfit.fitting.results.storage import read_result, write_result
from merlfit.fitting.settings.config import Config
from merlfit.fitting.support.terminal import BAD_INPUT, FAILED_FIT, Stopped
from merlfit.merl_io.atomic import WriteError, unfinished, write_atomically
from merlfit.merl_io.binary import DIMS, MerlError, write
from merlfit.model.measured import Measured
from merlfit.model.rivals.ggx import GGX
from merlfit.model.two_scale import TwoScale

from tests.support.command import call
from tests.support.made_results import made, put_result


def results_in(folder):
    """Names in there, but for what a run says of itself."""
    return sorted(p.name for p in folder.iterdir() if p.name not in (manifest.NAME, "logs"))


@pytest.fixture
def stand_in(monkeypatch):
    """Let a function take the place of the fit: it is given the file and the folder to write to."""

    def put(fit):
        monkeypatch.setattr(unit, "fit_file", lambda path, out, *_: fit(path, out))
        monkeypatch.setattr(here, "use_persistent_cache", lambda: None)
        monkeypatch.setattr(files, "executor_of", lambda units, jobs, where: (here.Here(), 1))

    return put


@pytest.mark.parametrize(
    ("kind", "expected"),
    [
        ({"succeeded": False}, Completeness.NOTHING),
        ({}, Completeness.FIT),
        ({"chain": "some"}, Completeness.CHAIN),
        ({"posterior": False, "chain": "some"}, Completeness.POSTERIOR),
        ({"posterior": True, "chain": "some"}, Completeness.INTERVALS),
    ],
)
def test_how_complete_a_result_is(kind, expected, tmp_path):
    put_result(tmp_path, **kind)
    assert completeness(tmp_path / "nickel.json") == expected


@pytest.mark.parametrize("text", [None, "", "[1]", '{"posterior": 3}'])
def test_what_is_no_result_holds_nothing(text, tmp_path):
    if text is not None:
        (tmp_path / "nickel.json").write_text(text)
    assert completeness(tmp_path / "nickel.json") == Completeness.NOTHING


def test_fitting_again_without_a_posterior_keeps_the_finished_one(tmp_path, stand_in):
    out = tmp_path / "fits"
    before = put_result(out, posterior=True, chain="the old chain")
    stand_in(lambda path, folder: put_result(folder))
    shown = call("fit", "nickel.binary", "-o", out, "--no-posterior")
    assert shown.exit_code == 0
    assert read_result(out / "nickel.json") == before
    assert chain_of(out / "nickel.json").read_text() == "the old chain"
    assert read_result(out / "nickel.2" / "nickel.json").posterior is None
    said = " ".join(shown.stderr.split())
    assert "nickel.json stays as it was, with a fit and a posterior with intervals" in said
    assert "nickel.2/nickel.json is the new one, a fit without a posterior" in said


def test_stopping_a_second_sampling_keeps_the_finished_one(tmp_path, stand_in):
    out = tmp_path / "fits"
    before = put_result(out, posterior=True, chain="the old chain")

    def stopped(path, folder):
        put_result(folder, chain="a short chain")
        raise Stopped

    stand_in(stopped)
    shown = call("fit", "nickel.binary", "other.binary", "-o", out)
    assert shown.exit_code == 130
    assert read_result(out / "nickel.json") == before
    assert chain_of(out / "nickel.json").read_text() == "the old chain"
    assert chain_of(out / "nickel.2" / "nickel.json").read_text() == "a short chain"
    assert len(shown.stderr.strip().splitlines()) == 1


@pytest.mark.parametrize(("old", "new"), [(True, True), (False, True), (None, None), (None, False)])
def test_a_result_at_least_as_complete_takes_the_place_of_the_old_one(old, new, tmp_path, stand_in):
    out = tmp_path / "fits"
    put_result(out, posterior=old, chain=None if old is None else "the old chain")
    stand_in(lambda path, folder: put_result(folder, posterior=new, chain=None if new is None else "the new chain"))
    assert call("fit", "nickel.binary", "-o", out).exit_code == 0
    assert read_result(out / "nickel.json").posterior == made(posterior=new).posterior
    assert results_in(out) == ["nickel.chain.npz", "nickel.json"][new is None :]
    assert new is None or chain_of(out / "nickel.json").read_text() == "the new chain"


def test_the_chain_of_a_replaced_result_does_not_stay_beside_another(tmp_path):
    put_result(tmp_path, posterior=False, chain="the old chain")
    with place_of(tmp_path, "nickel") as place:
        put_result(place.folder, posterior=True)
    assert results_in(tmp_path) == ["nickel.json"]


def test_of_two_unfinished_chains_both_stay(tmp_path):
    put_result(tmp_path, chain="long")
    for folder in ("nickel.2", "nickel.3"):
        with place_of(tmp_path, "nickel") as place:
            put_result(place.folder, chain=f"short, of {folder}")
        assert place.path == tmp_path / folder / "nickel.json"
    assert chain_of(tmp_path / "nickel.json").read_text() == "long"


def test_a_failed_fit_does_not_take_the_place_of_one_that_succeeded(tmp_path):
    before = put_result(tmp_path)
    with place_of(tmp_path, "nickel") as place:
        put_result(place.folder, succeeded=False)
    assert read_result(tmp_path / "nickel.json") == before
    assert "no fit that succeeded" in place.said


def test_bad_input_is_said_once_and_a_folder_with_the_command_that_fits_it(tmp_path):
    folder = tmp_path / "my files"
    folder.mkdir()
    assert "is a directory" in call("fit", folder, "-o", tmp_path / "fits").stderr
    (folder / "a.binary").touch()
    shown = call("fit", folder, "-o", tmp_path / "fits")
    assert shown.exit_code == BAD_INPUT
    assert f"my files: is a folder; name its files: merlfit fit '{folder}'/*.binary" in " ".join(shown.stderr.split())
    assert "bad input" in shown.stdout
    assert "is a folder" not in shown.stdout


def test_nothing_is_left_of_a_fit_that_wrote_nothing(tmp_path, stand_in):
    out = tmp_path / "fits"
    before = put_result(out)

    def fails(path, folder):
        raise MerlError(f"{path}: no such file")

    stand_in(fails)
    assert call("fit", "nickel.binary", "-o", out).exit_code == BAD_INPUT
    assert results_in(out) == ["nickel.json"]
    assert read_result(out / "nickel.json") == before


def test_a_result_that_cannot_be_written_is_not_the_inputs_fault(tmp_path, stand_in):
    def fails(path, folder):
        raise WriteError(f"{folder / 'nickel.json'}: cannot be written (No space left on device)")

    stand_in(fails)
    shown = call("fit", "data/nickel.binary", "-o", tmp_path)
    assert shown.exit_code == FAILED_FIT
    assert f"merlfit: {tmp_path}/nickel.json: cannot be written (No space left on device)" in shown.stderr
    assert "unexpectedly" not in shown.stderr
    assert "data/nickel" not in shown.stderr


def test_a_file_that_may_not_be_read_does_not_stop_the_batch(tmp_path, stand_in, monkeypatch):
    """Typer asks os.access and would refuse the whole command."""
    paths = [tmp_path / f"{name}.binary" for name in ("a", "b")]
    for path in paths:
        path.write_bytes(b"")
    monkeypatch.setattr("os.access", lambda path, mode: str(path) != str(paths[0]))

    def fit(path, folder):
        if path == paths[0]:
            raise MerlError(f"{path}: no permission to read it")
        return put_result(folder, name=path.stem)

    stand_in(fit)
    shown = call("fit", *paths, "-o", tmp_path / "fits")
    assert shown.exit_code == BAD_INPUT
    assert "a.binary: no permission" in shown.stderr
    assert (tmp_path / "fits" / "b.json").is_file()


def test_a_measurement_is_not_overwritten_by_synthesis(tmp_path):
    target = tmp_path / "mine.binary"
    target.write_bytes(b"measured")
    refused = call("synth", "nickel", "-o", target)
    assert refused.exit_code == BAD_INPUT
    assert "mine.binary: is there already" in refused.stderr
    assert "--force" in refused.stderr
    assert target.read_bytes() == b"measured"


def test_the_file_of_a_fit_says_what_it_lacks_and_has_it_if_asked(tmp_path, monkeypatch):
    monkeypatch.setattr("merlfit.fitting.pipeline.synthesis.tabulate", lambda evaluate: evaluate(None))
    seen = []
    monkeypatch.setattr("merlfit.fitting.pipeline.synthesis.evaluate", lambda *words: seen.append(words[0]) or 0.0)
    monkeypatch.setattr("merlfit.fitting.pipeline.synthesis.write", lambda out, values: None)
    monkeypatch.setattr("merlfit.fitting.pipeline.synthesis.use_persistent_cache", lambda: None)
    put_result(tmp_path)
    alone = call("synth", tmp_path / "nickel.json", "-o", tmp_path / "x.binary")
    assert "near grazing angles many times brighter" in " ".join(alone.stdout.split())
    assert "--with-grazing-loss" in alone.stdout
    lossy = call("synth", tmp_path / "nickel.json", "-o", tmp_path / "x.binary", "--with-grazing-loss")
    assert "with the grazing loss of MERL's apparatus" in " ".join(lossy.stdout.split())
    assert seen == [TwoScale("none"), Measured(TwoScale("none"))]
    refused = call("synth", "nickel", "-o", tmp_path / "x.binary", "--with-grazing-loss")
    assert refused.exit_code == BAD_INPUT


def test_a_second_run_into_a_folder_is_refused(tmp_path, stand_in):
    stand_in(lambda path, folder: put_result(folder, name=path.stem))
    with keeping.claimed(tmp_path):
        shown = call("fit", "nickel.binary", "-o", tmp_path)
    assert shown.exit_code == BAD_INPUT
    assert shown.stderr == (
        f"merlfit: {tmp_path}: another merlfit is writing there; wait for it, or name another folder\n"
    )
    assert not (tmp_path / "nickel.json").exists()
    assert call("fit", "nickel.binary", "-o", tmp_path).exit_code == 0


def test_python_may_write_to_a_folder_from_several_places_but_not_beside_a_command(tmp_path):
    half = unfinished(tmp_path)
    half.touch()
    with keeping.claimed(tmp_path, alone=False), keeping.claimed(tmp_path, alone=False):
        assert half.exists()
        with pytest.raises(WriteError, match="another merlfit is writing"), keeping.claimed(tmp_path):
            pass
    with keeping.claimed(tmp_path):
        assert not half.exists()


def test_what_another_command_is_writing_is_not_cleared_away(tmp_path):
    """A picture, a table: such a command does not claim the folder."""

    def write(file):
        file.write(b"whole")
        with keeping.claimed(tmp_path):
            pass

    write_atomically(tmp_path / "picture.png", write)
    assert (tmp_path / "picture.png").read_bytes() == b"whole"
    assert results_in(tmp_path) == ["picture.png"]


def test_what_the_system_says_against_a_place_is_one_line(tmp_path, monkeypatch):
    put_result(tmp_path)

    def refuse(*_, **__):
        raise OSError(errno.ENOSPC, "No space left on device")

    said = f"{tmp_path / 'nickel.json'}: cannot be written (No space left on device)"

    def put():
        with place_of(tmp_path, "nickel") as place:
            put_result(place.folder)
            monkeypatch.setattr("os.replace", refuse)

    with pytest.raises(WriteError) as error:
        put()
    assert str(error.value) == said
    monkeypatch.setattr(Path, "mkdir", refuse)
    with pytest.raises(WriteError) as error:
        put()
    assert str(error.value) == said


def test_a_comparison_claims_the_folder_of_each_model(tmp_path, monkeypatch):
    monkeypatch.setattr(comparisons, "compare_file", lambda *_: pytest.fail("it should wait"))
    (tmp_path / "ggx").mkdir()
    words = ("nickel.binary", "--models", "smooth,ggx", "-o", tmp_path)
    with keeping.claimed(tmp_path / "ggx"):
        for command in ("compare", "which"):
            shown = call(command, *words)
            assert shown.exit_code == BAD_INPUT
            assert "ggx: another merlfit is writing there" in " ".join(shown.stderr.split())


def test_a_manifest_that_cannot_be_written_any_more_stops_what_goes_on(tmp_path, monkeypatch):
    stopped = []

    class Full(here.Here):
        def ended(self, units, tell):
            (tmp_path / "manifest.jsonl").unlink()
            (tmp_path / "manifest.jsonl").mkdir()
            yield 0, unit.Ended(manifest.Ending.FAILED, error="nothing")

        def stop(self):
            stopped.append(True)
            return []

    monkeypatch.setattr(files, "executor_of", lambda units, jobs, where: (Full(), 1))
    shown = call("fit", "nickel.binary", "copper.binary", "-o", tmp_path)
    assert shown.exit_code == BAD_INPUT
    assert "manifest.jsonl: cannot be written" in shown.stderr
    assert stopped == [True]


def test_a_folder_that_cannot_be_locked_is_told_and_nothing_is_cleared_away(tmp_path, monkeypatch, capsys):
    def refuse(*_):
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr("fcntl.flock", refuse)
    half = unfinished(tmp_path)
    half.touch()
    with keeping.claimed(tmp_path):
        assert half.exists(), "it may be of another run"
    assert f"{tmp_path}: cannot be locked (No locks available): take care" in capsys.readouterr().err


def test_what_is_not_of_a_run_is_not_cleared_away(tmp_path):
    (tmp_path / ".merlfit-settings.toml").touch()
    (tmp_path / ".merlfit-cost").mkdir()
    (tmp_path / ".merlfit-cost" / "rows.json").touch()
    with keeping.claimed(tmp_path):
        pass
    assert results_in(tmp_path) == [".merlfit-cost", ".merlfit-settings.toml"]
    assert (tmp_path / ".merlfit-cost" / "rows.json").exists()


@pytest.mark.parametrize(
    ("old", "new", "at"), [(False, True, "."), (None, True, "."), ("none", False, "."), (True, False, "nickel.2")]
)
def test_a_result_that_a_killed_run_left_unmoved_is_adopted(old, new, at, tmp_path, capsys):
    if old != "none":
        put_result(tmp_path, posterior=old, chain="the old chain")
    left = unfinished(tmp_path)
    put_result(left, posterior=new, chain="the new chain")
    with keeping.claimed(tmp_path):
        pass
    assert not left.exists()
    assert read_result(tmp_path / at / "nickel.json").posterior == made(posterior=new).posterior
    assert chain_of(tmp_path / at / "nickel.json").read_text() == "the new chain"
    assert str(tmp_path / at / "nickel.json") in capsys.readouterr().err


def test_a_result_of_another_file_of_that_name_is_kept(tmp_path, stand_in):
    """Case 18: a/paint.csv and b/paint.csv, one after the other into one folder."""
    out = tmp_path / "fits"
    stand_in(lambda path, folder: put_result(folder, name="paint", sha1=path.parent.name * 40))
    for folder in "ab":
        shown = call("fit", f"{folder}/paint.binary", "-o", out)
        assert shown.exit_code == 0
    assert read_result(out / "paint.json").source.sha1 == "a" * 40
    assert read_result(out / "paint.2" / "paint.json").source.sha1 == "b" * 40
    said = " ".join(shown.stderr.split())
    assert "paint.json stays as it was, with a fit without a posterior of another file (SHA-1 aaaaaaaa)" in said
    assert "is the new one, a fit without a posterior of the file with SHA-1 bbbbbbbb" in said
    before = (out / "paint.2" / "paint.json").stat().st_ino
    assert call("fit", "b/paint.binary", "-o", out).exit_code == 0
    assert results_in(out) == ["paint.2", "paint.json"], "fitted again, it has its place"
    assert (out / "paint.2" / "paint.json").stat().st_ino != before


def test_log_and_manifest_follow_no_links_out_of_the_folder(tmp_path, stand_in):
    stand_in(lambda path, folder: put_result(folder, name=path.stem))
    (tmp_path / "theirs").mkdir()
    (tmp_path / "theirs" / "diary").write_text("theirs")
    for name, target in (("logs", "../theirs"), ("manifest.jsonl", "../theirs/diary")):
        out = tmp_path / name
        out.mkdir()
        (out / name).symlink_to(target)
        shown = call("fit", "nickel.binary", "-o", out)
        assert shown.exit_code == (0 if name == "logs" else BAD_INPUT)
        assert ("it is a symbolic link" in shown.stderr) == (name != "logs")
    assert [path.name for path in (tmp_path / "theirs").iterdir()] == ["diary"]
    assert (tmp_path / "theirs" / "diary").read_text() == "theirs"


def test_names_of_files_and_folders_may_be_text_in_python(tmp_path):
    write(tmp_path / "dark.binary", np.zeros((3, *DIMS)))
    found = fit_file(str(tmp_path / "dark.binary"), str(tmp_path / "fits"), Config())
    assert read_result(tmp_path / "fits" / "dark.json") == found
    assert found.fit.status == "NO_DATA"


def test_a_fit_of_another_model_does_not_take_the_place_of_one(tmp_path, stand_in):
    out = tmp_path / "fits"
    put_result(out, chain=None)
    before = (out / "nickel.json").read_bytes()
    stand_in(lambda path, folder: put_result(folder, chain=None, model=Measured(GGX())))
    shown = call("fit", "nickel.binary", "-o", out)
    assert shown.exit_code == 0
    assert "stays as it was, with a fit without a posterior of the two-scale model" in shown.stderr
    assert (out / "nickel.json").read_bytes() == before
    assert read_result(out / "nickel.2" / "nickel.json").model.name == "ggx"


@pytest.mark.parametrize("before", ['{"schema_version": "9.0", "source": {}}', "a failed fit"])
def test_what_stood_there_before_is_no_result_of_a_fit_that_is_stopped(before, tmp_path, monkeypatch):
    def stop(*_):
        raise Stopped()

    put_result(tmp_path, succeeded=False)
    if before[0] == "{":
        (tmp_path / "nickel.json").write_text(before)
    monkeypatch.setattr(unit, "fit_file", stop)
    ended = unit.fit_unit(unit.Unit(Path("nickel.binary"), tmp_path, Config()))
    assert ended.kind is manifest.Ending.STOPPED
    assert ended.result is None


def test_what_was_written_before_a_stop_is_the_result(tmp_path, monkeypatch):
    def stop(path, folder, *_):
        put_result(folder)
        raise Stopped()

    put_result(tmp_path, succeeded=False)
    monkeypatch.setattr(unit, "fit_file", stop)
    ended = unit.fit_unit(unit.Unit(Path("nickel.binary"), tmp_path, Config()))
    assert ended.result == made()


def test_a_unit_that_ends_while_a_run_is_stopped_is_booked(tmp_path, monkeypatch, capsys):
    class Two:
        name = "two"

        def ended(self, units, tell):
            yield 0, unit.Ended(manifest.Ending.STOPPED, code=130)

        def stop(self):
            write_result(tmp_path / "b.json", made("b"))
            return [(1, unit.Ended(manifest.Ending.FITTED, made("b")))]

    monkeypatch.setattr(files, "executor_of", lambda *_: (Two(), 2))
    with pytest.raises(typer.Exit):
        files.fit_files([tmp_path / "a.binary", tmp_path / "b.binary"], tmp_path, Config())
    lines = [json.loads(line) for line in (tmp_path / manifest.NAME).read_text().splitlines()]
    assert [line["file"] for line in lines if line["event"] == "file"] == [str(tmp_path / "b.binary")]
    assert "b.json holds" not in capsys.readouterr().err


def test_of_two_writers_of_one_name_that_begin_together_both_keep_their_results(tmp_path):
    """From Python, where several may write into a folder at once: each sees an empty place when it begins."""
    with keeping.place_of(tmp_path, "nickel", alone=False) as one, keeping.place_of(tmp_path, "nickel", False) as other:
        for place, sha1 in ((one, "1" * 40), (other, "2" * 40)):
            result = made()
            write_result(
                place.folder / "nickel.json",
                result.model_copy(update={"source": result.source.model_copy(update={"sha1": sha1})}),
            )
    kept = [read_result(place.path).source.sha1[0] for place in (one, other)]
    assert kept == ["1", "2"]
    assert one.path != other.path
    assert "stays as it was" in one.said + other.said
    assert [path.name for path in tmp_path.glob(".merlfit-*")] == []
