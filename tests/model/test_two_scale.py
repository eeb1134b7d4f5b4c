"""The assembled model: against the oracle, on grids and lists alike, reciprocal, differentiable, conserving."""

from dataclasses import replace
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jaxtyping import TypeCheckError
from merlfit.model.effects import KINDS
from merlfit.model.geometry import Geometry
from merlfit.model.measured import Measured, material_of
from merlfit.model.numerics import sin_quarter, softplus
from merlfit.model.parameters import WAVELENGTHS_UM
from merlfit.model.reads import reads
from merlfit.model.reflectance import contributions, factor_values, setting, shaped
from merlfit.model.two_scale import TwoScale

from tests.oracles import bodies as o_bodies
from tests.oracles import two_scale as o_two_scale
from tests.support.compiled import from_half_difference, from_vectors, two_scale

SEED = 20261121
compiled_contributions = jax.jit(contributions, static_argnums=0)
SHARED = {"beta": 0.15, "p": 0.7, "b": 3.0, "c": 1.8, "sigma_s": 0.04}
FILM = {"film_eta": 1.7, "film_thickness": 0.4}
GRAZING = {"grazing_exponent": 0.4, "grazing_exponent_diffracted": 0.15}
OPTICS = {
    "n": np.array([0.2, 0.9, 1.4]), "k": np.array([3.4, 2.3, 1.6]), "eta": np.array([1.4, 1.5, 1.6]),
    "albedo": np.array([0.6, 0.3, 0.05]), "weight": np.array([0.9, 0.5, 0.2]),
}  # fmt: skip
SWITCHED = [
    {"fresnel": "schlick"}, {"masking": "height_correlated"}, {"masking": "none"}, {"renormalised": False},
    {"colour": "fresnel"}, {"fresnel": "schlick", "colour": "fresnel", "masking": "none", "renormalised": False},
]  # fmt: skip
ASSEMBLED = [  # every body, tier, switch and loss, mixed; each alone is compared with its oracle
    TwoScale("none", "lobe"),
    TwoScale("none", "lobe", index="real", colour="fresnel"),
    TwoScale("lambert", "lobe", index="complex", fresnel="schlick"),
    TwoScale("lambert", "off", masking="none", split="conserving"),
    TwoScale("subsurface", "lobe", split="conserving"),
    TwoScale("subsurface", "quadrature", masking="height_correlated", renormalised=False),
    TwoScale("lambert", "lobe", renormalised=False),
    TwoScale("plastic", "lobe", split="free"),
    TwoScale("none", "exact"),
    TwoScale("none", "lobe", **SWITCHED[-1]),
    Measured(TwoScale("lambert", "lobe", index="complex", split="free"), "free"),
    Measured(TwoScale("lambert", "lobe", masking="height_correlated"), "derived"),
    Measured(TwoScale("plastic", "off", fresnel="schlick"), 0.3),
]
DEAR = [e for e in ASSEMBLED if (m := material_of(e)).diffraction == "exact" or m.split == "conserving"]  # to compile
DIFFERENTIATED = [e for e in ASSEMBLED if e not in DEAR]
DIFFERENTIATED += [TwoScale(diffraction="exact"), TwoScale("subsurface", "lobe", split="conserving")]


def material(effects, **changes):
    return {q.name: {**SHARED, **FILM, **GRAZING, **OPTICS, **changes}[q.name] for q in effects.parameters}


def random_directions(count, seed=SEED, highest=1.5):
    rng = np.random.default_rng(seed)
    theta, phi = np.arccos(rng.uniform(np.cos(highest), 1, (2, count))), rng.uniform(0, 2 * np.pi, (2, count))
    return np.moveaxis(np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)]), 0, -1)


