"""The oracles against each other, against closed forms and limits; and each check against a formula it must reject."""

import math

import mpmath as mp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import dblquad, quad

from tests.oracles import bodies, convolution, diffraction, facets, fresnel, masking, ndf, two_scale

few = settings(derandomize=True, max_examples=25, deadline=None, database=None)
angles = st.floats(0.0, 1.55)
indices = st.tuples(st.floats(0.05, 4.0), st.floats(0.0, 8.0)).filter(lambda nk: abs(complex(*nk) - 1) > 0.05)


def rejects(check, wrong):
    """The check fails on the wrong formula."""
    with pytest.raises(AssertionError):
        check(wrong)


# --- Fresnel and Rayleigh-Rice


def check_fresnel(reflectance):
    n, k = 0.2, 3.4
    assert reflectance(1.0, n, k) == pytest.approx(((n - 1) ** 2 + k**2) / ((n + 1) ** 2 + k**2), rel=1e-14)
    assert reflectance(0.0, n, k) == pytest.approx(1, abs=1e-14)
    brewster = math.atan(1.5)  # only the s state is reflected, sin^2(theta_i - theta_t) of it
    refracted = math.pi / 2 - brewster
    assert reflectance(math.cos(brewster), 1.5, 0.0) == pytest.approx(
        math.sin(brewster - refracted) ** 2 / 2, rel=1e-14
    )
    assert reflectance(math.cos(0.8), 1 / 1.5, 0.0) == pytest.approx(1, abs=1e-14)  # past the critical angle


def test_fresnel_has_its_known_values():
    check_fresnel(fresnel.fresnel)


def test_fresnel_check_rejects_eta_for_eta_squared():
    def wrong(cosine, n, k):
        eta = complex(n, k)
        inner = np.sqrt(eta**2 - 1 + cosine**2 + 0j)
        f_s, f_p = (abs((factor * cosine - inner) / (factor * cosine + inner)) ** 2 for factor in (1, eta))
        return (f_s + f_p) / 2

    rejects(check_fresnel, wrong)


@given(theta=angles, nk=indices)
@few
def test_q_is_twice_fresnel_in_the_mirror_direction(theta, nk):
    assert fresnel.rayleigh_rice_q(theta, theta, 0.0, *nk) == pytest.approx(
        2 * fresnel.fresnel(math.cos(theta), *nk), rel=1e-10
    )


def test_q_changes_when_its_last_sign_does():
    def check(sign):
        theta, n, k = 0.9, 1.5, 0.0
        eta2, cosine, sine2 = n**2, math.cos(theta), math.sin(theta) ** 2
        inner = math.sqrt(eta2 - sine2)
        q_ss = (eta2 - 1) / (cosine + inner) ** 2
        q_pp = (eta2 - 1) / (eta2 * cosine + inner) ** 2 * (inner**2 + sign * eta2 * sine2)
        assert q_ss**2 + q_pp**2 == pytest.approx(2 * fresnel.fresnel(cosine, n, k), rel=1e-12)

    check(-1)
    rejects(check, 1)


@given(theta_i=angles, theta_o=angles, phi=st.floats(-math.pi, math.pi), nk=indices)
@few
def test_q_is_reciprocal(theta_i, theta_o, phi, nk):
    there = fresnel.rayleigh_rice_q(theta_i, theta_o, phi, *nk)
    assert fresnel.rayleigh_rice_q(theta_o, theta_i, phi, *nk) == pytest.approx(there, rel=1e-10)


# --- Microfacet normals


def check_normalised(density):
    for beta, p in [(1e-4, 0.12), (0.1, 1.0), (2.0, 5.0)]:
        assert ndf.normalisation(beta, p, density) == pytest.approx(1, abs=1e-12)


def test_epd_is_normalised():
    check_normalised(ndf._epd)


def test_normalisation_rejects_one_cosine_less():
    rejects(check_normalised, lambda theta, beta, p: ndf._epd(theta, beta, p) * mp.cos(theta))


@pytest.mark.parametrize(
    ("theta", "beta", "p"), [(0.0, 0.1, 0.5), (0.3, 0.2, 2.0), (1.4, 1.0, 0.12), (0.001, 1e-3, 5.0)]
)
def test_the_two_writings_of_the_epd_agree(theta, beta, p):
    slopes = math.exp(convolution.log_p22(math.tan(theta) ** 2, beta, p)) / math.cos(theta) ** 4
    assert ndf.epd(theta, beta, p) == pytest.approx(slopes, rel=1e-12)


# --- Masking

