"""The microfacet family: distributions and maskings against their definitions, and the limits between them."""

import math

import jax
import numpy as np
import pytest
from merlfit.model.ndf import beckmann, sgd
from merlfit.model.parameters import WAVELENGTHS_UM
from merlfit.model.rivals.beckmann import Beckmann
from merlfit.model.rivals.epd import EPD
from merlfit.model.rivals.ggx import GGX
from merlfit.model.rivals.gtr import GTR
from merlfit.model.rivals.sgd_microfacet import SGDMicrofacet
from merlfit.model.rivals.student_t import StudentT
from merlfit.model.two_scale import TwoScale

from tests.oracles import microfacets as oracle
from tests.oracles.diffraction import renormalisation, s_hs
from tests.oracles.facets import direction
from tests.oracles.fresnel import q_from_cosines
from tests.oracles.two_scale import mirror_cosine
from tests.support.compiled import evaluate, from_vectors

COLOURS = {"F0": np.array([0.9, 0.3, 0.04]), "albedo": np.array([0.02, 0.1, 0.3])}
CASES = {  # widths, the oracle's D, a typical slope, accuracy of our masking
    "beckmann": (Beckmann(), {"roughness": 0.3}, oracle.beckmann, 0.3, 1e-8),
    "beckmann, wide": (Beckmann(), {"roughness": 1.2}, oracle.beckmann, 1.2, 1e-8),
    "ggx": (GGX(), {"alpha": 0.2}, oracle.ggx, 0.2, 1e-8),
    "gtr": (GTR(), {"alpha": 0.2, "gamma": 1.5}, oracle.gtr, 0.2, 2e-7),
    "gtr, heavy tail": (GTR(), {"alpha": 0.05, "gamma": 0.6}, oracle.gtr, 0.3, 2e-7),
    "gtr, narrow with a heavy tail": (GTR(), {"alpha": 1e-3, "gamma": 0.3}, oracle.gtr, 0.5, 1e-6),
    "gtr, narrow": (GTR(), {"alpha": 1e-3, "gamma": 1.0}, oracle.gtr, 0.03, 1e-6),
    "gtr, light tail": (GTR(), {"alpha": 0.6, "gamma": 6.0}, oracle.gtr, 0.3, 2e-7),
    "sgd": (SGDMicrofacet(), {"alpha": 0.1, "p": 0.7}, oracle.sgd, 0.1, 2e-7),
    "sgd, narrow": (SGDMicrofacet(), {"alpha": 0.005, "p": 1.6}, oracle.sgd, 0.005, 2e-7),
    "student-t": (StudentT(), {"alpha": 0.2, "gamma": 2.6}, oracle.student_t, 0.2, 2e-7),
    "student-t, light tail": (StudentT(), {"alpha": 0.4, "gamma": 12.0}, oracle.student_t, 0.4, 2e-7),
    "epd": (EPD(), {"beta": 0.2, "p": 0.6}, oracle.epd, 0.2, 1e-8),
}
ANGLES = np.radians([5, 40, 70, 85, 89])


@pytest.mark.parametrize("case", CASES)
def test_the_distribution_is_the_printed_one_and_normalised(case):
    model, widths, D, narrow, _ = CASES[case]
    theta = np.array([1e-3, 0.05, 0.3, 0.9, 1.4])
    D_of = jax.jit(model.D)
    ours = np.asarray(D_of(theta, widths))
    np.testing.assert_allclose(ours, [D(x, *widths.values()) for x in theta], rtol=1e-9)
    u = np.arange(np.log(narrow) - 25, 20, 0.01)  # of log tan(theta)
    theta = np.arctan(np.exp(u))
    density = np.asarray(D_of(theta, widths))
    total = np.sum(2 * np.pi * density * np.cos(theta) ** 2 * np.sin(theta) ** 2) * 0.01
    assert total == pytest.approx(1, rel=1e-6)