@pytest.mark.parametrize("switched", SWITCHED, ids=lambda x: "-".join(map(str, x.values())))
def test_switches_against_the_oracle(switched):
    values = {
        **material(TwoScale()),
        "beta": 0.6,
        "b": 0.6,
        "sigma_s": 0.08,
    }  # much masked and renormalised
    effects = TwoScale(**switched, order=64)
    i, o = random_directions(12)
    found = np.asarray(two_scale(values, from_vectors(i, o), effects))
    m = o_two_scale.Material(**{k: values[k] for k in SHARED}, n=OPTICS["n"][0], k=OPTICS["k"][0])
    right, wrong = (
        np.array([o_two_scale.brdf(a, b, WAVELENGTHS_UM[0], m, choices=c) for a, b in zip(i, o, strict=True)])
        for c in (o_two_scale.Choices(**switched), o_two_scale.Choices())
    )
    np.testing.assert_allclose(found[0], right, rtol=3e-4)
    assert np.max(np.abs(found[0] / wrong - 1)) > 1e-2


AXES = np.ix_([0.001, 0.05, 0.4, 1.1], np.linspace(0.02, np.pi / 2, 9), [0.1, 1.5, 3.0])  # to both at the horizon
EDGES = [0.0, np.pi / 2, 0.3, np.pi / 2], [0.0, 0.0, np.pi / 2, np.pi / 2], [0.0] * 4
PAIRS = 20


def kept(effects):
    """Which places of the grid's axes: of the exact lobe, an integral by itself for each direction, fewer."""
    return tuple(slice(None, None, 2 if material_of(effects).diffraction == "exact" else 1) for _ in AXES)


def parts(effects):
    """The directions of a grid, random pairs, the same exchanged, and edges."""
    i, o = random_directions(PAIRS)
    grid = np.broadcast_arrays(*(axis[kept(effects)] for axis in AXES))
    return [
        from_half_difference(*(a.ravel() for a in grid)),
        from_vectors(i, o), from_vectors(o, i), from_half_difference(*map(np.array, EDGES)),
    ]  # fmt: skip


@cache
def compiled(effects):
    """The BRDF at the directions of all parts: one program, which several tests look at."""
    directions = jax.tree.map(lambda *x: np.concatenate(x), *parts(effects))
    return jax.jit(lambda v: two_scale(v, directions, effects)).lower(material(effects)).compile()


@cache
def evaluated(effects):
    """What it gives for each part."""
    brdf = np.asarray(compiled(effects)(material(effects)))
    return np.split(brdf, np.cumsum([len(g.cos_i) for g in parts(effects)])[:-1], axis=1)


def work(effects):
    """(floating point operations, transcendental functions) of the compiled BRDF on a list of directions.

    Of the exact lobe on fewer: that it does more than others is the harder to show.
    """
    analysis = compiled(effects).cost_analysis()
    return analysis["flops"], analysis["transcendentals"]


LOBE = TwoScale(diffraction="lobe")  # seconds less to compile than the quadrature
LADDERS = {  # programs that do ever more: each step adds operations, and transcendental functions
    "tiers": [TwoScale(diffraction="off"), LOBE, TwoScale(order=8), TwoScale(), TwoScale(diffraction="exact")],
    "masking": [replace(LOBE, masking="none"), LOBE],
    "renormalised": [replace(LOBE, renormalised=False), LOBE],
    "fresnel": [replace(LOBE, fresnel="schlick"), LOBE],
    "colour": [replace(LOBE, colour="fresnel"), LOBE],
    "acquisition": [LOBE, Measured(LOBE), Measured(LOBE, "derived")],
    "body": [TwoScale("plastic", "lobe"), TwoScale("subsurface", "lobe")],
    "split": [LOBE, replace(LOBE, split="conserving")],
}
RATIONAL = {  # steps that add operations, but no transcendental function
    "body, rational": [LOBE, TwoScale("lambert", "lobe"), TwoScale("plastic", "lobe")],
    "index, rational": [replace(LOBE, index="real"), LOBE],
    "masking, rational": [LOBE, replace(LOBE, masking="height_correlated")],
    "acquisition, constant": [LOBE, Measured(LOBE, 0.3)],
}


@pytest.mark.parametrize("name", LADDERS | RATIONAL)
def test_what_is_not_chosen_is_absent_from_the_compiled_program(name):
    flops, transcendentals = np.array([work(effects) for effects in (LADDERS | RATIONAL)[name]]).T
    assert np.all(np.diff(flops) > 0)
    assert name in RATIONAL or np.all(np.diff(transcendentals) > 0)


def test_a_loss_of_exponent_0_is_no_loss():
    assert work(Measured(LOBE, 0.0)) == work(LOBE)