LAMBDA_TABLE = [(0.1, 0.5), (0.3, 1.0), (0.5, 2.0), (1.0, 0.12), (1.0, 5.0), (10.0, 0.3), (1e3, 2.0), (1e5, 0.12)]


def check_lambda(function):
    for tau, p in LAMBDA_TABLE:
        assert function(tau, p) == pytest.approx(masking.smith_lambda_single(tau, p), rel=1e-11)
    for tau in (0.1, 0.3, 1.0, 10.0, 1e4):
        assert function(tau, 1.0) == pytest.approx(masking.beckmann_lambda(tau), rel=1e-12)


def test_lambda_by_two_integrals_one_integral_and_in_closed_form():
    check_lambda(masking.smith_lambda)


def test_lambda_check_rejects_the_printed_half_line():
    def half(r, p, step):
        return masking.slope_marginal(r, p, step) / 2

    rejects(check_lambda, lambda tau, p: masking.smith_lambda(tau, p, half))


@pytest.mark.parametrize(("tau", "p"), LAMBDA_TABLE)
def test_lambda_has_converged_in_its_step(tau, p):
    assert masking.smith_lambda(tau, p, refine=2) == pytest.approx(masking.smith_lambda(tau, p), rel=1e-11)


def test_slope_marginal_against_adaptive_quadrature():
    for r, p in [(0.01, 0.5), (0.7, 0.3), (0.9, 5.0)]:
        bulk, _ = quad(lambda q, r=r, p=p: math.exp(-((r * r + q * q) ** p)), -1, 1, epsabs=0, epsrel=1e-11, limit=200)
        tail, _ = quad(
            lambda q, r=r, p=p: math.exp(-((r * r + q * q) ** p)), 1, np.inf, epsabs=0, epsrel=1e-11, limit=400
        )
        expected = p / (math.pi * math.gamma(1 / p)) * (bulk + 2 * tail)
        assert masking.slope_marginal([r], p)[0] == pytest.approx(expected, rel=1e-10)


# --- Diffraction lobe


def check_renormalisation(function):
    for s in (0.0, 0.3, 0.999, 1.0):
        for kappa in (0.1, 3.0, 1e4):
            for c in (1.01, 2.0, 6.0):
                expected = diffraction.renormalisation_rings(s, kappa, c)
                assert function(s, kappa, c) == pytest.approx(expected, rel=1e-11)


def test_renormalisation_over_the_disc_is_that_over_rings_about_the_lobe():
    check_renormalisation(diffraction.renormalisation)


def test_renormalisation_check_rejects_the_whole_plane_and_the_inner_disc():
    rejects(check_renormalisation, lambda s, kappa, c: 1.0)
    rejects(check_renormalisation, lambda s, kappa, c: 1 - (1 + (kappa * (1 - s)) ** 2) ** (-(c - 1) / 2))


def check_lobe_energy(lobe):
    """The renormalised lobe spends exactly one over the outgoing hemisphere: int cos_o dw_o = int over the disc."""
    wavelength, b, c, theta = 0.526, 0.9, 1.7, 0.6
    ratio = diffraction.renormalisation(math.sin(theta), b / wavelength, c)
    total, _ = dblquad(
        lambda y, x: lobe(math.hypot(x - math.sin(theta), y) / wavelength, wavelength, b, c, ratio),
        -1,
        1,
        lambda x: -math.sqrt(1 - x * x),
        lambda x: math.sqrt(1 - x * x),
        epsabs=1e-9,
        epsrel=1e-9,
    )
    assert total == pytest.approx(1, abs=1e-7)


def test_lobe_integrates_to_one_over_outgoing_directions():
    check_lobe_energy(diffraction.s_hs)


def test_lobe_energy_rejects_the_printed_spectrum():
    # Eq. 16 with its sigma_s^2 and without 1/lambda^2
    rejects(
        check_lobe_energy, lambda f, wavelength, *rest: diffraction.s_hs(f, wavelength, *rest) * wavelength**2 * 0.03**2
    )


# --- Convolution: (theta_h, B, c, beta, p)

BENIGN = [(0.0, 1.0, 1.5, 1.0, 2.0), (0.3, 5.0, 2.0, 0.3, 1.0), (1.2, 10.0, 3.0, 0.5, 0.7)]
HARSH = [
    (0.7778, 8.2, 1.95, 5e-3, 0.32),
    (math.pi / 2, 5300.0, 1.006, 0.456, 0.48),
    (1e-6, 2e4, 8.0, 1e-4, 5.0),
]
EXTREME = [(theta, B, c, beta, p) for theta in (0.5, 1.5) for B in (1e-3, 2e4) for c in (1.001, 8.0)
           for beta in (1e-4, 2.0) for p in (0.12, 5.0)]  # fmt: skip


