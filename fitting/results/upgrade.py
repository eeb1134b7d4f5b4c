"""Results of older schema versions, as the present one has them."""

from typing import Any

from ...merl_io.binary import DIMS
from ...model.effects import TWO_SCALE

DROPPED = "zonal_order"  # of a tier that is no more; in all results, whatever their tier
NINETY = 1.6449  # standard deviations to both sides that hold 90 % of a normal distribution


def upgraded(data: Any) -> Any:  # noqa: ANN401 - plain data of JSON
    """An older version as 2.4; what is missing or wrong is left for the reader of that to complain about.

    1.x knew the two-scale model alone, and had the acquisition among its effects; 2.0 lacked a field that may be null;
    before 2.2 every file was MERL's, before 2.3 parameters had standard errors, of
    which symmetric intervals are made; before 2.4 the two-scale model had a setting more.
    """
    found = _upgraded(data)
    if isinstance(found, dict):
        for part, name in (("model", "settings"), ("config", "effects")):
            if isinstance(whole := found.get(part), dict) and isinstance(settings := whole.get(name), dict):
                kept = {key: value for key, value in settings.items() if key != DROPPED}
                found[part] = {**whole, name: kept}
    return found


def before_2_4(model: dict[str, Any] | None) -> dict[str, Any] | None:
    """What was fitted with the setting that the two-scale model had until then, at its place."""
    if model is None or model["name"] != TWO_SCALE:
        return model
    settings = {}
    for key, value in model["settings"].items():
        settings[key] = value
        if key == "order":
            settings[DROPPED] = 100
    return {**model, "settings": settings}


def _upgraded(data: Any) -> Any:  # noqa: ANN401 - plain data of JSON
    if not isinstance(data, dict):
        return data
    found = {**data, "schema_version": "2.4"}
    if data.get("schema_version") == "2.3":
        return found
    if isinstance(parameters := data.get("parameters"), list):
        found["parameters"] = [_parameter(each) for each in parameters]
    if isinstance(source := data.get("source"), dict):
        found["source"] = {"format": "MERL", "dims": DIMS, **source}
    if data.get("schema_version") in ("2.0", "2.1", "2.2"):
        return found
    model, fit, config = (data.get(key) for key in ("model", "fit", "config"))
    if isinstance(model, dict) and isinstance(model.get("effects"), dict):
        found["model"] = _model(model)
    if isinstance(fit, dict) and isinstance(fit.get("candidates"), list):
        found["fit"] = {**fit, "candidates": [_candidate(each) for each in fit["candidates"]]}
    if isinstance(config, dict) and isinstance(effects := config.get("effects"), dict) and "acquisition" in effects:
        own = {key: value for key, value in effects.items() if key != "acquisition"}
        found["config"] = {**config, "effects": own, "acquisition": {"grazing_loss": effects["acquisition"]}}
    return found


def _model(model: dict[str, Any]) -> dict[str, Any]:
    effects = dict(model["effects"])
    loss, apparatus = effects.pop("acquisition", "off"), effects.pop("apparatus", None)
    exponents = {"specular": model.get("grazing_exponent", 0.0)}
    if effects.get("diffraction") != "off":
        exponents["diffracted"] = model.get("grazing_exponent_diffracted")
    kept = {k: v for k, v in model.items() if k not in ("effects", "grazing_exponent", "grazing_exponent_diffracted")}
    acquisition = {
        "grazing_loss": loss, "apparatus": apparatus if loss == "derived" else None, "exponents": exponents,
    }  # fmt: skip
    return {"name": TWO_SCALE, **kept, "settings": effects, "acquisition": acquisition}


def _parameter(parameter: Any) -> Any:  # noqa: ANN401 - plain data of JSON
    if not isinstance(parameter, dict):
        return parameter
    kept = {key: value for key, value in parameter.items() if key != "standard_error"}
    keys = ("value", "standard_error", "lower", "upper")
    numbers = [x for key in keys if isinstance(x := parameter.get(key), int | float)]
    if len(numbers) < len(keys):
        return {"laplace": None} | kept
    value, error, lower, upper = numbers
    ends = {"q05": max(lower, value - NINETY * error), "q50": value, "q95": min(upper, value + NINETY * error)}
    return {"laplace": ends} | kept


def _candidate(candidate: Any) -> Any:  # noqa: ANN401 - plain data of JSON
    if not isinstance(candidate, dict):
        return candidate
    kept = {key: value for key, value in candidate.items() if key not in ("index", "body")}
    index, body = candidate.get("index", "usual"), candidate.get("body")
    if index == "usual":  # before version 1.3
        index = "complex" if body == "none" else "real"
    return {"model": TWO_SCALE, "variant": f"{index} {body}", **kept}
