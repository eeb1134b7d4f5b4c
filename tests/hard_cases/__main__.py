"""The table of hard cases: values and gradients of the model at its extremes against 30 digits, in both precisions.

``python -m tests.hard_cases`` prints it, with the degenerate files of fits.py as a second one, and writes both to
results/hard_cases.md; with ``--references`` it first computes the references of the dear cases (two-dimensional
integrals) into references.json: those that are missing, and all where an oracle's source has changed.
"""

import sys
from pathlib import Path

import jax
from merlfit.fitting.support.compilation import use_persistent_cache

from . import fits
from .comparison import markdown, rows
from .table import table, write_references

RESULTS = Path(__file__).parents[2] / "results"


def main(arguments):
    """Print the tables, write them to results/; 1 where a case fails that is not known to, or a file's fit."""
    jax.config.update("jax_enable_x64", True)
    use_persistent_cache()
    if "--references" in arguments:
        write_references()
    lines, known = rows(), {entry["case"] for entry in table()[1]["entries"]}
    failing = [row for row in lines if row.failures]
    unknown = [row for row in failing if row.case.name not in known]
    files = fits.rows()
    wrong = [row for row in files if row.failures]
    text = [
        markdown(lines),
        f"{len(lines)} cases, {len(lines) - len(failing)} pass, {len(failing) - len(unknown)} known failures",
        "## Degenerate files",
        fits.markdown(files),
        f"{len(files)} files, {len(files) - len(wrong)} end as they should",
    ]
    print(*text, sep="\n\n")
    RESULTS.mkdir(exist_ok=True)
    (RESULTS / "hard_cases.md").write_text("\n\n".join(["# Hard cases", *text]) + "\n")
    for name, failures in [(row.case.name, row.failures) for row in unknown] + [(r.name, r.failures) for r in wrong]:
        print(f"FAILED {name}: {', '.join(failures)}")
    return 1 if unknown or wrong else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