@pytest.mark.parametrize(("index", "body"), [*KINDS, ("real", "none")])
def test_against_the_oracle(index, body):
    effects = TwoScale(body, index=index, order=64)
    i, o = random_directions(12)
    values = material(effects)
    found = np.asarray(two_scale(values, from_vectors(i, o), effects))
    for channel, wavelength in enumerate(WAVELENGTHS_UM):
        n, k = (OPTICS["n"], OPTICS["k"]) if index == "complex" else (OPTICS["eta"], np.zeros(3))
        m = o_two_scale.Material(**SHARED, n=n[channel], k=k[channel])
        albedo, eta = OPTICS["albedo"][channel], OPTICS["eta"][channel]
        for a, b, value in zip(i, o, found[channel], strict=True):
            ti, to = np.arccos(a[2]), np.arccos(b[2])
            below = {
                "none": lambda: 0.0,
                "lambert": lambda: albedo / np.pi,
                "plastic": lambda: o_bodies.plastic(ti, to, eta, albedo),
                "subsurface": lambda: o_bodies.subsurface(ti, to, eta, albedo),
            }[body]()
            assert value == pytest.approx(o_two_scale.brdf(a, b, wavelength, m, float(below)), rel=3e-4)
            printed_q = o_two_scale.brdf(a, b, wavelength, m, float(below), q_factor=1.0)
            assert value != pytest.approx(printed_q, rel=1e-3)


@pytest.mark.parametrize("diffraction", ["lobe", "quadrature", "exact"])
def test_the_free_split_weighs_the_diffracted_light_and_nothing_else(diffraction):
    """With a weight of 1 it is the printed split, with 0 what that is beside the lobe, and linear between."""
    i, o = random_directions(12)
    printed, directions = TwoScale("plastic", diffraction), from_vectors(i, o)
    free = replace(printed, split="free")

    def brdf(effects, **changes):
        return np.asarray(two_scale(material(effects, **changes), directions, effects))

    parts = compiled_contributions(printed, material(printed), directions)
    expected = parts["specular"] + OPTICS["weight"][:, None] * parts["diffracted"] + parts["body"]
    np.testing.assert_allclose(brdf(free), expected, rtol=1e-12)
    assert np.max(parts["diffracted"] / brdf(printed)) > 0.3
    np.testing.assert_array_equal(brdf(free, weight=np.ones(3)), brdf(printed))
    np.testing.assert_allclose(brdf(free, weight=np.zeros(3)), parts["specular"] + parts["body"], rtol=1e-12)


def test_the_free_split_needs_a_diffraction_lobe():
    with pytest.raises(ValueError, match="split has an effect only where diffraction is not off"):
        TwoScale(diffraction="off", split="free")
    assert TwoScale(split="free").changed(diffraction="off") == TwoScale(diffraction="off")
    assert TwoScale(split="conserving").changed(diffraction="off").split == "conserving"


@pytest.mark.parametrize(("index", "body", "acquisition"), [*((*kind, "free") for kind in KINDS), (*KINDS[0], 0.3)])
def test_the_loss_is_that_of_each_lobe_and_not_of_the_body(index, body, acquisition):
    """Towards grazing angles, where p(i, o) of everything would be several per cent off and up to half of it."""
    i, o = random_directions(8, SEED + 1)
    shared = {**SHARED, "sigma_s": 0.06}  # as much diffracted as mirrored
    effects = Measured(TwoScale(body, index=index, order=64), acquisition)
    albedo, eta = 0.05, OPTICS["eta"][1]
    values = material(effects, **shared, albedo=np.full(3, albedo))
    found = np.asarray(two_scale(values, from_vectors(i, o), effects))[1]
    n, k = (OPTICS["n"], OPTICS["k"]) if index == "complex" else (OPTICS["eta"], np.zeros(3))
    m = o_two_scale.Material(**shared, n=n[1], k=k[1])
    given = tuple(GRAZING.values()) if acquisition == "free" else (acquisition, acquisition)

    def oracle(a, b, specular, diffracted, whole=0.0):
        ti, to = np.arccos(a[2]), np.arccos(b[2])
        below = {
            "none": lambda: 0.0,
            "lambert": lambda: albedo / np.pi,
            "plastic": lambda: o_bodies.plastic(ti, to, eta, albedo),
            "subsurface": lambda: o_bodies.subsurface(ti, to, eta, albedo),
        }[body]()
        losses = o_two_scale.Losses(specular, diffracted)
        brdf = o_two_scale.brdf(a, b, WAVELENGTHS_UM[1], m, float(below), losses=losses)
        return o_two_scale.grazing_loss(a, b, whole) * brdf

    def expected(*exponents):
        return np.array([oracle(a, b, *exponents) for a, b in zip(i, o, strict=True)])

    np.testing.assert_allclose(found, expected(*given), rtol=3e-4)
    wrong = {"p of the whole prediction": (0, 0, given[0]), "no loss": (0, 0)}
    if acquisition == "free":
        wrong |= {"exchanged": given[::-1], "one for both": given[:1] * 2}
    elif body == "none":
        wrong.pop("p of the whole prediction")  # it is the same
    for name, exponents in wrong.items():
        assert np.max(np.abs(expected(*exponents) / found - 1)) > 2e-2, name


