"""All reflectance models, as a table for a terminal."""

from rich.table import Table

from ...model.registry import models


def models_table() -> Table:
    """What `merlfit models` prints."""
    table = Table(
        title="reflectance models; RGB: one value per channel; numbers: over three channels, without the "
        "grazing exponents. `merlfit fit` fits the two-scale model, in the variants that --body and --index name, or "
        "another one by --model NAME; `merlfit compare` fits several",
    )  # fmt: skip
    for head in ("model, parameter", "unit", "meaning"):
        table.add_column(head)
    for name, kind in models().items():
        variants = kind.variants()
        counts = sorted({sum(3 if q.per_channel else 1 for q in model.parameters) for model in variants})
        numbers = f"{counts[0]} to {counts[-1]}" if len(counts) > 1 else str(counts[0])
        table.add_row(name, "", f"{numbers} numbers; body {', '.join(kind.bodies)}; {kind.citation}")
        for q in {q.name: q for model in variants for q in model.parameters}.values():
            unit = "-" if q.unit == "1" else q.unit
            table.add_row(f"  {q.name} (RGB)" if q.per_channel else f"  {q.name}", unit, q.meaning)
    return table
