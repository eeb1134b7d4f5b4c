"""What was tried and what came of it: results/faults.json, and the table results/faults.md."""

import json
from pathlib import Path

from ..bench.record import machine

RESULTS = Path(__file__).parents[2] / "results"
TITLES = {
    "loaders": "Damaged files through the loaders",
}
TEXTS = {
    "loaders": "Each file is read whole and right, or refused with one line that names it. Watched for all: Python's "
    "own audit events (nothing is executed, compiled, unpickled or started), and the memory that is allocated. Most "
    "MERL files have the layout of a genuine one with fewer bins, so that thousands can be tried; the full ones are of "
    "full size. A wrong outcome is a traceback, a message of more than a line or without the file's name, values that "
    "are not as documented, or memory above three times the file (and a MiB).",
}


class Tried:
    """Rows by section, written at once."""

    def __init__(self, folder: Path = RESULTS) -> None:
        self.folder = folder
        path = folder / "faults.json"
        self.sections = json.loads(path.read_text()) if path.is_file() else {}

    def begin(self, section):
        """The rows of this section are made anew."""
        self.sections[section] = {"machine": machine(), "rows": []}

    def add(self, section, what, times, outcome, wrong):
        """A row: what was tried, how often, what came of it, and how many outcomes were wrong."""
        row = {"tried": what, "times": times, "outcome": outcome, "wrong": wrong}
        print(f"{section}: {row}", flush=True)
        self.sections[section]["rows"].append(row)
        self.write()

    def write(self):
        """Both files."""
        (self.folder / "faults.json").write_text(json.dumps(self.sections, indent=1) + "\n")
        (self.folder / "faults.md").write_text(self.markdown())

    @property
    def wrong(self):
        """How many outcomes were wrong."""
        return sum(row["wrong"] for held in self.sections.values() for row in held["rows"])

    def markdown(self):
        """The table as it is read."""
        lines = ["# Faults, tried", "", "Data: synthetic. Made by `make faults`.", ""]
        for section, title in TITLES.items():
            if section not in self.sections:
                continue
            held = self.sections[section]
            m = held["machine"]
            lines += [
                f"## {title}", "", TEXTS[section], "",
                f"{m['cores']} cores of {m['processor']}, {m['memory_gib']} GiB, {m['date']}.", "",
                "| tried | times | outcome | wrong |", "|---|---|---|---|",
                *(f"| {r['tried']} | {r['times']:,} | {r['outcome']} | {r['wrong']} |" for r in held["rows"]), "",
            ]  # fmt: skip
        return "\n".join(lines)