def test_derived_exponents_are_those_of_the_widths_of_both_lobes():
    """Of D, and of (S * D) at the middle wavelength, whatever the colour; the same whether given as a table or not."""
    values = {**material(Measured(TwoScale("plastic"))), "beta": 0.01, "p": 1.0, "b": 20.0}
    derived, free = Measured(TwoScale("plastic"), "derived"), Measured(TwoScale("plastic"))
    g = from_half_difference(np.linspace(1e-3, 0.05, 20), np.linspace(0.2, 1.2, 20), np.full(20, 0.7))
    found = np.asarray(two_scale(values, g, derived))
    exponent = jax.jit(derived.exponent, static_argnums=0)
    k = {
        "grazing_exponent": float(exponent("specular", values)),
        "grazing_exponent_diffracted": float(exponent("diffracted", values)),
    }
    assert 0.1 < k["grazing_exponent_diffracted"] < k["grazing_exponent"] - 0.1
    np.testing.assert_allclose(found, two_scale({**values, **k}, g, free), rtol=1e-12)
    for name in k:
        other = np.asarray(two_scale({**values, **k, name: k[name] + 0.02}, g, free))
        assert np.max(np.abs(other / found - 1)) > 1e-3


@pytest.mark.parametrize("effects", ASSEMBLED, ids=repr)
def test_lists_and_grids_are_the_same_function(effects):
    grid = from_half_difference(*(axis[kept(effects)] for axis in AXES))
    on_grid = np.asarray(jax.jit(lambda v: two_scale(v, grid, effects))(material(effects)))
    on_list = evaluated(effects)[0].reshape(on_grid.shape)
    np.testing.assert_allclose(on_grid, on_list, rtol=2e-3, atol=1e-12)
    below = (np.asarray(grid.cos_i) <= 0) | (np.asarray(grid.cos_o) <= 0)
    assert on_grid.shape == (3, *below.shape)
    assert np.any(below)
    assert np.all(on_list[:, below] == 0)


def test_single_precision_on_a_grid_to_the_horizon():
    effects = TwoScale(order=16)
    half, double = (from_half_difference(*(np.asarray(x, kind) for x in AXES)) for kind in (np.float32, np.float64))
    found, expected = (
        np.asarray(jax.jit(lambda g: two_scale(material(effects), g, effects))(g)) for g in (half, double)
    )
    assert found.dtype == np.float32
    shown = np.asarray(double.cos_i > 1e-6) & np.asarray(double.cos_o > 1e-6)  # float32 puts some below the horizon
    assert np.all(np.isfinite(found))
    assert shown.sum() > 60
    np.testing.assert_allclose(found[:, shown], expected[:, shown], rtol=2e-3, atol=1e-6)


@pytest.mark.parametrize("effects", ASSEMBLED, ids=repr)
def test_reciprocity(effects):
    _, there, back, _ = evaluated(effects)
    np.testing.assert_allclose(there, back, rtol=1e-9)


@pytest.mark.parametrize("effects", ASSEMBLED, ids=repr)
def test_extreme_geometry_gives_finite_values(effects):
    assert np.all(np.isfinite(evaluated(effects)[3]))


