"""The cheap ways to blur the diffraction lobe: zonal harmonics and the scaled lobe."""

import math
import os
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from merlfit.model import chebyshev, convolution, scaled, zonal
from oracles import convolution as o_convolution
from oracles import zonal as o_zonal
from scipy.special import gammaincinv

SEED = 20261121
ANGLES = jnp.asarray(((np.arange(90) + 0.5) / 90) ** 2 * np.pi / 2)  # MERL's half angles
TIERS = [zonal.convolve, scaled.convolve]


def j(*numbers):
    """JAX arrays of numbers."""
    return [jnp.asarray(x, dtype=float) for x in numbers]


def draw(count, low, high, seed=SEED):
    """Random (B, c, beta, p), one column each, log-uniform, c in c - 1."""
    low, high = np.array(low) - [0, 1, 0, 0], np.array(high) - [0, 1, 0, 0]
    return low * (high / low) ** np.random.default_rng(seed).uniform(size=(count, 4)) + [0, 1, 0, 0]


@jax.jit
def truth(lobes):
    """The quadrature at MERL's half angles, one row a lobe."""
    return jax.lax.map(lambda x: convolution.convolve(ANGLES, *x, 64), lobes)


# --- Zonal harmonics


DEGREES = [0, 1, 2, 9, 30, 61, 100, 149, 200]
NORMALS = [(1e-3, 0.2), (1e-3, 5.0), (0.03, 1.0), (0.1, 5.0), (0.3, 0.5), (1.0, 0.2), (1.0, 5.0)]
LOBES = [(1e3, 1.01), (1e3, 6.0), (30.0, 1.5), (1.0, 2.0), (0.0, 3.0)]


def moments(function):
    """The oracle's coefficients without the factor of Y_l."""
    return np.array([
        o_zonal.coefficient(function, k) / (2 * math.pi * math.sqrt((2 * k + 1) / (4 * math.pi))) for k in DEGREES
    ])  # fmt: skip


def test_the_oracle_knows_moments_in_closed_form():
    # Int_0^1 x^2 P_l dx
    np.testing.assert_allclose(moments(o_zonal.lobe(0.0, 3.0))[:3], [1 / 3, 1 / 4, 2 / 15], rtol=1e-12)


@pytest.mark.parametrize(("beta", "p"), NORMALS)
def test_moments_of_the_normals_to_2e_8(beta, p):
    found = np.asarray(zonal.normal_moments(*j(beta, p), DEGREES[-1]))[DEGREES]
    expected = moments(o_zonal.normals(beta, p))
    assert np.max(np.abs(found - expected)) < 2e-8 * expected[0]


@pytest.mark.parametrize(("B", "c"), LOBES)
def test_moments_of_the_lobe_to_1e_10(B, c):
    found = np.asarray(zonal.lobe_moments(*j(B, c), DEGREES[-1]))[DEGREES]
    expected = moments(o_zonal.lobe(B, c))
    assert np.max(np.abs(found - expected)) < 1e-10 * expected[0]


def test_moment_checks_reject_a_cosine_too_many_or_too_few():
    def projected(t):
        return o_zonal.normals(0.3, 0.5)(t) / np.sqrt(1 + np.exp(2 * t))

    def without_cosines(t):
        return o_zonal.lobe(1.0, 2.0)(t) * (1 + np.exp(2 * t))

    found = np.asarray(zonal.normal_moments(*j(0.3, 0.5), DEGREES[-1]))[DEGREES]
    assert np.max(np.abs(found - moments(projected))) > 1e-2 * found[0]
    found = np.asarray(zonal.lobe_moments(*j(1.0, 2.0), DEGREES[-1]))[DEGREES]
    assert np.max(np.abs(found - moments(without_cosines))) > 1e-2 * found[0]


SERIES = [(5.0, 2.0, 0.2, 1.0, 30), (80.0, 1.3, 0.02, 0.5, 40), (0.3, 4.0, 1.0, 3.0, 1), (2.0, 2.0, 0.5, 0.7, 0)]


