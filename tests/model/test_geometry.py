"""Directions: angles and cosines given as integers are computed with as floating-point numbers."""

import jax
import jax.numpy as jnp
import numpy as np
from merlfit.model.geometry import Geometry
from merlfit.model.masking import smith
from merlfit.model.numerics import floats
from merlfit.model.published import published
from merlfit.model.rivals.cook_torrance import CookTorrance
from merlfit.model.two_scale import TwoScale, two_scale

from tests.support.compiled import evaluate, from_half_difference, from_vectors

EFFECTS = TwoScale(diffraction="lobe", masking="none", colour="fresnel", renormalised=False)
MATERIAL = {q.name: np.full(3, q.default) if q.per_channel else q.default for q in EFFECTS.parameters}
brdf = jax.jit(lambda geometry: two_scale(MATERIAL, geometry, EFFECTS))


def by_hand(kind):
    """Light and viewer along the normal, every array of this kind of number."""
    return Geometry(*(jnp.asarray(x, kind) for x in (0, 0, 1, 1)))


def test_whole_angles_are_the_same_directions():
    whole, real = (from_half_difference(kind(1), kind(0), kind(0)) for kind in (int, float))
    for found, expected in zip(vars(whole).values(), vars(real).values(), strict=True):
        assert found.dtype == jnp.float64
        assert found == expected


def test_whole_vectors_are_the_same_directions():
    found = from_vectors(np.array([0, 0, 1]), np.array([1, 0, 0]))
    assert all(x.dtype == jnp.float64 for x in vars(found).values())
    np.testing.assert_allclose([found.theta_h, found.theta_d], np.pi / 4, rtol=1e-15)


def test_whole_angles_give_the_same_brdf():
    expected = brdf(from_half_difference(0.0, 0.0, 0.0))
    assert np.all(np.asarray(expected) > 0)
    for geometry in (from_half_difference(0, 0, 0), by_hand(jnp.int32)):
        found = brdf(geometry)
        assert found.dtype == jnp.float64
        np.testing.assert_array_equal(found, expected)


def test_whole_angles_give_the_same_brdf_of_a_rival():
    values = published("nickel", "cook-torrance")
    found, expected = (evaluate(CookTorrance(), values, by_hand(kind)) for kind in (jnp.int32, jnp.float64))
    assert found.dtype == jnp.float64
    np.testing.assert_array_equal(found, expected)


def test_precision_is_kept():
    single, whole = floats(jnp.float32(0.5), 1)
    assert single.dtype == whole.dtype == jnp.float32
    assert from_half_difference(jnp.float32(0.5), 0, 0).cos_o.dtype == jnp.float32
    assert by_hand(jnp.float32).theta_h.dtype == jnp.float32
    assert brdf(by_hand(jnp.float32)).dtype == jnp.float32
    assert jax.eval_shape(smith.smith_lambda, jnp.float32(1), 1).dtype == jnp.float32