@pytest.mark.parametrize("effects", DIFFERENTIATED, ids=repr)
def test_gradients_are_finite_at_the_edges_and_match_differences(effects):
    up, low = np.array([0.0, 0.0, 1.0]), np.array([np.sin(1.5707), 0.0, np.cos(1.5707)])
    mirror = low * np.array([-1, 1, 1])
    side = np.array([0.6, 0.0, 0.8])
    i = np.array([up, low, low, side, side, up])
    o = np.array([up, mirror, low, side, np.array([-0.6, 0.0, 0.8]), side])
    geometry = from_vectors(i, o)
    channels = 1 if effects in DEAR else 3  # gigabytes, in reverse mode
    values = {name: np.array(v[:channels] if np.ndim(v) else v) for name, v in material(effects).items()}
    ends = np.cumsum([v.size for v in values.values()])

    def at(logs):
        each = zip(values.items(), jnp.split(logs, ends[:-1]), strict=True)
        values_there = {name: v * jnp.exp(x.reshape(v.shape)) for (name, v), x in each}
        return two_scale(values_there, geometry, effects, WAVELENGTHS_UM[:channels])

    zero = np.zeros(ends[-1])
    mixture = np.random.default_rng(SEED).uniform(0.5, 1.5, (channels, len(i)))

    @jax.jit
    def found(logs):
        """Values, their slopes in forward mode, and those of a mixture of all values in reverse mode: one program."""
        brdf, forward = jax.linearize(at, logs)
        # reverse mode of each value would keep the conserving split's tables many times
        (reverse,) = jax.linear_transpose(forward, logs)(mixture)
        return brdf, jax.lax.map(forward, jnp.eye(len(logs))), reverse

    brdf, slopes, reverse = map(np.asarray, found(zero))
    moved = jax.jit(at) if effects in DEAR else lambda logs: found(logs)[0]  # which leaves out seconds of slopes
    assert np.all(np.isfinite(slopes))
    scale = np.abs(brdf) + 1e-9
    np.testing.assert_allclose(np.tensordot(slopes, mixture, 2), reverse, rtol=1e-6, atol=1e-9)
    for slope, step in zip(slopes, 1e-4 * np.eye(len(zero)), strict=True):
        difference = (np.asarray(moved(zero + step)) - np.asarray(moved(zero - step))) / 2e-4
        assert np.max(np.abs(slope - difference) / scale) < 5e-3


@pytest.mark.parametrize("effects", ASSEMBLED, ids=repr)
def test_factors_depend_on_what_was_recorded(effects):
    directions, read, v = from_vectors(*random_directions(5)), reads(effects), material(effects)

    @jax.jit
    def factors(v):
        s = setting(directions)
        return factor_values(effects, shaped(effects, v, s), s)

    before = jax.tree.map(np.asarray, factors(v))
    for q in v:
        after = factors({**v, q: v[q] * 1.1})
        for name in before:
            same = np.array_equal(before[name], after[name])
            nothing_in_excess = name == "conservation" and material_of(effects).body == "none"
            assert same == (q not in read.parameters[name]) or (same and nothing_in_excess), f"{name} and {q}"