@pytest.mark.parametrize("case", SERIES)
def test_truncated_sum_to_1e_8(case):
    *lobe, order = case
    theta_h = np.linspace(0, np.pi / 2, 13)
    found = np.asarray(zonal.convolve(*j(theta_h, *lobe), order))
    expected = o_zonal.truncated(theta_h, *lobe, order)
    scale = np.max(np.abs(expected))
    assert np.max(np.abs(found - expected)) < 1e-8 * scale
    # Eq. 64 without sqrt(4 pi/(2 l + 1)): orthonormal coefficients multiplied as if they were Fourier's
    wrong = sum(
        o_zonal.coefficient(o_zonal.lobe(*lobe[:2]), k)
        * o_zonal.coefficient(o_zonal.normals(*lobe[2:]), k)
        * o_zonal.harmonic(k, np.cos(theta_h))
        for k in range(order + 1)
    )
    assert np.max(np.abs(found - wrong)) > 1e-2 * scale


def test_series_of_smooth_lobes_tends_to_the_integral():
    for B, c, beta, p in [(1.0, 2.0, 0.3, 1.0), (4.0, 1.2, 0.1, 2.0), (0.5, 5.0, 1.0, 0.6)]:
        theta_h = np.linspace(0, 1.5, 7)
        found = np.asarray(zonal.convolve(*j(theta_h, B, c, beta, p), 200))
        expected = np.array([o_convolution.convolve(x, B, c, beta, p) for x in theta_h])
        # the horizon of S leaves terms like l^-5 or so
        np.testing.assert_allclose(found, expected, rtol=1e-5)


def zonal_errors(lobes, order):
    """Error in units of the peak, and relative error, of every lobe (rows) at MERL's half angles."""
    found = np.asarray(jax.jit(lambda x: jax.lax.map(lambda y: zonal.convolve(ANGLES, *y, order), x))(lobes))
    expected = np.asarray(truth(lobes))
    return np.abs(found - expected) / expected.max(1, keepdims=True), np.abs(found / expected - 1)


def test_order_100_fails_for_sharp_lobes_as_stated():
    """physics.md: over 100 random lobes the error reaches 44 % of the peak, its 95th percentile is 1700 % relative.

    Both depend on the draw; `python -m tests.zonal_failure` has the spread over twenty.
    """
    lobes = draw(400, (0.1, 1.03, 0.003, 0.2), (200, 5, 1, 5))
    absolute, relative = zonal_errors(lobes, 100)
    worst = absolute.max(1).reshape(4, 100).max(1)
    assert np.all(worst > 0.35)
    assert np.median(worst) > 0.44
    high = np.quantile(relative.reshape(4, -1), 0.95, axis=1)
    assert high.max() > 17
    assert np.median(absolute) < 1e-5  # most lobes are wide, and those are right


@pytest.mark.parametrize("order", [25, 100])
def test_an_order_of_eight_times_B_is_safe_and_one_is_not(order):
    surfaces = (0.003, 0.2), (1, 5)
    safe = draw(150, (0.1, 1.03, *surfaces[0]), (order / 8, 5, *surfaces[1]))
    assert zonal_errors(safe, order)[0].max() < 1e-2
    unsafe = draw(60, (order, 1.03, *surfaces[0]), (order * 1.001, 5, *surfaces[1]))
    assert zonal_errors(unsafe, order)[0].max() > 0.3


def test_negative_values_of_the_truncated_sum_are_kept():
    assert np.min(zonal.convolve(ANGLES, *j(300.0, 3.0, 0.003, 1.0), 50)) < 0


def test_zonal_needs_no_memory_for_grid_times_degrees():
    theta_h, B = jnp.linspace(0, 1.5, 90)[:, None, None], jnp.linspace(0.1, 40, 270).reshape(3, 1, 90, 1)
    compiled = jax.jit(lambda *x: zonal.convolve(*x, 100)).lower(theta_h, B, *j(2, 0.1, 1)).compile()
    memory = compiled.memory_analysis()
    degrees_times_grid = 101 * 90 * 270 * 8
    assert memory.temp_size_in_bytes < degrees_times_grid / 3
    assert compiled(theta_h, B, *j(2, 0.1, 1)).shape == (3, 90, 90, 1)


