"""The free split beside the printed one and HP15: `python -m tests.free_split OUT` writes results/free_split.md.

Neural reconstructions of MERL and genuine measurements of RGL, by `merlfit fit --no-posterior`: an hour of two cores.
It goes on where it was stopped.
"""

import subprocess
import sys
from pathlib import Path

from merlfit.fitting.results.storage import read_result
from merlfit.merl_io.source import MerlError

from .bench.materials import TWELVE
from .bench.processes import MERLFIT, ROOT
from .measured import ORIGINS, commit
from .support.reconstructions import DATA, ORIGIN, make

TABLE = ROOT / "results" / "free_split.md"
WAYS = {"printed": (), "free": ("--preset", "free"), "HP15": ("--model", "hp15")}
PAINTS = ("silver-metallic-paint", "gold-metallic-paint", "silver-metallic-paint2")
WRAPS = (
    "cc_green_malachite", "cc_nothern_aurora", "cg_sunflower", "chm_mint", "chm_orange", "irid_flake_paint1",
    "irid_flake_paint2", "vch_golden_yellow", "vch_silk_blue", "aurora_white", "satin_purple",
)  # fmt: skip
GROUPS = {  # names of files by what they are
    ORIGIN: (*PAINTS, *sorted(TWELVE)),
    ORIGINS["rgl"]: tuple(f"{name}_rgb" for name in WRAPS),
}
HEAD = "file | split | status | index, body | numbers | cost | sMAPE | lamp, room | s | weight R, G, B"
PAGE = """# Fits with a free weight of the diffracted light

`python -m tests.free_split`, fits with the defaults of commit {at} but for the split; HP15 is `--model hp15`. Cost is
relative to the weighted energy of the file; lamp and room: CIELAB distance of the lit pixels of spheres; numbers: what
was free. Seconds are of single fits on a machine of two cores with much other work, and mean little; some compile.
"""


def fits(out):
    """Fit what has no result there."""
    for origin, names in GROUPS.items():
        rgl = origin in ORIGINS.values()
        paths = [DATA / "measured" / "rgl" / f"{name}.bsdf" if rgl else make(out, name) for name in names]
        for way, options in WAYS.items():
            command = [MERLFIT, "fit", *map(str, paths), "-o", str(out / way), "--no-posterior", "--resume", *options]
            subprocess.run([*command, "--jobs", "1", "--origin", origin], check=False)


def row(name, way, folder):
    """A line of the table; None where there is no result."""
    try:
        r = read_result(folder / f"{name}.json")
    except MerlError:
        return None
    settings, m = r.model.settings, r.metrics
    weight = " ".join(f"{q.value:.2g}" for q in r.parameters if q.parameter == "weight")
    free = sum(q.fitted == "free" for q in r.parameters)
    kind = f"{settings['index']} {settings['body']}" if "index" in settings else "-"
    cells = [
        name.removesuffix("_rgb"), way, r.fit.status, kind, str(free), f"{r.fit.cost:.4f}", f"{m.smape:.3f}",
        f"{m.lamp:.1f}, {m.environment:.1f}", f"{r.seconds['total']:.0f}", weight,
    ]  # fmt: skip
    return f"| {' | '.join(cells)} |"


def write(out, at):
    """The page, of what there is."""
    lines = [PAGE.format(at=at)]
    for origin, names in GROUPS.items():
        lines += [f"## {origin[0].upper()}{origin[1:]}", "", f"| {HEAD} |", "|" + "---|" * len(HEAD.split(" | "))]
        lines += [line for name in names for way in WAYS if (line := row(name, way, out / way))]
        lines.append("")
    TABLE.write_text("\n".join(lines))


if __name__ == "__main__":
    fits(Path(sys.argv[1]))
    write(Path(sys.argv[1]), commit())
