"""What a section found: JSON with everything, Markdown with targets beside values; both written as rows come in."""

import json
import math
import os
import platform
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

import numpy as np

RESULTS = Path(__file__).parents[2] / "results" / "bench"
RECONSTRUCTIONS = "neural reconstructions of MERL (Sztrajman et al. 2021), not measurements"
LIBRARIES = ("jax", "jaxlib", "numpy", "scipy")


def machine():
    """Cores, processor, memory, versions, date and how busy the machine was; Linux."""

    def of(path, key):
        lines = Path(path).read_text().splitlines()
        return next((line.split(":", 1)[1].strip() for line in lines if line.startswith(key)), "unknown")

    return {
        "cores": len(os.sched_getaffinity(0)),
        "processor": of("/proc/cpuinfo", "model name"),
        "memory_gib": round(int(of("/proc/meminfo", "MemTotal").split()[0]) / 2**20, 1),
        "load_before": round(os.getloadavg()[0], 2),
        "python": platform.python_version(),
        **{name: version(name) for name in LIBRARIES},
        "date": datetime.now(UTC).date().isoformat(),
    }


@dataclass
class Target:
    """A number that is asked for.

    Attributes:
        what: in words. value: as measured; None until then. limit: it is to stay below, or above if ``at_least``.
    """

    what: str
    limit: float
    unit: str
    at_least: bool = False
    value: float | None = None

    @property
    def met(self):
        """Whether it is; not before it is measured."""
        if self.value is None or not math.isfinite(self.value):
            return False
        return self.value >= self.limit if self.at_least else self.value <= self.limit

    @property
    def row(self):
        """Cells of a table: what, value, target, whether it is met."""
        value = "-" if self.value is None else f"{self.value:.3g} {self.unit}"
        sign = ">=" if self.at_least else "<="
        met = "not run" if self.value is None else "yes" if self.met else "**no**"
        return f"| {self.what} | {value} | {sign} {self.limit:g} {self.unit} | {met} |"


@dataclass
class Record:
    """A section's outcome.

    Attributes:
        section: its name. title, data, notes: in words. targets: by key. rows: of the table, all with the same keys.
        machine: where it was measured. finished: whether all rows are there. folder: for both files.
        command: by which it is made, if not as a section of the benchmarks.
    """

    section: str
    title: str
    data: str
    notes: list[str]
    targets: dict[str, Target] = field(default_factory=dict)
    rows: list[dict] = field(default_factory=list)
    machine: dict = field(default_factory=machine)
    finished: bool = False
    folder: Path = RESULTS
    command: str | None = None

    def add(self, row, details=None):
        """A row of the table, with what only the JSON tells; printed and written at once."""
        self.rows.append({**row, "details": details} if details else row)
        print(f"{self.section}: {', '.join(f'{k} {cell(v)}' for k, v in row.items())}", flush=True)
        self.write()

    def resume(self):
        """Take the rows of an unfinished run of this section from its file, details included."""
        path = self.folder / f"{self.section}.json"
        held = json.loads(path.read_text()) if path.is_file() else {"finished": True}
        self.rows = [] if held["finished"] else held["rows"]

    def column(self, name, **where):
        """Numbers of one column in the rows where other columns have the given values."""
        return [r[name] for r in self.rows if all(r[k] == v for k, v in where.items())]

    def set(self, target, value):
        """The value of a target."""
        self.targets[target].value = float(value)

    def finish(self):
        """All is measured."""
        self.finished = True
        self.write()

    def write(self):
        """NAME.json and NAME.md."""
        self.folder.mkdir(parents=True, exist_ok=True)
        held = {k: v for k, v in asdict(self).items() if k not in ("folder", "command")}
        held["targets"] = {name: {**held["targets"][name], "met": t.met} for name, t in self.targets.items()}
        (self.folder / f"{self.section}.json").write_text(json.dumps(held, indent=1, default=float) + "\n")
        (self.folder / f"{self.section}.md").write_text(self.markdown())

    def markdown(self):
        """The section as it is read."""
        m, columns = self.machine, [k for k in (self.rows[0] if self.rows else {}) if k != "details"]
        lines = [
            f"# {self.title}", "",
            f"Data: {self.data}. Machine: {m['cores']} cores of {m['processor']}, {m['memory_gib']} GiB; Python "
            f"{m['python']}, jax {m['jax']}; {m['date']}, load before {m['load_before']}. "
            f"Made by `{self.command or f'python -m tests.bench {self.section}'}`.", "",
            *([] if self.finished else ["**Unfinished: rows are missing, targets are those of the rows below.**", ""]),
            *(f"{note}\n" for note in self.notes),
        ]  # fmt: skip
        if self.targets:
            lines += [
                "| target | measured | asked | met |",
                "|---|---|---|---|",
                *(t.row for t in self.targets.values()),
                "",
            ]
        if self.rows:
            lines += [f"| {' | '.join(columns)} |", "|---" * len(columns) + "|"]
            lines += [f"| {' | '.join(cell(row[k]) for k in columns)} |" for row in self.rows]
        return "\n".join(lines) + "\n"


def cell(value):
    """A number as a table shows it."""
    if isinstance(value, float):
        return f"{value:.3g}" if abs(value) < 100 else f"{value:.0f}"
    return "-" if value is None else str(value)


def exponent(sizes, costs):
    """Growth of a cost as a power of a size, by least squares in logarithms."""
    return float(np.polyfit(np.log(sizes), np.log(costs), 1)[0])


def summary(folder=RESULTS):
    """All targets of all sections that are there, as Markdown."""
    lines = [
        "# Targets",
        "",
        f"Data: {RECONSTRUCTIONS}, unless the section says otherwise (synthetic for calibration and tables of "
        "directions). Tables and machines: the files named. Made by `make bench`.",
        "", "| target | measured | asked | met | section |", "|---|---|---|---|---|",
    ]  # fmt: skip
    for path in sorted(folder.glob("*.json")):
        held = json.loads(path.read_text())
        unfinished = "" if held["finished"] else " (unfinished)"
        for target in held["targets"].values():
            row = Target(**{k: v for k, v in target.items() if k != "met"}).row
            lines.append(f"{row} [{held['section']}]({held['section']}.md){unfinished} |")
    (folder / "README.md").write_text("\n".join(lines) + "\n")