@pytest.mark.parametrize("case", CASES)
def test_masking_is_that_of_its_definition(case):
    model, widths, D, narrow, accuracy = CASES[case]
    ours = jax.jit(model.G1)(np.cos(ANGLES), widths)
    expected = [oracle.smith_G1(math.cos(x), lambda t: D(t, *widths.values()), narrow) for x in ANGLES]
    np.testing.assert_allclose(ours, expected, rtol=accuracy)
    assert not np.allclose(ours, np.array(expected) * (1 + 1e-5), rtol=accuracy)


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("masking", ["smith", "v-groove", "none"])
def test_the_brdf_is_that_of_the_formula(case, masking):
    model, widths, D, narrow, accuracy = CASES[case]
    model = type(model)(masking=masking)
    of = {"none": lambda i, o, h: 1.0, "v-groove": oracle.v_groove}
    rng = np.random.default_rng(2)
    D_of = lambda t: D(t, *widths.values())  # noqa: E731
    of["smith"] = lambda i, o, h: math.prod(oracle.smith_G1(v[2], D_of, narrow) for v in (i, o))
    pairs = [[direction(np.arccos(rng.uniform(0.1, 1)), rng.uniform(0, 2 * np.pi)) for _ in range(2)] for _ in range(3)]
    expected = np.transpose([oracle.brdf(i, o, D_of, of[masking], *COLOURS.values()) for i, o in pairs])
    i, o = np.swapaxes(pairs, 0, 1)
    for exchanged in ((i, o), (o, i)):
        found = evaluate(model, widths | COLOURS, from_vectors(*exchanged))
        np.testing.assert_allclose(found, expected, rtol=4 * accuracy)


@pytest.mark.parametrize("fresnel", ["dielectric", "conductor"])
def test_exact_reflectances_are_those_of_the_oracle(fresnel):
    """What is taken off the lobe of a perfect mirror."""
    constants = {"dielectric": {"eta": np.array([1.3, 1.5, 2.2])},
                 "conductor": {"n": np.array([0.2, 1.0, 3.0]), "k": np.array([3.0, 2.0, 4.0])}}[fresnel]  # fmt: skip
    i, o = direction(1.1, 0.2), direction(0.4, 3.0)
    mirror = {"alpha": 0.3, "F0": np.ones(3), "albedo": np.zeros(3)}
    lobe = np.asarray(evaluate(GGX(), mirror, from_vectors(i, o)))
    values = {"alpha": 0.3, "albedo": np.zeros(3), **constants}
    found = np.asarray(evaluate(GGX(fresnel=fresnel), values, from_vectors(i, o)))
    given = zip(*constants.values(), strict=True)
    expected = [oracle.reflectance(i, o, *(x if len(x) == 2 else (*x, 0.0))) for x in given]
    np.testing.assert_allclose(found / lobe, expected, rtol=1e-10)


@pytest.mark.parametrize("gamma", [1.7, 2.0, 8.0])
def test_students_masking_has_the_mean_slope_of_its_distribution(gamma):
    """G1 tends to pi cot(theta) over the mean slope, whose tail the oracle's range would cut off at 1.7."""
    mean = math.sqrt(gamma - 1) * 0.2 * math.gamma(1.5) * math.gamma(gamma - 1.5) / math.gamma(gamma - 1)
    found = float(jax.jit(StudentT().G1)(np.asarray(1e-6), {"alpha": np.asarray(0.2), "gamma": np.asarray(gamma)}))
    assert found == pytest.approx(1e-6 * math.pi / mean, rel=1e-4)


def random_pairs(count=40):
    rng = np.random.default_rng(7)
    pairs = [
        [direction(np.arccos(rng.uniform(0.05, 1)), rng.uniform(0, 2 * np.pi)) for _ in range(2)] for _ in range(count)
    ]
    return from_vectors(*np.swapaxes(pairs, 0, 1))


@pytest.mark.parametrize("alpha", [0.01, 0.1, 0.6])
def test_gtr_of_gamma_2_is_ggx(alpha):
    expected = evaluate(GGX(), {"alpha": alpha, **COLOURS}, random_pairs())
    for model, more in ((GTR(gamma="2"), {}), (GTR(), {"gamma": 2.0})):
        found = evaluate(model, {"alpha": alpha, **more, **COLOURS}, random_pairs())
        np.testing.assert_allclose(found, expected, rtol=1e-6)


def test_gtr_of_gamma_1_is_the_limit():
    limit = evaluate(GTR(gamma="1"), {"alpha": 0.1, **COLOURS}, random_pairs())
    near = evaluate(GTR(), {"alpha": 0.1, "gamma": 1 + 1e-9, **COLOURS}, random_pairs())
    np.testing.assert_allclose(near, limit, rtol=1e-6)


