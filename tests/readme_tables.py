"""Markdown tables for the README from results: `python -m tests.readme_tables FOLDER`."""

import sys
from pathlib import Path

from merlfit.fitting.results.storage import read_result
from merlfit.fitting.show.terminal_tables import interval, median
from merlfit.fitting.support.numbers import number


def parameters(result):
    rows = ["| parameter | value | 90 %, Laplace | median | 90 %, posterior | unit |", f"|{'---|' * 6}"]
    for q in result.parameters:
        unit = "" if q.unit == "1" else q.unit
        cells = [q.name, number(q.value), interval(q.laplace), median(q), interval(q.quantiles), unit]
        rows.append(f"| {' | '.join(cells)} |")
    return "\n".join(rows)


def fits(results):
    rows = [
        "| material | body | status | cost | RMSE (1/sr) | sMAPE | fit (s) | posterior (s) | posterior |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for r in results:
        t = r.seconds
        chain = "-" if r.posterior is None else "ok" if r.posterior.sufficient else "too short, no intervals"
        body = r.model.material.body if r.model else "-"
        rows.append(
            f"| {r.source.material} | {body} | {r.fit.status} | {number(r.fit.cost, 3)} "
            f"| {number(r.metrics.rmse, 3)} | {number(r.metrics.smape, 3)} "
            f"| {t['total'] - t.get('posterior', 0):.1f} | {t.get('posterior', 0):.0f} | {chain} |"
        )
    return "\n".join(rows)


if __name__ == "__main__":
    found = [read_result(p) for p in sorted(Path(sys.argv[1]).glob("*.json"))]
    for one in found:
        print(f"## {one.source.material}\n\n{parameters(one)}\n")
    print(fits(found))
