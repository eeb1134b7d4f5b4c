"""Plans keep what shows and drop what does not, and say what they do."""

import numpy as np
import pytest
from merlfit.model.effects import FILMS, KINDS
from merlfit.model.part import Part
from merlfit.model.registry import models
from merlfit.model.two_scale import TwoScale
from merlfit.scene import effects
from merlfit.scene.description import Scene, Tolerance
from merlfit.scene.effects import TWO_SCALE, Given, effects_of, finest, off_by, plan, without
from merlfit.scene.render import Film, pictures, stage
from merlfit.scene.surface import drawn

MATTE = {
    "beta": 0.3, "p": 1.0, "b": 1.0, "c": 2.0, "sigma_s": 0.002, "eta": np.full(3, 1.3),
    "albedo": np.array([0.7, 0.6, 0.5]),
}  # fmt: skip
HAZY = {
    "beta": 0.02, "p": 0.6, "b": 1.5, "c": 1.6, "sigma_s": 0.05, "n": np.array([0.3, 0.4, 1.0]),
    "k": np.array([3.0, 2.6, 2.0]),
}  # fmt: skip
EVERY = {effect.name: effect for effect in TWO_SCALE}


@pytest.fixture(autouse=True)
def few_pixels(monkeypatch):
    monkeypatch.setattr(effects, "PIXELS", 256)
    monkeypatch.setattr(effects, "REPEATS", 1)


def scene(**changes):
    base = {
        "camera": {"position": (0, 0, 6), "field_of_view_deg": 22, "width": 24, "height": 24},
        "lamp": [{"towards": (0.4, 0.5, 0.8), "irradiance": 3.0, "radius_deg": 2}],
        "sphere": [{"material": "a"}], "materials": {"a": {"model": "two-scale"}}, "samples": 16,
    }  # fmt: skip
    return Scene.model_validate({**base, **changes})


def planned(made, given):
    return plan(made, Film(made, stage(made)), given, 0)


def test_what_does_not_show_is_dropped_and_what_shows_is_kept():
    found = planned(scene(), Given("a", TwoScale("lambert"), MATTE))
    kept = {row.effect.name for row in found.rows if row.kept}
    assert "body" in kept
    assert "diffraction" not in kept
    assert found.off_by <= 1.0
    assert found.chosen == without(finest(TwoScale("lambert")), [r.effect for r in found.rows if not r.kept])
    hazy = planned(scene(), Given("a", TwoScale(), HAZY))
    assert {row.effect.name for row in hazy.rows if row.kept} >= {"diffraction", "specular reflection"}


def test_a_smaller_tolerance_keeps_more():
    given = Given("a", TwoScale("lambert"), MATTE)
    loose, tight = (planned(scene(tolerance={"cielab": x}), given) for x in (20.0, 1e-4))
    kept = [{row.effect.name for row in each.rows if row.kept} for each in (loose, tight)]
    assert kept[0] < kept[1]
    assert loose.off_by <= 20
    assert tight.off_by <= 1e-4


def test_the_picture_keeps_the_tolerance_that_the_plan_found():
    made, given = scene(), Given("a", TwoScale("lambert"), MATTE)
    found = planned(made, given)
    whole, same = pictures(Film(made, stage(made)), [drawn(given.finest())], [[given.of(found.chosen)]])
    assert off_by(whole, same, made.tolerance).max() <= 1.0


def test_each_effect_is_another_program_or_is_not_listed():
    model = finest(TwoScale("plastic", split="conserving"))
    assert [effect.name for effect in effects_of(model)] == list(EVERY)
    assert "diffraction" not in [effect.name for effect in effects_of(TwoScale(diffraction="off"))]
    assert without(model, []) == model
    assert without(model, [EVERY["diffraction"], EVERY["blur of diffraction"]]).diffraction == "off"
    nothing_sharp = without(TwoScale("lambert"), [EVERY["diffraction"], EVERY["specular reflection"]])
    assert isinstance(nothing_sharp, Part)
    assert not nothing_sharp.lobes
    # masking has nothing left to act on
    more = without(TwoScale("lambert"), [EVERY["diffraction"], EVERY["specular reflection"], EVERY["masking"]])
    assert more == nothing_sharp


def test_a_real_index_stays_real_without_the_body():
    assert without(TwoScale("plastic"), [EVERY["body"]]).index == "real"


def test_rivals_lose_lobes_and_bodies():
    model = models()["ggx"]()
    names = [effect.name for effect in effects_of(model)]
    assert names == ["specular lobe", "body"]
    assert without(model, effects_of(model)) == Part(model, (), False)


def test_units_of_tolerances():
    one, other = np.full((2, 3), 0.5), np.array([[0.5, 0.5, 0.55], [0.5, 0.5, 0.5]])
    np.testing.assert_allclose(off_by(one, other, Tolerance(radiance=0.1)), [0.1, 0.0])
    assert off_by(one, other, Tolerance(cielab=1.0))[0] > 1
    assert off_by(0 * one, 0 * one + 0.001, Tolerance(radiance=0.1))[0] == pytest.approx(0.1)  # of a hundredth of white


@pytest.mark.parametrize(("index", "body"), [*KINDS, *FILMS])
def test_every_effect_of_every_kind_can_be_left_out(index, body):
    material = TwoScale(body, index=index)
    for effect in effects_of(material):
        assert without(material, [effect]) != material
    assert without(material, effects_of(material)) != material
