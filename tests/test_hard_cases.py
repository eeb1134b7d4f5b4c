"""The hard cases of cases.toml: each within its tolerance, in value and gradient and both precisions."""

from dataclasses import fields
from typing import Literal, get_args, get_origin

import jax
import mpmath as mp
import numpy as np
import pytest
from merlfit.model.apparatus import GrazingLoss
from merlfit.model.effects import ANY, KINDS
from merlfit.model.two_scale import TwoScale

from tests.hard_cases import __main__ as program
from tests.hard_cases import comparison, fits
from tests.hard_cases import table as hard_table
from tests.hard_cases.effects import MODEL
from tests.oracles import precise

CASES, KNOWN, _ = hard_table.table()
NAMES = {case.name for case in CASES}
MOST_KNOWN_FAILURES = 0  # as cases.toml has it; only ever lowered
FAILING = {entry["case"] for entry in KNOWN["entries"]}


@pytest.fixture(scope="module")
def found(compilation_cache, compiled_quickly):
    return comparison.found()


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_hard_case(case, found):
    row = comparison.Row(case, found[case.name])
    for precision, dtype in row.found.dtype.items():
        assert dtype == hard_table.PRECISIONS[precision], f"the result is {dtype}"
    for modes in row.found.gradient.values():
        assert all(np.isfinite(x) for mode in modes for x in mode.values())
    if case.name in FAILING:
        assert row.failures, "it passes now: take it off the list of known failures, and lower `most` with it"
    else:
        assert not row.failures, {q: (row.errors[q], case.tolerance[q]) for q in row.failures}


def test_the_table_is_whole():
    assert len(NAMES) == len(CASES) >= 80
    assert {case.effect for case in CASES} == set(MODEL)
    defaults = {case.effect: case.tolerance for case in reversed(CASES) if not case.reason}
    for case in CASES:
        departs = case.tolerance != defaults[case.effect] or bool(case.unchecked)
        assert bool(case.reason) == departs, f"{case.name}: a tolerance and a reason"
        assert set(case.unchecked) < set(case.parameters)
        assert not case.reason or len(case.reason.split()) > 3


def test_known_failures_only_shrink():
    assert len(KNOWN["entries"]) == KNOWN["most"] == MOST_KNOWN_FAILURES
    assert FAILING <= NAMES
    assert all(len(entry["reason"].split()) > 3 for entry in KNOWN["entries"])


def choices(kind):
    """What a field of this type may be; nothing for numbers."""
    if kind is bool:
        return {True, False}
    return set(get_args(kind)) if get_origin(kind) is Literal else set().union(*map(choices, get_args(kind)))


def test_every_choice_of_every_effect_is_there():
    told = [case.static for case in CASES if case.effect.startswith("two_scale")]
    losses = [static.get("acquisition", "off") for static in told]
    seen = [TwoScale(**{name: x for name, x in static.items() if name != "acquisition"}) for static in told]
    for field in fields(TwoScale):
        special = {"usual", ANY}  # one of the rest; of no material
        missing = choices(field.type) - {getattr(effects, field.name) for effects in seen} - special
        assert not missing, f"{field.name}: no case has {missing}"
    assert set(get_args(GrazingLoss)) <= set(losses)
    assert any(isinstance(loss, float) for loss in losses)
    bodies, ways = (choices(field.type) - {ANY} for field in fields(TwoScale) if field.name in ("body", "diffraction"))
    together = {(effects.body, effects.diffraction) for effects in seen}
    assert together >= {(body, way) for body in bodies for way in ways & {"off", "lobe", "quadrature"}}
    assert {effects.kind for effects in seen} >= {*KINDS, ("real", "none")}


@pytest.mark.parametrize("name", hard_table.ALWAYS)
def test_stored_references_are_those_of_the_oracle(name):
    case = next(case for case in CASES if case.name == name)
    value, gradient = hard_table.reference(case, "")
    anew, slopes = case.compute("")
    assert abs(value / anew - 1) < 1e-15
    for q, slope in slopes.items():
        assert abs(gradient[q] - slope) <= 1e-9 * max(abs(slope), abs(anew))


def test_a_changed_case_is_noticed():
    case = next(filter(hard_table.dear, CASES))
    name = next(iter(case.inputs))
    changed = hard_table.Case(case.name, case.effect, {**case.inputs, name: 0.123}, case.static, case.parameters, {})
    with pytest.raises(LookupError, match="--references"):
        hard_table.reference(changed, "")