@pytest.mark.parametrize("case", BENIGN)
def test_convolution_on_a_plain_grid(case):
    assert convolution.convolve_brute(*case) == pytest.approx(convolution.convolve(*case), rel=1e-6)


@pytest.mark.parametrize("case", HARSH)
def test_convolution_in_the_frame_of_the_half_vector(case):
    assert convolution.convolve_about_h(*case) == pytest.approx(convolution.convolve(*case), rel=1e-8)


@pytest.mark.parametrize("case", EXTREME)
def test_convolution_does_not_depend_on_its_azimuth_rule(case, monkeypatch):
    expected = convolution.convolve(*case)
    rule = convolution.warped
    monkeypatch.setattr(convolution, "warped", lambda *ends: rule(*ends, panels=29, order=20))
    assert convolution.convolve(*case) == pytest.approx(expected, rel=1e-9)


def check_pole(function):
    """At theta_h = 0 the convolution is one integral over theta: 2 pi Int S D sin."""
    for B, c, beta, p in [
        (1e-3, 2.0, 2.0, 0.12),
        (2e4, 1.001, 1e-4, 0.12),
        (30.0, 8.0, 0.1, 5.0),
        (2e4, 3.0, 1.0, 0.5),
    ]:
        with mp.workdps(25):

            def integrand(t, B=B, c=c, beta=beta, p=p):
                theta = mp.atan(mp.exp(t))
                s = (1 + (B * mp.sin(theta)) ** 2) ** (-mp.mpf(c + 1) / 2) * mp.cos(theta) ** 2
                return 2 * mp.pi * s * ndf._epd(theta, mp.mpf(beta), mp.mpf(p)) * mp.sin(theta) ** 2 * mp.cos(theta)

            expected = float(mp.quad(integrand, [*range(-45, 30, 3), 30]))
        assert function(0.0, B, c, beta, p) == pytest.approx(expected, rel=1e-9)


def test_convolution_at_the_pole():
    check_pole(convolution.convolve)


def test_pole_rejects_a_foreshortened_density_and_a_missing_cosine():
    def foreshortened(*case):
        def ring(theta_m, sin_m, cos_m, *rest):
            return cos_m * convolution.ring_of_s(theta_m, sin_m, cos_m, *rest)

        return convolution.convolve(*case, ring=ring)

    def without_cosine(*case):
        def ring(theta_m, sin_m, cos_m, theta_h, B, c):  # right at the pole alone
            return 2 * math.pi * (1 + (B * sin_m) ** 2) ** (-(c + 1) / 2)

        return convolution.convolve(*case, ring=ring)

    rejects(check_pole, foreshortened)
    rejects(check_pole, without_cosine)


@pytest.mark.parametrize(("theta_h", "B", "c"), [(0.0, 5.0, 2.0), (0.4, 3.0, 1.3), (1.3, 20.0, 4.0)])
def test_a_narrow_density_leaves_the_lobe_alone(theta_h, B, c):
    lobe = (1 + (B * math.sin(theta_h)) ** 2) ** (-(c + 1) / 2) * math.cos(theta_h) ** 2
    assert convolution.convolve(theta_h, B, c, 1e-4, 1.5) == pytest.approx(lobe, rel=1e-5)


@pytest.mark.parametrize(("beta", "p"), [(0.01, 0.5), (0.5, 1.0), (2.0, 3.0)])
def test_a_wide_lobe_leaves_the_squared_cosine(beta, p):
    def integrand(t):
        theta = math.atan(math.exp(t))
        return ndf.epd(theta, beta, p) * math.sin(theta) ** 2 * math.cos(theta) ** 3

    expected = 2 * math.pi * quad(integrand, -25, 12, points=[math.log(beta)], epsabs=0, epsrel=1e-10, limit=200)[0]
    assert convolution.convolve(0.0, 1e-6, 2.0, beta, p) == pytest.approx(expected, rel=1e-8)


# --- Bodies


@pytest.mark.parametrize("eta", [1.05, 1.3, 1.5, 2.5])
def test_diffuse_reflectances_obey_etendue_and_the_closed_form(eta):
    inside, outside = bodies.internal_diffuse_reflectance(eta), bodies.external_diffuse_reflectance(eta)
    assert eta**2 * (1 - inside) == pytest.approx(1 - outside, rel=1e-12)
    assert outside == pytest.approx(bodies.external_diffuse_reflectance_closed(eta), rel=1e-10)


def test_no_interface_reflects_nothing():
    assert bodies.internal_diffuse_reflectance(1.0) == pytest.approx(0, abs=1e-15)


