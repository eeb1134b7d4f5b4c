"""Renormalisation against slow oracles, with wrong formulas that are rejected."""

import jax
import numpy as np
from merlfit.model import diffraction

from tests.oracles import diffraction as o_diffraction
from tests.support.arrays import worst

SEED = 20261121


def test_renormalisation_to_1e_9():
    rng = np.random.default_rng(SEED)
    s = np.concatenate([rng.uniform(0, 1, 30), [0.0, 1.0, 1.0, 0.999999]])
    bl = np.concatenate([np.exp(rng.uniform(np.log(1e-3), np.log(1e4), 30)), [2.0, 1e4, 1e-3, 300.0]])
    c = np.concatenate([1 + np.exp(rng.uniform(np.log(1e-3), np.log(7), 30)), [2.0, 1.001, 3.0, 1.5]])
    expected = np.array([float(o_diffraction.renormalisation(*case)) for case in zip(s, bl, c, strict=True)])
    found = jax.jit(diffraction.renormalisation)(s, bl, c)
    assert worst(found, expected) < 1e-9
    centred = 1 - (1 + bl**2) ** (-(c - 1) / 2)  # as if the disc were always centred
    assert worst(centred, expected) > 1e-2
