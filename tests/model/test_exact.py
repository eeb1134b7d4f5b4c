"""Eq. 27 by adaptive quadrature in JAX against the oracle's own rings."""

import jax
import jax.numpy as jnp
import numpy as np
from merlfit.model.geometry import Geometry
from merlfit.model.reflectance import factor_values, setting, shaped
from merlfit.model.two_scale import TwoScale

from tests.oracles import two_scale as o_two_scale

WAVELENGTH_UM = 0.526


def cases(count=24):
    """Materials over the bounds of the fit and pairs of directions up to 86 degrees."""
    rng = np.random.default_rng(20261121)
    for _ in range(count):
        log = rng.uniform
        material = o_two_scale.Material(
            beta=10 ** log(-3, 0), p=np.exp(log(np.log(0.2), np.log(5))), b=10 ** log(-1.3, 2.3),
            c=1 + 10 ** log(-2, 0.7), sigma_s=10 ** log(-3, -0.3), n=log(0.2, 3), k=log(0, 5),
        )  # fmt: skip
        theta, phi = np.arccos(rng.uniform(0.07, 1, 2)), rng.uniform(0, 2 * np.pi, 2)
        yield material, np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)]).T
    # a lobe a thousandth wide beside a long-tailed D: most of the integral is in the azimuth's tails
    h, d, phi = 1.3, 0.25, 0.3
    turn = np.array([[np.cos(h), 0, np.sin(h)], [0, 1, 0], [-np.sin(h), 0, np.cos(h)]])
    across = np.sin(d) * np.array([np.cos(phi), np.sin(phi), 0])
    along = np.array([0, 0, np.cos(d)])
    narrow = o_two_scale.Material(beta=1.0, p=0.2, b=250.0, c=6.0, sigma_s=0.05, n=1.5, k=0.0)
    yield narrow, np.array([turn @ (along + across), turn @ (along - across)])


@jax.jit
def diffraction_lobe(values, i, o):
    s, model = setting(Geometry.from_vectors(i, o), (WAVELENGTH_UM,)), TwoScale(diffraction="exact")
    at = factor_values(model, shaped(model, values, s), s)
    return model.assemble({**at, "distribution": jnp.zeros_like(at["distribution"])}, s).brdf(s)[0]


def test_exact_lobe_against_the_oracle():
    found, right, wrong = [], [], []
    for material, (i, o) in cases():
        values = {**material._asdict(), "n": np.array([material.n]), "k": np.array([material.k])}
        found.append(float(diffraction_lobe(values, i, o)))
        right.append(o_two_scale.exact_ctd(i, o, WAVELENGTH_UM, material))
        wrong.append(o_two_scale.exact_ctd(i, o, WAVELENGTH_UM, material, colour_frame="surface"))
    found, right, wrong = np.array(found), np.array(right), np.array(wrong)
    assert np.max(np.abs(found / right - 1)) < 1e-5
    assert np.max(np.abs(found / wrong - 1)) > 0.05  # Q by the angles to the surface, as Eq. 27 is literally written


def test_exact_lobe_on_the_axis_and_where_the_lobe_is_narrow():
    """i = o = n, and half vectors within 1e-9 of the normal, where azimuths mean nothing."""
    material = o_two_scale.Material(beta=0.01, p=0.6, b=20.0, c=2.0, sigma_s=0.05, n=1.5, k=2.0)
    values = {**material._asdict(), "n": np.array([material.n]), "k": np.array([material.k])}
    for tilt in (0.0, 1e-9):
        i, o = (np.array([np.sin(t), 0.0, np.cos(t)]) for t in (0.7, -0.7 + tilt))
        expected = o_two_scale.exact_ctd(i, o, WAVELENGTH_UM, material)
        np.testing.assert_allclose(diffraction_lobe(values, i, o), expected, rtol=1e-5)
    n = np.array([0.0, 0.0, 1.0])
    np.testing.assert_allclose(
        diffraction_lobe(values, n, n), o_two_scale.exact_ctd(n, n, WAVELENGTH_UM, material), rtol=1e-5
    )