def plastic_as_printed(theta_i, theta_o, eta, rho_d):
    """HP17 Eq. 43."""
    f_dr = bodies.internal_diffuse_reflectance(eta)
    return bodies.transmission(theta_i, theta_o, eta) * rho_d / math.pi / (1 - rho_d / math.pi * f_dr)


def check_plastic(brdf):
    for theta_i, eta, rho_d in [(0.0, 1.5, 0.8), (1.2, 1.3, 0.5), (0.6, 2.0, 1.0)]:
        surface, escaped, absorbed = bodies.plastic_layers(theta_i, eta, rho_d)
        assert surface + escaped + absorbed == pytest.approx(1, rel=1e-12)
        reflected = bodies.albedo(lambda i, o, eta=eta, rho_d=rho_d: brdf(i, o, eta, rho_d), theta_i)
        assert reflected == pytest.approx(escaped, rel=1e-8)


def test_plastic_spends_what_its_layers_let_out():
    check_plastic(bodies.plastic)


def test_plastic_check_rejects_the_printed_series():
    rejects(check_plastic, plastic_as_printed)


def check_boundary(factor):
    """With phi = 2 A D phi' at the surface, the interface returns F_dr of the diffuse flux that reaches it."""
    for f_dr in (0.0, 0.2, 0.6):
        fluence = 2 / 3 * factor(f_dr)  # in units of 3 D phi'
        # radiance along mu (into the medium positive): fluence - mu, up to 1/(4 pi)
        up, _ = quad(lambda mu, a=fluence: (a + mu) * mu, 0, 1)
        down, _ = quad(lambda mu, a=fluence: (a - mu) * mu, 0, 1)
        assert down == pytest.approx(f_dr * up, abs=1e-12)


def test_boundary_factor_balances_the_flux():
    check_boundary(bodies.boundary_factor)


def test_boundary_check_rejects_the_printed_inverse():
    rejects(check_boundary, lambda f_dr: (1 - f_dr) / (1 + f_dr))


def test_subsurface_is_the_dipole_integrated_over_the_surface():
    alpha, eta, theta = 0.9, 1.4, 0.5
    boundary = bodies.boundary_factor(bodies.internal_diffuse_reflectance(eta))
    decay = math.sqrt(3 * (1 - alpha))  # reduced extinction 1
    total = 0.0
    for z in (1.0, 1 + 4 / 3 * boundary):

        def dipole(r, z=z):
            d = math.hypot(r, z)
            return z * (decay + 1 / d) * math.exp(-decay * d) / d**2 * r

        total += alpha / 2 * quad(dipole, 0, np.inf, epsrel=1e-10)[0]
    transmitted = bodies.transmission(theta, theta, eta)
    inner = math.sqrt(1 - (math.sin(theta) / eta) ** 2)
    expected = transmitted * (total / math.pi + alpha / (8 * math.pi * inner))
    assert bodies.subsurface(theta, theta, eta, alpha) == pytest.approx(expected, rel=1e-9)


# --- The assembled model

METAL = two_scale.Material(beta=0.4, p=0.8, b=0.8, c=2.2, sigma_s=0.05, n=0.3, k=3.0)
PAIRS = [(0.5, 0.9, 2.5), (1.2, 1.2, 0.3), (0.0, 1.0, 0.0), (0.4, 0.4, math.pi)]


def vectors(theta_i, theta_o, phi):
    return facets.direction(theta_i, 0.2), facets.direction(theta_o, 0.2 + phi)


@pytest.mark.parametrize("pair", PAIRS)
def test_assembled_model_is_reciprocal(pair):
    i, o = vectors(*pair)
    for evaluate in (two_scale.brdf, two_scale.exact_ctd):
        assert evaluate(i, o, 0.526, METAL) == pytest.approx(evaluate(o, i, 0.526, METAL), rel=1e-8)


def test_a_smooth_nanogeometry_leaves_cook_torrance_and_the_body():
    i, o = vectors(0.4, 0.6, 3.0)
    smooth = METAL._replace(sigma_s=1e-9)
    assert two_scale.brdf(i, o, 0.526, smooth, body=0.1) == pytest.approx(
        two_scale.reflection_lobe(i, o, smooth) + 0.1, rel=1e-12
    )


def test_facets_that_both_directions_see_make_the_convolution():
    # p = 5 ends D abruptly: no facet turned away from either direction
    i, o = vectors(0.5, 0.7, 2.0)
    theta_h = facets.geometry(i, o).theta_h
    value = facets.facet_integral(i, o, 12.0, 1.6, 0.2, 5.0, lambda i_m, o_m, h_m: h_m**2)
    assert value == pytest.approx(convolution.convolve(theta_h, 12.0, 1.6, 0.2, 5.0), rel=1e-9)