# --- The scaled lobe


LOW, HIGH = np.array(scaled.RANGE).T * [2, 1, 1, 1]


@pytest.fixture(scope="module")
def table(compilation_cache):
    """The real table, kept with the compiled programs; its name changes with the code that makes it."""
    before = scaled._folder
    scaled.keep_in(os.environ["MERLFIT_CACHE_DIR"])
    yield scaled.table()
    scaled.keep_in(before)


@pytest.fixture
def small(monkeypatch, tmp_path):
    """A table of few nodes, in a folder of its own."""
    before = scaled._folder
    monkeypatch.setattr(scaled, "NODES", (4, 3, 3, 3))
    scaled.keep_in(tmp_path / "tables")
    yield tmp_path / "tables"
    scaled.keep_in(before)


def lobes_in_range(count, seed=SEED):
    lobes = draw(count, (0.01, *LOW[1:]), HIGH, seed)
    widest = np.minimum(1, scaled.widest_beta(lobes[:, 3]))
    lobes[:, 2] = LOW[2] * (widest / LOW[2]) ** (np.log(lobes[:, 2] / LOW[2]) / np.log(HIGH[2] / LOW[2]))
    return lobes


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


INSIDE = {"B": 3.0, "c": 2.0, "beta": 0.2, "p": 1.0}
OUTSIDE = [
    {"B": 2.01 * 455}, {"c": 1.005}, {"c": 6.5}, {"beta": 5e-4}, {"beta": 1.2}, {"p": 0.15}, {"p": 6.0},
    {"beta": 0.5, "p": 0.25},
]  # fmt: skip


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


def test_table_is_kept_and_read_again(small, monkeypatch):
    made = scaled.table()
    (path,) = small.iterdir()
    assert path.suffix == ".npz"
    assert made.shape == (2, 4, 3, 3, 3)
    scaled.keep_in(small)  # forgets what is in memory
    monkeypatch.setattr(scaled, "_build", lambda: pytest.fail("made again"))
    np.testing.assert_array_equal(scaled.table(), made)


