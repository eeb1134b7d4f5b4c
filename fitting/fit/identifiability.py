"""What the data determine, and what only the prior does: from the normal equations at a fit.

In free coordinates the prior is a standard normal distribution, so an eigenvalue of the likelihood's curvature says how
much of a direction's knowledge is the data's: at 1 as much as the prior's, below 1 the direction is not determined.
"""

import numpy as np

from ..results import schema
from .noise import Noise
from .transforms import Layout

NAMED = 0.3  # of a unit vector: smaller components of a direction are not named
STRONG = 0.9  # correlations beyond this are put into words


def identifiability(layout: Layout, noise: Noise, covariance: np.ndarray) -> schema.Identifiability:
    """Correlations, contraction of the prior, and directions that the data do not determine.

    Args:
        noise: of the fit. covariance: of the physical values (P, P).
    """
    values, vectors = np.linalg.eigh((noise.precision + noise.precision.T) / 2)
    deviation = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    names, left = layout.coordinates, np.sqrt(np.diag(noise.covariance))
    return schema.Identifiability(
        names=list(layout.names),
        covariance=covariance.tolist(),
        priors=priors(layout),
        correlation=np.clip(covariance / deviation / deviation[:, None], -1, 1).round(3).tolist(),
        coordinates=list(names),
        contraction=(1 - left).round(3).tolist(),
        determined=int(np.sum(values >= 1)),
        undetermined=[
            schema.Direction(
                curvature=float(max(value, 0.0)),
                components={names[i]: round(float(vector[i]), 3) for i in np.argsort(-np.abs(vector)) if named[i]},
            )
            for value, vector in zip(values, vectors.T, strict=True)
            if value < 1 and (named := np.abs(vector) >= NAMED).any()
        ],
    )


def priors(layout: Layout) -> list[schema.Prior]:
    """The prior of every coordinate, as `transforms` has it."""
    found, middle = [], layout.channels[layout.bands.middle]
    for name, q in ((layout.names[k], layout.entries[k]) for k in layout.leads):
        quantity, offset = q.quantity or q.name, q.offset
        if q.alike and not name.endswith(f"_{middle}"):
            quantity, offset = "dispersion", 0.0
        uniform = q.scale == "linear" and q.quantity is None
        given = None if uniform else layout.priors.dispersion if quantity == "dispersion" else layout.log_normal(q)
        if q.quantity == "sigma_rel" and q.shift is None:
            quantity = q.name
        found.append(schema.Prior(
            parameter=name, quantity=quantity, distribution="log-normal" if given else "uniform", offset=offset,
            median=given and given.median, factor=given and given.factor, lower=q.lower, upper=q.upper,
        ))  # fmt: skip
    return found


def in_words(found: schema.Identifiability) -> list[str]:
    """Sentences of it."""
    free = len(found.coordinates)
    said = [f"the data determine {found.determined} of {free} independent combinations of the parameters"]
    for direction in found.undetermined:
        together = ", ".join(f"{name} {value:+.1f}" for name, value in direction.components.items())
        how_much = f"the data constrain it {direction.curvature:.2g} times as much as the prior does"
        said.append(f"not determined by the data ({how_much}): {together}")
    own = [found.names.index(prior.parameter) for prior in found.priors]
    pairs = [
        (found.correlation[i][j], found.names[i], found.names[j])
        for i in own
        for j in own
        if j < i and abs(found.correlation[i][j]) > STRONG
    ]
    if pairs:
        strongest = sorted(pairs, key=lambda pair: -abs(pair[0]))
        said.append("strongly correlated: " + ", ".join(f"{a} with {b} {r:+.2f}" for r, a, b in strongest))
    return said
