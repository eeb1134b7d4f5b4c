"""The conserving split: its table against an oracle, and what a material gives back at the most."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from energy import FULL, albedo, draw
from merlfit.model import energy
from oracles import energy as o_energy

WAVELENGTH_UM = 0.526
THETA = np.radians([0.1, 25.0, 55.0, 75.0, 86.0, 89.0])
LOBES = [(3.0, 1.8, 0.04), (0.3, 1.05, 0.1), (0.08, 4.0, 0.3), (20.0, 1.3, 0.2), (60.0, 2.5, 0.03)]  # b, c, sigma_s


@pytest.mark.parametrize("how", [(True, False), (False, False), (True, True)], ids=["rel", "sigma_s", "exact"])
@pytest.mark.parametrize("lobe", LOBES, ids=str)
def test_albedo_of_a_facets_lobe(lobe, how):
    found = energy.lobe_albedo(
        jnp.asarray(THETA), *(jnp.asarray(x) for x in lobe), jnp.asarray([[WAVELENGTH_UM]]), *how
    )[0]
    expected = np.array([o_energy.lobe_albedo(t, WAVELENGTH_UM, *lobe, *how) for t in THETA])
    np.testing.assert_allclose(found, expected, rtol=0, atol=5e-4)


def test_the_albedo_is_not_the_printed_share():
    b, c, sigma_s = LOBES[0]
    given_back = o_energy.lobe_albedo(THETA[3], WAVELENGTH_UM, b, c, sigma_s)
    share = float(o_energy.relative_variances(b / WAVELENGTH_UM, c)(np.cos(THETA[3])))
    printed = 1 - np.exp(-share * (4 * np.pi * sigma_s * np.cos(THETA[3]) / WAVELENGTH_UM) ** 2)
    assert given_back > printed + 5e-3


@pytest.mark.parametrize("kind", ["lambert", "plastic", "subsurface"])
def test_bodies_below_the_surface_give_back_no_more_than_they_get(kind):
    u, w = np.polynomial.legendre.leggauss(60)
    u, w = (u + 1) / 2, w / 2
    cos_i = jnp.linspace(0.0, 1.0, 21)[:, None]
    rng = np.random.default_rng(20261121)
    given = []
    for n, white in zip(rng.uniform(1, 3, 30), [True, False] * 15, strict=True):
        albedo = 1.0 if white else rng.uniform()
        brdf = energy.unlit_body(kind, cos_i, jnp.asarray(u), jnp.asarray(albedo), jnp.asarray(n))
        given.append(np.max(np.sum(2 * np.pi * u * w * (brdf + 0 * cos_i), -1)))
    assert 1 - 1e-6 < max(given) < 1 + 1e-6  # at albedo 1 all of it


QUICK = [
    FULL, replace(FULL, body="lambert", masking="none"), replace(FULL, body="plastic", diffraction="lobe"),
    replace(FULL, body="subsurface", diffraction="off"),
]  # fmt: skip


@pytest.mark.parametrize("effects", QUICK, ids=str)
def test_conserving_split_gives_back_no_more_than_it_receives(effects):
    rng = np.random.default_rng(20261121)
    for k in range(2):
        values = draw(rng, effects)
        if "albedo" in values and k == 0:
            values["albedo"] = np.array([1.0])
        assert albedo(effects, values).max() <= 1 + 1e-3


def test_printed_split_does_not_conserve_energy():
    values = {"beta": 0.02, "p": 1.0, "b": 1.0, "c": 1.5, "sigma_s": 0.05, "n": np.array([0.05]), "k": np.array([4.0])}
    assert albedo(replace(FULL, split="printed"), values).max() > 1.05
    assert albedo(FULL, values).max() <= 1 + 1e-3
