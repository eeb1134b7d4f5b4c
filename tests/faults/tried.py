"""What was tried and what came of it: results/faults.json, and the table results/faults.md."""

import json
import shlex
import sys
from pathlib import Path

from ..bench.record import machine

RESULTS = Path(__file__).parents[2] / "results"
TITLES = {
    "loaders": "Damaged files through the loaders",
    "inputs": "Damaged tables and files of RGL's kind through the loaders",
    "commands": "Hostile command lines, scenes, draws, manifests and maps",
    "folders": "Folders that fail",
    "kills": "kill -9 at random moments",
    "clusters": "Clusters that break",
}
TEXTS = {
    "loaders": "Each file is read whole and right, or refused with one line that names it. Watched for all: Python's "
    "own audit events (nothing is executed, compiled, unpickled or started), and the memory that is allocated. Most "
    "MERL files have the layout of a genuine one with fewer bins, so that thousands can be tried; the full ones are of "
    "full size. A wrong outcome is a traceback, a message of more than a line or without the file's name, values that "
    "are not as documented, or memory above three times the file (and a MiB).",
    "inputs": "As above. Whatever is accepted has directions above the horizon, shares and values that are not "
    "negative and not infinite, and one datum at least. Files are small, so that thousands can be tried. That full "
    "ones of RGL's layout take no more memory than three times their size is a test (tests/merl_io/test_rgl.py).",
    "commands": "Command lines are run in one process, with names that no file should have (escape sequences, "
    "formulas, no UTF-8, 300 characters, /dev/zero) and pipes, folders, links and damaged files of these names. A "
    "wrong outcome is a traceback, over 20 s, a failure without a line, a line of over 1,000 characters, or a control "
    "code that reaches the terminal. The readers are judged as above; of a manifest damaged lines are left out.",
    "folders": "Batches of the program with a stand-in for the fit, which writes what a fit would; all else is the "
    "program's own. After each the same command with --resume, the fault mended, has to bring every file to its end. "
    "A wrong outcome is a traceback, a failure without a line that names the file, an exit code of success although "
    "something failed, a torn file, a finished result that is lost, or values other than of an undisturbed run.",
    "kills": "Data are made up and small, so that many runs can be tried. Each run is killed at a moment drawn evenly "
    "over what an undisturbed one takes, and a little more, and the same command given again, until it is let come to "
    "its end. After every kill: no result or chain is torn, and nothing that the manifest calls finished is lost; at "
    "the end all values are those of an undisturbed run to the last bit, nothing unfinished is left in the folder and "
    "no process runs on.",
    "clusters": "Schedulers and workers of Dask are processes of this machine, SLURM a stand-in for `sbatch` and "
    "`scancel`, the fit one that writes a made-up result. A wrong outcome is a run that does not end in time, a "
    "traceback, a line that is missing, a file that is lost, or one that is written although it was not fitted.",
}


class Tried:
    """Rows by section, written at once."""

    def __init__(self, folder: Path | None = RESULTS) -> None:
        self.folder = folder  # None: they are printed alone
        path = folder / "faults.json" if folder else None
        self.sections = json.loads(path.read_text()) if path and path.is_file() else {}

    def begin(self, section, only=()):
        """The rows of this section are made anew, or those of some of its trials."""
        rows = self.sections[section]["rows"] if only and section in self.sections else []
        self.sections[section] = {"machine": machine(), "rows": rows}

    def add(self, section, what, times, outcome, wrong):
        """A row: what was tried, how often, what came of it, and how many outcomes were wrong."""
        held = self.sections[section]
        row = {
            "tried": what, "times": times, "outcome": outcome, "wrong": wrong, "date": held["machine"]["date"],
            "by": f"`{shlex.join(['python', '-m', 'tests.faults', *sys.argv[1:]])}`",
        }  # fmt: skip
        print(f"{section}: {row}", flush=True)
        names = [each["tried"] for each in held["rows"]]
        at = names.index(what) if what in names else len(names)
        held["rows"][at : at + 1] = [row]
        self.write()

    def write(self):
        """Both files."""
        if self.folder is None:
            return
        (self.folder / "faults.json").write_text(json.dumps(self.sections, indent=1) + "\n")
        (self.folder / "faults.md").write_text(self.markdown())

    @property
    def wrong(self):
        """How many outcomes were wrong."""
        return sum(row["wrong"] for held in self.sections.values() for row in held["rows"])

    def markdown(self):
        """The table as it is read."""
        lines = ["# Faults, tried", "", "Data: synthetic. `make faults` makes all of it.", ""]
        for section, title in TITLES.items():
            if section not in self.sections:
                continue
            held = self.sections[section]
            m = held["machine"]
            lines += [
                f"## {title}", "", TEXTS[section], "",
                f"{m['cores']} cores of {m['processor']}, {m['memory_gib']} GiB.", "",
                "| tried | times | outcome | wrong | by | date |", "|---|---|---|---|---|---|",
                *(
                    f"| {r['tried']} | {r['times']:,} | {r['outcome']} | {r['wrong']} | {r['by']} | {r['date']} |"
                    for r in held["rows"]
                ), "",
            ]  # fmt: skip
        return "\n".join(lines)