@pytest.fixture
def one_reference(tmp_path, monkeypatch):
    """A file of references with a single case, of value 0, and its case."""
    case = next(case for case in CASES if case.name == "plastic of albedo 1, retro-reflection")
    monkeypatch.setattr(hard_table, "REFERENCES", tmp_path / "references.json")
    monkeypatch.setattr(hard_table, "table", lambda: ([case], {}, []))
    gradient = dict.fromkeys(case.checked, "0")
    hard_table._write({case.name: {"inputs": case.mark(), "value": "0", "gradient": gradient}})
    hard_table.stored.cache_clear()
    yield case
    hard_table.stored.cache_clear()


def test_references_that_are_up_to_date_are_kept(one_reference):
    hard_table.write_references()
    assert hard_table.reference(one_reference, "")[0] == 0


def test_a_changed_oracle_is_noticed_and_everything_computed_anew(one_reference, tmp_path, monkeypatch):
    for path in hard_table.ORACLES.glob("*.py"):
        (tmp_path / path.name).write_bytes(path.read_bytes())
    monkeypatch.setattr(hard_table, "ORACLES", tmp_path)
    assert hard_table.reference(one_reference, "")[0] == 0  # the same sources elsewhere
    hard_table.stored.cache_clear()
    with (tmp_path / "body.py").open("a") as file:
        file.write("# another\n")
    with pytest.raises(LookupError, match=r"oracles have changed.*--references"):
        hard_table.reference(one_reference, "")
    hard_table.write_references()
    assert hard_table.reference(one_reference, "")[0] == mp.mpf(mp.nstr(one_reference.compute("")[0], 20))


@pytest.mark.parametrize("failures", [[], ["status CONVERGED"]])
def test_the_command_fails_with_a_file_whose_status_is_wrong(failures, tmp_path, monkeypatch):
    monkeypatch.setattr(program, "use_persistent_cache", lambda: None)
    monkeypatch.setattr(program, "RESULTS", tmp_path / "results")
    monkeypatch.setattr(program, "rows", list)
    monkeypatch.setattr(fits, "rows", lambda: [fits.Row("all black", "CONVERGED", "so", failures)])
    assert program.main([]) == bool(failures)
    assert "| all black |" in (tmp_path / "results" / "hard_cases.md").read_text()


# --- The comparison rejects formulas that are wrong by little, one an effect

WRONG = {
    "fresnel": lambda cos_theta, n, k: precise.fresnel(cos_theta, n * (1 + 1e-6), k),
    "schlick": lambda cos_theta, n, k: precise.schlick(cos_theta, n, k) + (1 - cos_theta) ** 6 * 1e-6,
    "diffraction_colour": lambda **at: 2 * precise.diffraction_colour(**at),  # the printed Q
    "epd": lambda theta, beta, p: precise.epd(theta, beta, p) * mp.cos(theta) ** 2,
    "smith_lambda": lambda tau, p: precise.smith_lambda(tau, p) / 2,  # the printed half line
    "masking": lambda cos_theta, beta, p: 1 / (2 / precise.masking(cos_theta, beta, p) - 1) if cos_theta else 0,
    "masking_table": lambda cos_theta, beta, p: 1 / (2 / precise.masking(cos_theta, beta, p) - 1) if cos_theta else 0,
    "renormalisation": lambda sin_theta, b_over_lambda, c: 1 - (1 + b_over_lambda**2) ** (-(c - 1) / 2),  # centred
    "lobe": lambda theta_h, B, c: precise.lobe(theta_h, B, c) / mp.cos(theta_h),
    "specular_share": lambda **at: precise.specular_share(**{**at, "sigma_s": at["sigma_s"] * 1.001}),
    "convolve": lambda theta_h, B, c, beta, p, order: precise.lobe(theta_h, B, c),
    "convolve_256": lambda theta_h, B, c, beta, p, order: precise.convolve(theta_h, B, c, beta * (1 + 1e-4), p),
    "lambert": lambda albedo: albedo,
    "plastic": lambda cos_i, cos_o, n, albedo: precise.plastic(cos_i, cos_o, n, albedo) * n**2,  # as printed
    "subsurface": lambda **at: precise.subsurface(**{**at, "albedo": at["albedo"] * 0.999}),
    "grazing": lambda cos_i, cos_o, exponent: precise.grazing(cos_i, cos_i, exponent),
    "lobe_albedo": lambda renormalised, exact, **at: 1 - precise.specular_share(**at),  # the printed split
    "two_scale": lambda **at: precise.two_scale(**{**at, "masking": "smith", "acquisition": "off"}),
    "two_scale_quadrature": lambda **at: precise.two_scale(**{**at, "diffraction": "lobe"}),
    "two_scale_exact": lambda **at: precise.two_scale(**{**at, "diffraction": "lobe"}),
    "two_scale_free": lambda weight, **at: precise.two_scale(**{**at, "split": "printed"}),
    "two_scale_film": lambda film_eta, film_thickness, **at: precise.two_scale(**{**at, "index": "complex"}),
    "film": lambda cos_theta, n, k, eta, thickness_um, wavelength_um: precise.fresnel(cos_theta, n, k),
    "two_scale_conserving": lambda **at: precise.two_scale(**{**at, "split": "printed"}),
}