@pytest.mark.parametrize(
    "effects",
    [
        TwoScale("subsurface", "lobe", split="conserving"),
        TwoScale("none", "quadrature"),
        TwoScale("lambert", "off", index="film"),
        TwoScale("none", "quadrature", index="film", colour="fresnel"),
        Measured(TwoScale("lambert", "lobe"), "derived"),
    ],
    ids=str,
)
def test_tables_depend_on_what_was_recorded_and_change_nothing(effects):
    grid = np.ix_(np.linspace(0.05, 1.2, 9), np.linspace(0.05, 1.2, 7), np.linspace(0.1, 1.5, 6))
    directions = from_half_difference(*grid)
    derived = isinstance(effects, Measured)
    narrow = {"beta": 0.01, "b": 20.0} if derived else {}  # wide lobes lose nothing
    v = material(effects, **narrow)

    @jax.jit
    def tables(v):
        s = setting(directions)
        return {name: table(shaped(effects, v, s), s) for name, table in effects.tables().items()}

    found = tables(v)
    conserving = material_of(effects).split == "conserving"
    expected = {"masking_curve", "facet_reflectance"} | ({"surface_albedo", "facet_albedo"} if conserving else set())
    expected |= set() if material_of(effects).diffraction == "off" else {"relative_variance"}
    assert set(found) == expected | ({"specular_exponent", "diffracted_exponent"} if derived else set())
    for q in v:
        after = tables({**v, q: v[q] * 1.1})
        for name in found:
            same = np.array_equal(after[name], found[name])
            assert same == (q not in reads(effects).parameters[name]), f"{name} and {q}"
    plain, given = (np.asarray(two_scale({**v, **extra}, directions, effects)) for extra in ({}, found))
    np.testing.assert_allclose(given, plain, rtol=1e-12)
    wrong = {name: np.asarray(x) * 1.01 for name, x in found.items()}
    assert not np.allclose(two_scale({**v, **wrong}, directions, effects), plain, rtol=1e-3)


def test_missing_parameter_is_named():
    values = material(TwoScale())
    del values["sigma_s"]
    with pytest.raises(KeyError, match="sigma_s"):
        two_scale(values, from_vectors(*random_directions(1)), TwoScale())


@pytest.mark.parametrize("body", ["plastic", "subsurface"])
def test_what_lies_under_a_clear_interface_has_a_real_index(body):
    with pytest.raises(ValueError, match=f"{body}.*its index is real"):
        TwoScale(body, index="complex")
    assert TwoScale(body) == TwoScale(body, index="real")
    assert TwoScale(body).kind == ("real", body)


def test_the_usual_index_is_complex_over_no_body_and_real_over_one():
    assert TwoScale() == TwoScale(index="complex") != TwoScale(index="real")
    assert TwoScale("lambert") == TwoScale("lambert", index="real") != TwoScale("lambert", index="complex")
    for index, body in KINDS:
        effects = TwoScale(body, index=index)
        assert effects.kind == (index, body)
        names = {q.name for q in effects.parameters}
        assert {"n", "k"} <= names if index == "complex" else "eta" in names
        assert not names & ({"eta"} if index == "complex" else {"n", "k"})
        assert ("albedo" in names) == (body != "none")


def test_exponents_are_parameters_of_the_lobes_that_there_are():
    names = [{q.name for q in Measured(TwoScale("lambert", how)).parameters} for how in ("off", "lobe")]
    assert names[1] - names[0] == {"b", "c", "sigma_s", "grazing_exponent_diffracted"}
    for how in ("off", "derived", 0.3):
        assert not any("exponent" in q.name for q in Measured(TwoScale("lambert", "lobe"), how).parameters)


def test_effects_refuse_unknown_names():
    for wrong in ({"body": "wood"}, {"diffraction": "some"}, {"order": 2}, {"index": "none"}):
        # the runtime type checks of the tests refuse a wrong name before TwoScale itself does
        with pytest.raises((ValueError, TypeCheckError), match=str(next(iter(wrong.values())))):
            TwoScale(**wrong)


IDLE = [
    ("lobe", {"order": 16}), ("off", {"colour": "fresnel"}),
    ("off", {"renormalised": False}),
]  # fmt: skip


@pytest.mark.parametrize(("diffraction", "option"), IDLE)
def test_options_that_nothing_uses_are_refused(diffraction, option):
    with pytest.raises(ValueError, match=f"{next(iter(option))} has an effect only where diffraction is "):
        TwoScale(diffraction=diffraction, **option)


def test_a_change_leaves_no_option_that_nothing_uses():
    """So equal programs are equal values, and compile once."""
    fine = TwoScale("lambert", order=64, colour="fresnel", renormalised=False)
    assert fine.changed(diffraction="lobe") == TwoScale("lambert", "lobe", colour="fresnel", renormalised=False)
    assert fine.changed(diffraction="off", colour="fresnel") == TwoScale("lambert", "off")
    assert fine.changed(order=16) == replace(fine, order=16)
    assert fine.changed() == fine


