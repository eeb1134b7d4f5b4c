"""Bodies against slow oracles, with wrong formulas that are rejected."""

import jax
import numpy as np
import pytest
from merlfit.model import body

from tests.oracles import bodies as o_bodies

SEED = 20261121


def test_bodies_to_1e_8():
    rng = np.random.default_rng(SEED)
    plastic, subsurface = jax.jit(body.plastic), jax.jit(body.subsurface)
    for _ in range(12):
        i, o = rng.uniform(0, 1.55, 2)
        n, albedo = rng.uniform(1.001, 3.5), rng.uniform(0.01, 0.999)
        args = (np.cos(i), np.cos(o), n, albedo)
        assert float(plastic(*args)) == pytest.approx(float(o_bodies.plastic(i, o, n, albedo)), rel=1e-8)
        assert float(subsurface(*args)) == pytest.approx(float(o_bodies.subsurface(i, o, n, albedo)), rel=1e-8)
        as_printed = float(plastic(*args)) * n**2
        assert as_printed != pytest.approx(float(o_bodies.plastic(i, o, n, albedo)), rel=1e-4)
