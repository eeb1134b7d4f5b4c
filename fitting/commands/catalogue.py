"""All reflectance models, as a table for a terminal."""

from rich.table import Table

from ...model.registry import models, variants
from ..support.numbers import unit
from ..support.tables import table


def models_table() -> Table:
    """What `merlfit models` prints."""
    heads = ("model, parameter", "unit", "meaning")
    found = table(
        "reflectance models; RGB: one value per channel; numbers: over three channels, without the "
        "grazing exponents. `merlfit fit` fits the two-scale model, in the variants that --body and --index name, or "
        "another one by --model NAME; `merlfit compare` fits several. Sums are models, too: ggx+epd is two "
        "surfaces side by side, coat(ggx)+epd a clear coat over another model",
        heads, heads,
    )  # fmt: skip
    for name, kind in models().items():
        compared = variants(name)
        counts = sorted({sum(3 if q.per_channel else 1 for q in model.parameters) for model in compared})
        numbers = f"{counts[0]} to {counts[-1]}" if len(counts) > 1 else str(counts[0])
        found.add_row(name, "", f"{numbers} numbers; body {', '.join(kind.bodies)}; {kind.citation}")
        for q in {q.name: q for model in compared for q in model.parameters}.values():
            found.add_row(f"  {q.name} (RGB)" if q.per_channel else f"  {q.name}", unit(q.unit), q.meaning)
    return found