def test_every_effect_has_a_wrong_formula():
    assert set(WRONG) == set(MODEL)


@pytest.mark.parametrize("effect", WRONG)
def test_a_wrong_formula_fails(effect, found, monkeypatch):
    def wrong(case, precision):
        return WRONG[effect](**case.at(precision), **case.static), dict.fromkeys(case.checked, mp.mpf(0))

    monkeypatch.setattr(comparison, "reference", wrong)
    rows = (comparison.Row(case, found[case.name]) for case in CASES if case.effect == effect)
    assert any("value" in row.failures for row in rows)


BETA_2 = ("beta 2 at the peak, p = 0.12", "beta 2, p = 5 on its edge", "beta 2 at 89.99 degrees, p = 0.12")


@pytest.mark.parametrize("name", BETA_2)
def test_a_wrong_gradient_fails(name, found):
    """One that leaves out the parameter's own scale, as if d/dx were d/dlog x."""
    case, mine = next(case for case in CASES if case.name == name), found[name]
    wrong = [{**mode, "beta": mode["beta"] / 2} for mode in mine.gradient[""]]
    row = comparison.Row(case, comparison.Found(mine.value, {**mine.gradient, "": wrong}, mine.dtype))
    assert row.failures == ["gradient"]


@pytest.mark.parametrize("name", hard_table.ALWAYS)
def test_dear_cases_reject_the_lobe_without_blur_and_the_body_without_surface(name, found):
    case = next(case for case in CASES if case.name == name)
    wrong = precise.lobe(*(case.inputs[q] for q in ("theta_h", "B", "c"))) if "B" in case.inputs else 0
    assert abs(found[name].value[""] - wrong) > 3 * case.tolerance["value"] * abs(found[name].value[""])


def test_the_precise_oracle_knows_beckmann_and_converges():
    """What the oracle is held to: closed forms, and twice as fine a rule."""
    with mp.workdps(30):
        for tau in (mp.mpf("0.3"), mp.mpf(1), mp.mpf(100)):
            a = 1 / tau
            beckmann = mp.exp(-(a**2)) / (2 * a * mp.sqrt(mp.pi)) - mp.erfc(a) / 2
            assert abs(precise.smith_lambda(tau, 1.0) / beckmann - 1) < 1e-25
        # c = 3 at the centre of the disc: 1 - 1/(1 + (b/lambda)^2)
        assert abs(precise.renormalisation(0.0, 2.0, 3.0) - mp.mpf("0.8")) < 1e-25
        for case in ((1.5, 2e4, 8.0, 2.0, 5.0),):
            assert abs(precise.convolve(*case, order=18) / precise.convolve(*case) - 1) < 1e-8
        case = (1.5, 0.5, 0.5, 2.0, 0.3, False, True)
        assert abs(precise.lobe_albedo(*case, order=14) / precise.lobe_albedo(*case) - 1) < 1e-6


def test_the_precise_oracle_of_the_exact_lobe_converges():
    """Narrow normals and a sharp lobe; and, where both are wide, facets turned away from light or viewer."""
    with mp.workdps(30):
        for case in ((0.3, 0.7, 1, 32, 1, 1, 0, 2.5, 0.01, 0.8), (0.05, 1.4, 1, 2, 1, 1, 0, 2, 0.5, 1)):
            case = tuple(map(mp.mpf, case))
            coarse, fine = (precise.exact_lobe(*case, coloured=False, order=order) for order in (8, 10))
            assert abs(coarse / fine - 1) < 1e-7


def test_functions_keep_float32_and_float64(found):
    kept = {case.effect: set(found[case.name].dtype) for case in CASES}
    assert all(seen == {"", "32"} for seen in kept.values())
    assert jax.config.jax_enable_x64
