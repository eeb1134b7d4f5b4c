"""Inputs of kinds that people met with other programs (../shared/cases): each is fitted with GGX to what is right."""

import pytest
from merlfit.fitting.fit.outcome import NINETY
from merlfit.fitting.pipeline.run import fit_file
from merlfit.fitting.settings.config import load


@pytest.fixture(scope="module")
def fitted(cases, tmp_path_factory):
    """Result of a file, by its name in the folder of cases."""
    config = load(model="ggx", posterior=False)
    return lambda name: fit_file(cases / name, tmp_path_factory.mktemp("fits"), config)


def error(q):
    """Standard error, of an interval that is nearly symmetric."""
    return (q.laplace.q95 - q.laplace.q05) / (2 * NINETY)


def close(result, **truth):
    """Whether parameters are what they should be, within two standard errors or 1 %."""
    found = {q.name: q for q in result.parameters}
    for name, value in truth.items():
        assert found[name].value == pytest.approx(value, rel=0.01, abs=2 * error(found[name])), name


def test_negative_values_are_data(fitted):
    """A dark signal was subtracted. Without what is negative the albedo comes out at 1.65e-3."""
    result = fitted("03/dark.csv")
    close(result, alpha=0.05, F0_550nm=0.04, albedo_550nm=6.28e-4)
    (albedo,) = (q for q in result.parameters if q.name == "albedo_550nm")
    assert error(albedo) < 1e-4
    assert result.fit.status == "CONVERGED"


def test_channels_of_zeros_spoil_nothing(fitted):
    result, alone = fitted("08/rzero.csv"), fitted("08/ronly.csv")
    close(result, alpha=0.149, F0_645nm=0.04, albedo_645nm=0.2)
    assert result.values() == alone.values()
    assert any("channels 526nm, 444nm are zero everywhere" in each for each in result.fit.cautions)


def test_a_hot_sample_changes_neither_values_nor_errors(fitted):
    plain = {q.name: q for q in fitted("09/plain.csv").parameters}
    for name in ("09/spike10.csv", "09/spike.csv"):
        result = fitted(name)
        for q in result.parameters:
            assert q.value == pytest.approx(plain[q.name].value, abs=error(plain[q.name])), name
            assert error(q) == pytest.approx(error(plain[q.name]), rel=0.1), name
        assert any("line 313 " in each for each in result.fit.cautions)


def test_the_far_infrared(fitted):
    result = fitted("13/co2.csv")
    assert (result.model.channels, result.fit.status) == (["10600nm"], "CONVERGED")
    close(result, alpha=0.149, F0_10600nm=0.04, albedo_10600nm=0.2)
