"""The table of a folder of results, as a spreadsheet reads it."""

import csv
from pathlib import Path

from merlfit.fitting.results.manifest import NAME, Ending, Journal
from merlfit.fitting.results.storage import write_result
from merlfit.fitting.show.results_table import HEADS
from merlfit.fitting.show.simulated import reproducing
from merlfit.fitting.support.terminal import BAD_INPUT
from merlfit.model.rivals.ggx import GGX

from tests.support.command import call
from tests.support.made_results import made

ROOT = Path(__file__).parents[2]


def table_in(path):
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


def ended(folder, path, kind, error=""):
    Journal(folder).ended(path, kind, None, error)


def test_a_row_a_result_with_its_parameters_and_intervals(tmp_path):
    sampled, short, rival = made(posterior=True), made("brass", posterior=False, succeeded=False), made(model=GGX())
    sampled.fit.cautions = ["first, with a comma", "second"]
    (tmp_path / "ggx").mkdir()
    write_result(tmp_path / "nickel.json", sampled)
    write_result(tmp_path / "brass.json", short)
    write_result(tmp_path / "ggx" / "nickel.json", rival)
    (tmp_path / ".merlfit-half").mkdir()
    write_result(tmp_path / ".merlfit-half" / "gold.json", sampled)
    done = call("table", tmp_path)
    assert done.exit_code == 0
    assert done.stdout == f"wrote {tmp_path}/table.csv: 2 CONVERGED, 1 STEP_LIMIT\n"
    rows = table_in(tmp_path / "table.csv")
    assert [(r["material"], r["model"], r["result"]) for r in rows] == [
        ("brass", "two-scale", "brass.json"), ("nickel", "ggx", "ggx/nickel.json"),
        ("nickel", "two-scale", "nickel.json"),
    ]  # fmt: skip
    beta = sampled.parameters[0]
    found = rows[2]
    assert beta.name == "beta"
    assert [float(found[head]) for head in ("beta", "beta_low", "beta_high", "beta_q05", "beta_q50", "beta_q95")] == [
        float(f"{x:.6g}") for x in (
            beta.value, beta.laplace.q05, beta.laplace.q95, beta.quantiles.q05, beta.quantiles.q50, beta.quantiles.q95
        )
    ]  # fmt: skip
    assert (found["cautions"], found["posterior"], found["genuine_merl"]) == ("first, with a comma; second", "ok", "no")
    assert (float(found["rmse"]), float(found["seconds"]), float(found["cost"])) == (0.1, 2.5, 0.02)
    assert rows[0]["beta_q05"] == ""
    assert rows[0]["posterior"] == short.posterior.message
    assert rows[1]["beta"] == ""
    assert float(rows[1]["alpha"]) == rival.parameters[0].value


def test_files_without_a_result_are_there_with_their_error(tmp_path):
    write_result(tmp_path / "nickel.json", made())
    for _ in range(2):
        ended(tmp_path, tmp_path / "brass.binary", Ending.BAD_INPUT, "brass.binary: too short")
    ended(tmp_path, tmp_path / "gold.binary", Ending.LOST, "gold.binary: its process was killed (SIGKILL)")
    ended(tmp_path, tmp_path / "nickel.binary", Ending.FAILED, "nickel.binary: the disk is full")
    ended(tmp_path, tmp_path / "steel.binary", Ending.FAILED, "steel.binary: the disk is full")
    ended(tmp_path, tmp_path / "steel.binary", Ending.FITTED)
    (tmp_path / "alum.json").write_text("{")
    done = call("table", tmp_path, "-o", tmp_path / "all.csv")
    rows = {r["material"]: r for r in table_in(tmp_path / "all.csv")}
    assert {name: r["status"] for name, r in rows.items()} == {
        "alum": "unreadable", "brass": "bad input", "gold": "lost", "nickel": "CONVERGED",
    }  # fmt: skip
    assert rows["gold"]["error"] == "gold.binary: its process was killed (SIGKILL)"
    assert rows["nickel"]["error"] == "nickel.binary: the disk is full"
    assert rows["brass"]["beta"] == rows["brass"]["rmse"] == ""
    assert "merlfit: brass.binary: too short\n" in done.stderr
    assert not (tmp_path / "table.csv").exists()


def test_no_cell_is_a_formula(tmp_path):
    result = made("=cmd()", path="@SUM(A1)")
    write_result(tmp_path / "odd.json", result)
    call("table", tmp_path)
    row = table_in(tmp_path / "table.csv")[0]
    assert (row["material"], row["file"]) == ("'=cmd()", "'@SUM(A1)")


def test_where_there_is_nothing_that_is_said(tmp_path):
    done = call("table", tmp_path)
    assert (done.exit_code, done.stdout) == (BAD_INPUT, "")
    assert done.stderr.startswith(f"merlfit: {tmp_path}: no results in there")
    assert call("table", tmp_path / "gone").stderr == f"merlfit: {tmp_path}/gone: no such folder\n"
    write_result(tmp_path / "nickel.json", made())
    assert "cannot be written" in call("table", tmp_path, "-o", tmp_path / "none" / "a.csv").stderr


def test_all_columns_are_documented():
    text = (ROOT / "docs" / "result.md").read_text()
    assert [head for head in HEADS if f"`{head}`" not in text] == []
    assert NAME in text


def test_the_command_of_one_file_leaves_out_the_others_of_its_batch():
    result = made(path="b.csv")
    command = ["merlfit", "fit", "a.csv", "b.csv", "c.NPZ", "d.binary", "-o", "out.csv"]
    result.run = result.run.model_copy(update={"command": command})
    assert reproducing(result) == ["merlfit", "fit", "b.csv", "-o", "out.csv"]
