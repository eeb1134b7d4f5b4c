"""The scaled lobe: how good the form is, what the table costs, and what happens outside its range."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from merlfit.model import chebyshev, convolution, scaled
from scipy.special import gammaincinv

from tests.oracles import convolution as o_convolution
from tests.support.arrays import j
from tests.support.lobes import ANGLES, HIGH, INSIDE, LOW, OUTSIDE, SEED, lobes_in_range, truth


def forms(log_s, q, c, squared_cosine=True):
    lobe = jax.vmap(lambda *x: scaled.scaled_lobe(ANGLES, *x, squared_cosine))
    return np.asarray(lobe(jnp.asarray(log_s), jnp.asarray(q), jnp.asarray(c)))


def scaled_errors(found, expected):
    """(relative errors where the lobe is above 1e-3 of its peak, errors in units of the peak)."""
    peak = expected.max(1, keepdims=True)
    return np.abs(found / expected - 1)[expected > 1e-3 * peak], np.abs(found - expected) / peak


@pytest.fixture(scope="module")
def sample(table):
    """Random lobes, the truth, and what fit and table make of them."""
    lobes = lobes_in_range(600)
    looked_up = jax.jit(jax.vmap(scaled.height_and_width))(*lobes.T)
    return lobes, np.asarray(truth(lobes)), scaled.fit_all(*j(*lobes.T)), looked_up


def test_form_with_squared_cosine_is_as_good_as_stated(sample):
    lobes, expected, _, looked_up = sample
    relative, absolute = scaled_errors(forms(*looked_up, lobes[:, 1]), expected)
    assert np.median(relative) < 1e-2
    assert np.quantile(relative, 0.95) < 0.8
    assert np.median(absolute) < 1e-3
    assert np.quantile(absolute, 0.95) < 0.15
    blur = lobes[:, 0] * lobes[:, 2]  # width of D in units of the width of S
    regimes = ((0, 0.1, 2e-3, 0.2, 4e-3), (0.1, 1, 0.04, 0.6, 0.05), (1, np.inf, 0.3, 1.2, 0.3))
    for low, high, median, most, of_lobe in regimes:
        here = (blur >= low) & (blur < high)
        relative, absolute = scaled_errors(forms(*looked_up, lobes[:, 1])[here], expected[here])
        assert np.median(relative) < median
        assert np.quantile(relative, 0.95) < most
        assert np.median(absolute.max(1)) < of_lobe
    assert np.median(relative) > 0.1  # wide normals are beyond the form: the statement is no modesty


def test_printed_form_is_far_worse(sample):
    lobes, expected, _, looked_up = sample
    printed = forms(*scaled.fit_all(*j(*lobes.T), False), lobes[:, 1], False)
    ours, theirs = (scaled_errors(x, expected) for x in (forms(*looked_up, lobes[:, 1]), printed))
    assert np.median(theirs[0]) > 10 * np.median(ours[0])
    assert np.median(theirs[1]) > 10 * np.median(ours[1])


def test_table_costs_little_against_fitting_every_lobe(sample):
    lobes, expected, fitted, looked_up = sample
    (log_s, q), (direct_s, direct_q) = np.asarray(looked_up), np.asarray(fitted)
    assert np.median(np.abs(log_s - direct_s)) < 2e-3
    assert np.quantile(np.abs(log_s - direct_s), 0.95) < 4e-2
    assert np.median(np.abs(q - direct_q)) < 4e-3
    assert np.quantile(np.abs(q - direct_q), 0.95) < 0.12
    through, direct = (scaled_errors(forms(*x, lobes[:, 1]), expected)[1].max(1) for x in (looked_up, fitted))
    assert np.median(through) < np.median(direct) + 2e-3
    assert np.quantile(np.abs(through - direct), 0.95) < 4e-2
    # a table read with beta and p exchanged is seen
    wrong = np.asarray(jax.vmap(scaled.height_and_width)(*j(*lobes_in_range(600).T[[0, 1]], *lobes.T[[3, 2]])))
    assert np.median(np.abs(wrong[1] - direct_q)) > 0.1


def test_height_is_the_peak_of_the_integral(sample):
    def projected(theta_m, sin_m, cos_m, *rest):
        return cos_m * o_convolution.ring_of_s(theta_m, sin_m, cos_m, *rest)

    lobes, _, (log_s, _), _ = sample
    lobes, log_s = lobes[:40], np.asarray(log_s[:40])
    expected = np.log([o_convolution.convolve(0.0, *lobe) for lobe in lobes])
    np.testing.assert_allclose(log_s, expected, atol=1e-3)
    # normals weighted by the area that they show
    wrong = np.log([o_convolution.convolve(0.0, *lobe, ring=projected) for lobe in lobes])
    assert np.max(np.abs(log_s - wrong)) > 0.05


def test_narrow_normals_leave_the_lobe_as_it_is(table):
    for B in (0.1, 1.0, 10.0):
        log_s, q = scaled.height_and_width(*j(B, 2.0, LOW[2], 1.0))
        assert abs(float(log_s)) < 5e-3
        assert float(q) == pytest.approx(np.log1p(B * B), abs=5e-3)
    # as printed, no g gives the cos^2 back
    printed = scaled.fit(*j(1.0, 2.0, LOW[2], 1.0), False)
    assert abs(float(printed[1]) - np.log(2)) > 0.1


@pytest.mark.parametrize("change", OUTSIDE, ids=str)
def test_outside_its_range_it_is_the_quadrature(table, change):
    theta_h = jnp.linspace(0.0, 1.5, 5)
    values = j(*(INSIDE | change).values())
    assert not scaled.covers(*values)
    found, expected = scaled.convolve(theta_h, *values), convolution.convolve(theta_h, *values)
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_inside_its_range_it_is_not_the_quadrature(table):
    theta_h, values = jnp.linspace(0.3, 1.5, 5), j(*INSIDE.values())
    assert scaled.covers(*values)
    expected = scaled.scaled_lobe(theta_h, *scaled.height_and_width(*values), values[1])
    np.testing.assert_allclose(scaled.convolve(theta_h, *values), expected, rtol=1e-12)
    assert np.max(np.abs(expected / convolution.convolve(theta_h, *values) - 1)) > 1e-3


def test_one_B_out_of_range_is_enough(table):
    theta_h, values = jnp.array([0.4, 0.4]), j(*INSIDE.values())
    B = jnp.array([3.0, 1000.0])
    assert not scaled.covers(B, *values[1:])
    np.testing.assert_allclose(
        scaled.convolve(theta_h, B, *values[1:]), convolution.convolve(theta_h, B, *values[1:]), rtol=1e-12
    )


def test_range_ends_belong_to_it_and_nan_does_not():
    assert scaled.covers(*j([0.0, 910.0], 1.01, 1e-3, 0.2))
    assert scaled.covers(*j([0.0, 910.0], 6.0, 1.0, 5.0))
    for corner in ([910.0, 1.01, 1e-3, 0.2], [910.0, 6.0, 1.0, 5.0]):  # rounded, too
        assert scaled.covers(*(jnp.asarray(x, jnp.float32) for x in corner))
        assert not scaled.covers(*j(*(np.array(corner) * (1 + 1e-5 * np.sign(np.array(corner) - 1.02)))))
    for k in range(4):
        assert not scaled.covers(*j(*np.where(np.arange(4) == k, np.nan, list(INSIDE.values()))))


def test_widest_beta_tilts_half_of_the_surface_by_45_to_55_degrees():
    for p in (0.2, 0.25, 0.3, 0.4, 0.5, 0.6, 0.75):
        # (tan^2/beta^2)^p of the projected area follows Gamma(1/p)
        median = float(scaled.widest_beta(jnp.asarray(p))) * gammaincinv(1 / p, 0.5) ** (0.5 / p)
        assert 44 < np.degrees(np.arctan(median)) < 55


def test_coordinates_and_their_inverse_agree():
    x = np.random.default_rng(SEED).uniform(size=(4, 50))
    back = scaled._coordinates(*j(*scaled._parameters(*x)))
    np.testing.assert_allclose(back, x, atol=1e-12)


def test_chebyshev_nodes_of_the_table_lie_inside_the_range():
    lobes = [x.ravel() for x in scaled._parameters(*np.meshgrid(*(chebyshev.nodes(n) for n in scaled.NODES)))]
    low, high = (edge(np.array(lobes), axis=1) for edge in (np.min, np.max))
    assert np.all(low > LOW)
    assert np.all(high[[0, 1, 3]] < HIGH[[0, 1, 3]])
    assert np.all(lobes[2] < scaled.widest_beta(lobes[3]))
