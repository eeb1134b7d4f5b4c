"""Exported materials in the programs that they are for: `python -m tests.exported`, ten minutes; results/exports/."""
