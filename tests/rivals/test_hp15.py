"""HP15's model against its equations, its normalisation, and the models that it is between."""

import math
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from merlfit.fitting.fit.problem import directions, make_problem
from merlfit.fitting.fit.residuals import Objective, predict
from merlfit.merl_io.grid import merl_grid
from merlfit.merl_io.samples import fold, thin
from merlfit.model.parameters import WAVELENGTHS_UM
from merlfit.model.rivals.epd import EPD
from merlfit.model.rivals.hp15 import HP15, diffraction_lobe
from scipy.integrate import quad

from tests.oracles import microfacets as oracle
from tests.oracles.facets import direction
from tests.reference import hp15_procedures as hp15
from tests.support.compiled import evaluate, from_vectors

VALUES = {
    "beta": 0.2, "p": 0.7, "a": 0.9, "k_s": np.array([0.8, 0.5, 0.2]), "F0": np.array([0.9, 0.5, 0.1]),
    "k_w": np.array([8e-3, 6e-3, 2e-3]), "diffuse_albedo": np.array([0.05, 0.1, 0.2]),
}  # fmt: skip


def printed(i, o, k, inverted=True):
    """HP15 Eq. 10, 24-27 of channel k; E as printed, or inverted, as it normalises."""
    h = (i + o) / np.linalg.norm(i + o)
    D = lambda t: oracle.epd(t, VALUES["beta"], VALUES["p"])  # noqa: E731
    wavelength, a = WAVELENGTHS_UM[k], VALUES["a"]
    G = math.prod(oracle.smith_G1(v[2], D, 0.2) for v in (i, o))
    F = VALUES["F0"][k] + (1 - VALUES["F0"][k]) * (1 - i @ h) ** 5
    f = np.linalg.norm(np.cross(i + o, [0, 0, 1])) / wavelength
    bracket = 1 + 1 / (a**2 * wavelength**2)
    E = math.pi / bracket if inverted else math.pi * bracket
    lobe = VALUES["k_s"][k] * D(math.acos(h[2])) * F / (4 * i[2] * o[2])
    return VALUES["diffuse_albedo"][k] / math.pi + G * (
        lobe + VALUES["k_w"][k] / wavelength**4 / E / (1 + f**2 / a**2) ** 2
    )


def test_it_is_the_printed_model_with_e_inverted():
    rng = np.random.default_rng(3)
    for _ in range(5):
        i, o = (direction(np.arccos(rng.uniform(0.1, 1)), rng.uniform(0, 2 * np.pi)) for _ in range(2))
        for pair in ((i, o), (o, i)):
            found = evaluate(HP15(), VALUES, from_vectors(*pair))
            np.testing.assert_allclose(found, [printed(i, o, k) for k in range(3)], rtol=1e-8)
        assert not np.allclose(found, [printed(i, o, k, inverted=False) for k in range(3)], rtol=1e-3)


@pytest.mark.parametrize("a", [0.1, 0.9, 20.0])
def test_the_diffraction_lobe_integrates_to_one(a):
    """Over the disc of projected directions at normal incidence, where |o_p| = lambda f."""
    wavelength = 0.526
    of = jax.jit(diffraction_lobe)
    lobe = lambda r: float(of(r / wavelength, a, wavelength))  # noqa: E731
    total = quad(lambda r: 2 * math.pi * r * lobe(r), 0, 1, points=[min(a * wavelength, 1.0)], limit=200)[0]
    assert total == pytest.approx(1, rel=1e-9)


def test_without_diffraction_it_is_epd():
    dark = {**VALUES, "k_w": np.full(3, 1e-30), "k_s": np.ones(3)}
    i, o = direction(0.3, 0.0), direction(0.8, 2.0)
    values = {"beta": 0.2, "p": 0.7, "F0": VALUES["F0"], "albedo": VALUES["diffuse_albedo"]}
    g = from_vectors(i, o)
    np.testing.assert_allclose(evaluate(HP15(), dark, g), evaluate(EPD(), values, g), rtol=1e-9)


# --- its fitting procedures


@pytest.fixture(scope="module")
def samples():
    """Of the model itself, on a thin grid, unweighted."""
    grid = merl_grid()
    weight = np.where(grid.above, grid.weight, 0.0) * np.ones((3, 1, 1, 1))
    blank = thin(fold(grid, np.ones_like(weight), weight), (3, 3, 30))
    where = directions(blank.theta_h, blank.theta_d, blank.cos_i, blank.cos_o)
    return replace(blank, value=predict(HP15(), {k: jnp.asarray(x) for k, x in VALUES.items()}, where))


def test_the_determinant_is_zero_where_a_brdf_depends_on_f_alone(samples):
    theta_h, theta_d = samples.theta_h[:, None], samples.theta_d
    f = 2 * np.sin(theta_h) * np.cos(theta_d) / np.array(WAVELENGTHS_UM)[:, None, None]
    of_f, of_half = 0.3 / (1 + f**2), 0.3 / (1 + 5 * np.sin(theta_h) ** 2) + 0 * f
    every = np.ones_like(samples.weight)
    along, across = (
        np.abs(hp15.determinant(replace(samples, value=np.repeat(x[..., None], every.shape[-1], -1), weight=every)))
        for x in (of_f, of_half)
    )
    assert np.median(along) < 0.02 * np.median(across)
    chosen = hp15.selected(replace(samples, value=np.repeat(of_f[..., None], every.shape[-1], -1), weight=every), 0.05)
    assert chosen.weight.mean() > 0.9


def test_one_step_finds_what_the_data_were_made_of(samples):
    own = hp15.layout(samples)
    found = hp15.one_step(samples, own.free(VALUES) + 0.1, 150)
    assert found.cost < 1e-10
    values = own.values(jnp.asarray(found.z))
    for name, expected in VALUES.items():
        np.testing.assert_allclose(values[name], expected, rtol=1e-3, err_msg=name)


def test_two_steps_hold_what_the_first_one_found(samples):
    own = hp15.layout(samples)
    z = own.free(VALUES) + 0.3
    found = hp15.two_steps(samples, z)
    assert found.z.shape == z.shape
    assert found.cost < 0.2
    again = hp15.two_steps(samples, own.free(VALUES) + 0.2)
    assert again.cost == pytest.approx(found.cost, rel=1e-2), "whatever it began with"


def test_some_parameters_are_solved_and_the_others_stay(samples):
    own = hp15.layout(samples)
    objective, z = Objective(own, make_problem(samples)), own.free(VALUES) + 0.05
    found = hp15.solve_some(objective, z, ("beta", "k_s"))
    still = [k for name, s in own.slices.items() if name not in ("beta", "k_s") for k in range(s.start, s.stop)]
    np.testing.assert_array_equal(found.z[still], z[still])
    assert found.cost < float(objective.costs(own.values(jnp.asarray(z))).sum())
    assert found.cost == pytest.approx(float(objective.costs(own.values(jnp.asarray(found.z))).sum()), rel=1e-9)


def test_random_starts_are_alike_in_all_channels(samples):
    own = hp15.layout(samples)
    values = own.values(jnp.asarray(hp15.random_start(own, np.random.default_rng(1))))
    for q in own.parameters:
        x = np.asarray(values[q.name])
        assert np.all((q.lower <= x) & (x <= q.upper))
        assert np.ptp(x) < 1e-9