def test_epd_of_p_1_is_beckmann():
    expected = evaluate(Beckmann(), {"roughness": 0.25, **COLOURS}, random_pairs())
    found = evaluate(EPD(), {"beta": 0.25, "p": 1.0, **COLOURS}, random_pairs())
    np.testing.assert_allclose(found, expected, rtol=1e-8)


@pytest.mark.parametrize("body", ["none", "lambert"])
def test_the_two_scale_model_without_height_is_epd(body):
    index = "complex" if body == "none" else "real"
    surface = {"beta": 0.2, "p": 0.7, "b": 3.0, "c": 2.0}
    constants = (
        {"n": np.array([0.2, 1.0, 3.0]), "k": np.array([3.0, 2.0, 4.0])}
        if body == "none"
        else {"eta": np.array([1.3, 1.5, 2.2])}
    )
    albedo = np.array([0.2, 0.1, 0.5])
    flat = {"sigma_s": 1e-9, **surface, **constants, **({} if body == "none" else {"albedo": albedo})}
    found = evaluate(TwoScale(body, index=index), flat, random_pairs())
    values = {"beta": 0.2, "p": 0.7, **constants, "albedo": 0 * albedo if body == "none" else albedo}
    expected = evaluate(EPD(fresnel="conductor" if body == "none" else "dielectric"), values, random_pairs())
    np.testing.assert_allclose(found, expected, rtol=1e-8, atol=1e-15)  # of a height of 1e-9 um a little is left


def test_the_two_scale_model_with_flat_facets_is_the_diffraction_lobe():
    """beta to 0, away from the mirror direction: HP17 Eq. 33 with D a Dirac, and no masking."""
    lobe = {"b": 3.0, "c": 2.0, "sigma_s": 0.05}
    n, k = np.array([0.2, 1.0, 3.0]), np.array([3.0, 2.0, 4.0])
    pairs = [(0.3, 0.0, 0.5, 1.0), (0.9, 0.0, 0.2, 3.0), (1.2, 0.0, 1.0, 2.5), (0.0, 0.0, 0.7, 0.0)]
    i, o = (np.array([direction(*pair[at : at + 2]) for pair in pairs]) for at in (0, 2))
    flat = {"beta": 1e-3, "p": 1.0, "n": n, "k": k, **lobe}
    found = np.asarray(evaluate(TwoScale("none"), flat, from_vectors(i, o)))
    for channel, wavelength in enumerate(WAVELENGTHS_UM):
        for at, (a, b) in enumerate(zip(i, o, strict=True)):
            cos_h, cos_d = (a + b)[2] / np.linalg.norm(a + b), np.linalg.norm(a + b) / 2
            f = 2 / wavelength * math.sqrt(1 - cos_h**2) * cos_d
            kept = renormalisation(math.sqrt(1 - cos_d**2), lobe["b"] / wavelength, lobe["c"])
            A = math.exp(-((4 * math.pi * cos_d * lobe["sigma_s"] / wavelength) ** 2) * kept)
            S = s_hs(f, wavelength, lobe["b"], lobe["c"], kept) * cos_h**2
            Q = q_from_cosines(a[2], b[2], mirror_cosine(a, b, np.array([0, 0, 1])), n[channel], k[channel])
            assert found[channel, at] == pytest.approx(Q / 2 * (1 - A) * S, rel=1e-4)


@pytest.mark.parametrize(("alpha", "p"), [(1e-4, 0.3), (1e-3, 2.5), (0.05, 0.8), (0.5, 0.0), (2.0, 5.0)])
def test_the_constant_of_the_shifted_gamma_distribution(alpha, p):
    import mpmath as mp

    expected = -mp.log(mp.mpf(alpha) * mp.gammainc(1 - mp.mpf(p), mp.mpf(alpha)))
    assert float(jax.jit(sgd.log_constant)(alpha, p)) == pytest.approx(float(expected), abs=1e-9)


def test_nothing_is_masked_along_the_normal():
    assert float(jax.jit(beckmann.G1)(1.0, 0.3)) == 1.0