@pytest.mark.parametrize("pair", PAIRS)
def test_flat_microgeometry_is_one_facet(pair):
    """beta -> 0: the diffraction lobe of HP17 Eq. 6, its angles to n."""
    i, o = vectors(*pair)
    flat = METAL._replace(beta=1e-4, p=2.0)
    cos_d = facets.geometry(i, o).cos_d
    ratio = two_scale.relative_variance(cos_d, 0.526, flat)
    share = math.exp(-((2 * math.pi * flat.sigma_s / 0.526 * (i[2] + o[2])) ** 2) * ratio)
    f = np.hypot(*(i + o)[:2]) / 0.526
    q = fresnel.rayleigh_rice_q(pair[0], pair[1], pair[2] - math.pi, flat.n, flat.k) / 2
    expected = q * (1 - share) * diffraction.s_hs(f, 0.526, flat.b, flat.c, ratio)
    assert two_scale.exact_ctd(i, o, 0.526, flat) == pytest.approx(expected, rel=1e-5)
    assert two_scale.exact_ctd(i, o, 0.526, flat, colour_frame="surface") == pytest.approx(expected, rel=1e-5)


def exact_on_a_grid(i, o, wavelength, material, frequency_per=None, size=(500, 1000)):
    """HP17 Eq. 27 facet by facet on a plain grid, in vectors; frequency_per is the length f is divided by."""
    per = wavelength if frequency_per is None else frequency_per
    theta = ((np.arange(size[0]) + 0.5) / size[0] * math.pi / 2)[:, None]
    phi = ((np.arange(size[1]) + 0.5) / size[1] * 2 * math.pi)[None, :]
    m = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta) + 0 * phi])
    i_m, o_m = np.tensordot(i, m, 1), np.tensordot(o, m, 1)
    off_m = [v[:, None, None] - dot * m for v, dot in ((i, i_m), (o, o_m))]
    f = np.linalg.norm(off_m[0] + off_m[1], axis=0) / per
    cos_phi = -np.sum(off_m[0] * off_m[1], axis=0) / np.maximum(
        np.prod([np.linalg.norm(v, axis=0) for v in off_m], axis=0), 1e-30
    )
    q = fresnel.q_from_cosines(i_m, o_m, np.clip(cos_phi, -1, 1), material.n, material.k) / 2
    g = facets.geometry(i, o)
    ratio = two_scale.relative_variance(g.cos_d, wavelength, material)
    share = np.exp(-((2 * np.pi * material.sigma_s / wavelength * (i_m + o_m)) ** 2) * ratio)
    d = np.exp(convolution.log_p22(np.tan(theta) ** 2, material.beta, material.p)) / np.cos(theta) ** 4 * np.sin(theta)
    lobe = (1 - share) * q * diffraction.s_hs(f, wavelength, material.b, material.c, ratio)
    lit = np.maximum(i_m, 0) * np.maximum(o_m, 0) / (i[2] * o[2])
    cell = math.pi / 2 / size[0] * 2 * math.pi / size[1]
    return two_scale.masking(g, material) * float(np.sum(lit * lobe * d)) * cell


def check_exact(i, o, grid):
    assert two_scale.exact_ctd(i, o, 0.526, METAL) == pytest.approx(grid, rel=2e-5)


@pytest.mark.parametrize("pair", PAIRS)
def test_exact_lobe_on_a_plain_grid_of_facets(pair):
    i, o = vectors(*pair)
    check_exact(i, o, exact_on_a_grid(i, o, 0.526, METAL))


def test_exact_check_rejects_a_frequency_without_wavelength():
    i, o = vectors(0.5, 0.9, 2.5)
    rejects(lambda per: check_exact(i, o, exact_on_a_grid(i, o, 0.526, METAL, per)), 1.0)


def test_the_approximation_is_near_the_exact_lobe_at_small_angles():
    gentle = METAL._replace(beta=0.05, p=1.0)
    i, o = vectors(0.3, 0.35, math.pi)
    assert two_scale.diffraction_lobe(i, o, 0.526, gentle) == pytest.approx(
        two_scale.exact_ctd(i, o, 0.526, gentle), rel=0.02
    )


def test_an_unknown_colour_frame_is_refused():
    i, o = vectors(*PAIRS[0])
    with pytest.raises(ValueError, match="colour_frame"):
        two_scale.exact_ctd(i, o, 0.526, METAL, colour_frame="half")