def broken(path, how):
    data = path.read_bytes()
    if how == "cut short":
        path.write_bytes(data[: len(data) // 2])
    elif how == "no archive":
        path.write_bytes(b"nothing of the kind")
    elif how == "one bit":
        middle = len(data) // 2
        path.write_bytes(data[:middle] + bytes([data[middle] ^ 1]) + data[middle + 1 :])
    elif how == "other shape":
        np.savez(path, table=np.zeros((2, 3, 3, 3, 3)))
    elif how == "not finite":
        np.savez(path, table=np.full((2, 4, 3, 3, 3), np.nan))
    else:
        np.savez(path, other=np.zeros(3))


@pytest.mark.parametrize("how", ["cut short", "no archive", "one bit", "other shape", "not finite", "other name"])
def test_broken_file_is_made_anew(small, how):
    made = scaled.table()
    (path,) = small.iterdir()
    broken(path, how)
    scaled.keep_in(small)
    np.testing.assert_array_equal(scaled.table(), made)
    assert [x.name for x in small.iterdir()] == [path.name]
    with np.load(path) as file:
        np.testing.assert_array_equal(file["table"], made)


def test_file_of_other_code_is_not_read(small, monkeypatch):
    name, read = scaled._file_name(), Path.read_bytes
    for changed in ("scaled", "convolution"):
        with monkeypatch.context() as patch:
            patch.setattr(Path, "read_bytes", lambda path: read(path) + b"#" * (path.stem == changed))
            assert scaled._file_name() != name


def test_table_can_be_made_while_a_program_is_traced(small):
    values = j(0.3, *INSIDE.values())
    traced = jax.jit(scaled.convolve)(*values)
    assert isinstance(scaled.table(), np.ndarray)
    np.testing.assert_allclose(traced, scaled.convolve(*values), rtol=1e-12)


# --- Both


def logarithmic(tier):
    """The tier as a function of theta_h and log B, log(c - 1), log beta, log p."""
    return lambda x: tier(x[0], jnp.exp(x[1]), 1 + jnp.exp(x[2]), jnp.exp(x[3]), jnp.exp(x[4]))


@pytest.mark.parametrize("tier", TIERS)
def test_gradients_against_differences(table, tier):
    lobes = lobes_in_range(12, SEED + 1)
    lobes[:, 0] = np.minimum(lobes[:, 0], 50)  # where the zonal sum is above its rounding errors
    theta_h = np.random.default_rng(SEED).uniform(0.02, 1.5, len(lobes))
    x = np.column_stack([theta_h, np.log(lobes[:, 0]), np.log(lobes[:, 1] - 1), np.log(lobes[:, 2:])])
    value = logarithmic(tier)
    forward, reverse = (np.asarray(jax.jit(partial(jax.lax.map, d(value)))(x)) for d in (jax.jacfwd, jax.jacrev))
    scale = 1e-3 + np.abs(forward).max(1, keepdims=True)
    assert np.max(np.abs(reverse - forward) / scale) < 1e-9
    batch, h = jax.jit(partial(jax.lax.map, value)), 1e-5
    for k in range(5):
        step = h * np.eye(5)[k]
        difference = (np.asarray(batch(x + step)) - np.asarray(batch(x - step))) / (2 * h)
        assert np.max(np.abs(forward[:, k] - difference) / scale[:, 0]) < 1e-5


@pytest.mark.parametrize("tier", TIERS)
def test_values_and_gradients_are_finite_at_every_edge(table, tier):
    def total(theta_h, B, *rest):
        return jnp.sum(tier(theta_h, B, *rest))

    theta_h, B = jnp.array([0.0, 1e-9, np.pi / 2])[:, None], jnp.array([0.0, 1e-6, 1.0, 910.0])
    both = jax.jit(lambda *x: (tier(*x), jax.grad(total, argnums=(0, 1, 2, 3, 4))(*x)))
    for corner in [(1.01, 1e-3, 0.2), (6.0, 1.0, 5.0), (1.01, 1.0, 5.0), (6.0, 1e-3, 0.2), (2.0, 1.5, 0.15)]:
        value, slopes = both(theta_h, B, *j(*corner))
        assert np.all(np.isfinite(value))
        assert all(np.all(np.isfinite(x)) for x in slopes), corner


@pytest.mark.parametrize("tier", TIERS)
@pytest.mark.parametrize("beta", [0.1, 1.5])
def test_grid_and_list_agree(table, tier, beta):
    theta_h, B = jnp.linspace(0, 1.5, 7)[:, None, None], jnp.geomspace(0.1, 60, 33).reshape(3, 1, 11, 1)
    grid = tier(theta_h, B, *j(2.0, beta, 0.8))
    assert grid.shape == (3, 7, 11, 1)
    listed = tier(*(x.ravel() for x in jnp.broadcast_arrays(theta_h, B)), *j(2.0, beta, 0.8))
    np.testing.assert_allclose(grid.ravel(), listed, rtol=1e-10, atol=1e-13)
    single = tier(theta_h[3, 0, 0], B[1, 0, 5, 0], *j(2.0, beta, 0.8))
    np.testing.assert_allclose(single, grid[1, 3, 5, 0], rtol=1e-10)


@pytest.mark.parametrize("tier", TIERS)
def test_float32_in_gives_float32_out(table, tier):
    values = [jnp.asarray(x, jnp.float32) for x in (ANGLES, *INSIDE.values())]
    found = tier(*values)
    assert found.dtype == jnp.float32
    np.testing.assert_allclose(found, tier(*j(ANGLES, *INSIDE.values())), rtol=1e-3, atol=1e-6)


def test_chebyshev_nodes_of_the_table_lie_inside_the_range():
    lobes = [x.ravel() for x in scaled._parameters(*np.meshgrid(*(chebyshev.nodes(n) for n in scaled.NODES)))]
    low, high = (edge(np.array(lobes), axis=1) for edge in (np.min, np.max))
    assert np.all(low > LOW)
    assert np.all(high[[0, 1, 3]] < HIGH[[0, 1, 3]])
    assert np.all(lobes[2] < scaled.widest_beta(lobes[3]))
