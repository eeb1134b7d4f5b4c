"""Arguments and options that several commands have."""

from pathlib import Path
from typing import Annotated

import typer

# typer's own look at a path would end a command at the first file that it may not read: ours name each and go on
Files = Annotated[
    list[Path],
    typer.Argument(
        help="MERL .binary files, tables (.csv, .npz: docs/tables.md), or other programs' files (docs/formats.md).",
        readable=False,
    ),
]
Result = Annotated[Path, typer.Argument(help="RESULT.json of a fit.", readable=False)]
Measured = Annotated[
    Path | None, typer.Option("--file", help="The MERL file, if it moved since the fit.", readable=False)
]
Quantity = Annotated[
    str | None,
    typer.Option(
        help="What the values of tables are: brdf, brdf_cos (times cos theta_o) or reflectance_factor (pi f)."
    ),
]
Settings = Annotated[Path | None, typer.Option(help="TOML settings; see configs/default.toml.", readable=False)]
Out = Annotated[Path, typer.Option("-o", "--out", help="Folder for the results.")]
Models = Annotated[
    str | None,
    typer.Option(help="Models to fit, by name and with commas between: see `merlfit models` \\[default: all]."),
]
Weights = Annotated[
    str | None,
    typer.Option(help="compressive (dark bins count, too), log, none (least RMSE) or adaptive (nearest picture)."),
]
SameWeights = Annotated[
    str | None,
    typer.Option(
        "--weights", help="compressive (dark bins count, too), log or none (least RMSE): the same for every model."
    ),
]
Dims = Annotated[
    str | None, typer.Option(help="Bins that MERL-like files may have, if they are not MERL's 90x90x180: 45x45x90.")
]
Seed = Annotated[int | None, typer.Option(help="Seed of the sampler.", min=0, max=2**31 - 1)]
Set = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="NAME=VALUE",
        help="Edit the fit first: a parameter and its value, or one for each channel: beta=0.05, n_R=0.2, "
        "n=0.2,0.9,1.1.",
    ),
]
Force = Annotated[
    bool, typer.Option("--force", help="Write over files that are no earlier output of this command, too.")
]
Jobs = Annotated[
    int | None,
    typer.Option(
        "-j",
        "--jobs",
        min=1,
        help="Files to fit at once, or workers of dask-slurm \\[default: as cores and memory allow].",
    ),
]
Pages = Annotated[
    int | None,
    typer.Option("-j", "--jobs", min=1, help="Pages to make at once \\[default: as cores and memory allow]."),
]