@given(
    theta_h=st.floats(0, 1.5), theta_d=st.floats(0, 1.5), phi_d=st.floats(0, 3.14), beta=st.floats(1e-3, 1.0),
    p=st.floats(0.2, 5.0), c=st.floats(1.01, 6.0), b=st.floats(0.05, 200.0), sigma_s=st.floats(0, 0.5),
)  # fmt: skip
@settings(derandomize=True, max_examples=60, deadline=None, database=None)
def test_finite_and_not_negative_anywhere_in_bounds(theta_h, theta_d, phi_d, beta, p, c, b, sigma_s):
    effects = TwoScale()
    values = material(effects, beta=beta, p=p, c=c, b=b, sigma_s=sigma_s)
    g = from_half_difference(*(np.array([x]) for x in (theta_h, theta_d, phi_d)))
    brdf = np.asarray(_compiled(values, g))
    assert np.all(np.isfinite(brdf))
    assert np.all(brdf >= 0)


_compiled = jax.jit(lambda values, g: two_scale(values, g, TwoScale()))


# --- Energy: directional albedo by quadrature over microfacet normals, which follow the lobe


AZIMUTHS = 48


@jax.jit
def white(beta, p, *angles):
    """The model's own Cook-Torrance lobe with its Fresnel factor divided out (1/sr), with masking and without."""
    model, s = TwoScale("none", "off"), setting(Geometry(*angles), (0.5,))
    v = shaped(model, {"beta": beta, "p": p, "n": np.array([0.5]), "k": np.array([3.0])}, s)
    at = {**factor_values(model, v, s), "facets": jnp.ones(())}
    return [model.assemble(each, s).brdf(s)[0] for each in (at, {**at, "masking": jnp.ones(())})]


def reflected(theta_i, beta, p):
    """Directional albedo at |F| = 1: Int rho cos_o domega_o, over normals m = h, which follow the lobe; to 8e-4.

    With masking and without.
    """
    nodes, weights = np.polynomial.legendre.leggauss(120)
    v_low, v_high = -25 * max(p, 0.5) * 2, np.log(60 + 4 / p)
    v, wv = (v_high + v_low) / 2 + (v_high - v_low) / 2 * nodes, weights * (v_high - v_low) / 2
    theta_m = np.arctan(np.minimum(beta * np.exp(v / (2 * p)), 1e8))[:, None]
    phi = (np.arange(AZIMUTHS) + 0.5) / AZIMUTHS * np.pi
    cos_d = np.cos(theta_i) * np.cos(theta_m) + np.sin(theta_i) * np.sin(theta_m) * np.cos(phi)
    cos_o = 2 * cos_d * np.cos(theta_m) - np.cos(theta_i)
    cos_i = np.full_like(cos_o, np.cos(theta_i))
    theta_d = np.arccos(np.clip(cos_d, 0, 1))
    brdf = np.asarray(white(beta, p, theta_m, theta_d, cos_i, np.where(cos_d > 0, cos_o, -1.0)))
    # domega_o = 4 cos_d domega_m; d theta_m = sin cos / (2 p) dv
    dm = 4 * cos_d * np.sin(theta_m) * (np.sin(theta_m) * np.cos(theta_m) / (2 * p)) * wv[:, None]
    return np.sum(np.where(brdf > 0, brdf * cos_o * dm, 0), (-2, -1)) * 2 * np.pi / AZIMUTHS


def test_white_furnace_of_the_cook_torrance_lobe():
    rng = np.random.default_rng(SEED)
    beta, p = 10 ** rng.uniform(-3, 0, 200), np.exp(rng.uniform(np.log(0.2), np.log(5), 200))
    theta_i = rng.uniform(0, np.radians(89), 200)
    masked, unmasked = np.max([reflected(*each) for each in zip(theta_i, beta, p, strict=True)], 0)
    assert masked <= 1 + 1e-3
    assert unmasked > 1.1


def test_fast_sine_and_softplus_are_exact():
    x = np.linspace(0.0, np.pi / 2, 1001)
    np.testing.assert_allclose(jax.jit(sin_quarter)(x), np.sin(x), rtol=3e-16 * 2, atol=0)
    y = np.linspace(-700.0, 700.0, 1001)
    np.testing.assert_allclose(jax.jit(softplus)(y), np.logaddexp(0, y), rtol=1e-15)
