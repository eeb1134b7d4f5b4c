"""Fits of Disney's model and of OpenPBR as other programs take them: their parameters as they are, with intervals."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from ...merl_io.bands import MERL
from ...model.body import internal_diffuse_reflectance
from ...model.reflectance import Values
from ...model.rivals.common import mix
from ...model.rivals.openpbr import base_ratio, base_width
from ..results.schema import Result
from ..support.numbers import number
from .nearest_ggx import apart

OWN = {"principled": "disney", "gltf": "disney", "openpbr": "openpbr", "blender": "openpbr"}
"""Formats that take the parameters of a model as they are."""
MITSUBA = {
    "baseColor": "base_color", "roughness": "roughness", "metallic": "metallic", "specular": "specular",
    "specularTint": "spec_tint", "sheen": "sheen", "sheenTint": "sheen_tint", "clearcoat": "clearcoat",
    "clearcoatGloss": "clearcoat_gloss", "subsurface": "flatness",
}  # fmt: skip
"""What Mitsuba's plugin `principled` calls them."""
COAT = 4.0  # times as bright along the normal is Mitsuba's clearcoat, without Disney's 1 / (4 cos_i cos_o)
FIXED = {"base_weight": 1.0, "specular_weight": 1.0, "coat_darkening": 1.0}
"""What the model of OpenPBR's base and coat has fixed."""
WITHOUT = ("specularTint", "sheen", "sheenTint", "clearcoat", "clearcoatGloss", "subsurface")
"""What glTF's metallic-roughness material has no counterpart of."""


def is_own(result: Result, to: str) -> bool:
    """Whether a format takes this fit's parameters: its model, and colours as the format has them."""
    model = result.model
    assert model is not None
    return model.name == OWN.get(to) and set(model.channels) == set(MERL.names)


def values_of(result: Result) -> dict[str, Any]:
    """Numbers, and lists of three for colours, by name, without the apparatus."""
    found = {name: np.asarray(x) for name, x in result.values().items() if not name.startswith("grazing_")}
    return {name: x.tolist() if x.ndim else float(x) for name, x in found.items()}


def intervals_of(result: Result) -> dict[str, list[float] | None]:
    """90 % intervals by name and channel; None where the data do not decide."""
    found = {}
    for q in (q for q in result.parameters if not q.parameter.startswith("grazing_")):
        known = q.quantiles or q.laplace
        found[q.name] = None if known is None else [known.q05, known.q95]
    return found


def in_words(result: Result) -> str:
    """The parameters with their intervals, in a line."""
    known, edits, said = intervals_of(result), result.edited_from.fitted if result.edited_from else {}, []
    for q in (q for q in result.parameters if q.name in known):
        ends = known[q.name]
        none = "edited" if q.name in edits else "not decided by the data"
        between = none if ends is None else f"{number(ends[0])} .. {number(ends[1])}"
        said.append(f"{q.name} {number(q.value)} ({between})")
    return "the fitted parameters themselves, with 90 % intervals: " + ", ".join(said)


def mitsuba_inputs(result: Result) -> dict[str, Any]:
    """What Mitsuba's `principled` is given of a fit of Disney's model."""
    values = values_of(result)
    return {MITSUBA[n]: x / COAT if n == "clearcoat" else x for n, x in values.items()}


def metallic_roughness(result: Result, bins: np.ndarray) -> dict[str, Any]:
    """What `export.to_gltf` writes of a fit of Disney's model, and how far spheres are from those of its bins."""
    v = values_of(result)
    root = np.sqrt(0.08 * v["specular"])
    found = {
        "base_color": v["baseColor"], "metallic": v["metallic"], "roughness": v["roughness"],
        "ior": float((1 + root) / (1 - root)),
    }  # fmt: skip
    off = apart(bins, "gltf", *found.values())
    return {
        **found,
        "error": {"cielab": off},
        "intervals": intervals_of(result),
        "left_out": {n: v[n] for n in WITHOUT},
    }


def blender_inputs(result: Result) -> dict[str, Any]:
    """As `openpbr_inputs`, the base as it is seen under its coat, since Blender's coat leaves what is below it alone.

    Colour by the specification's "Darkening" along the normal, roughness by "Roughening", and the index of the
    dielectric beside the coat's (`base_ratio`). Without that plastics under a coat are a third too bright in Blender.
    """
    inputs = openpbr_inputs(result)
    color, roughness, ratio = _under_coat({name: np.asarray(x, float) for name, x in inputs.items()})
    return {
        **inputs, "base_color": color.tolist(), "specular_roughness": float(roughness), "specular_ior": float(ratio)
    }  # fmt: skip


@jax.jit
def _under_coat(v: Values) -> tuple[Array, Array, Array]:
    """Colour, roughness and index of the base."""
    ratio, n, metal = base_ratio(v), v["coat_ior"], v["base_metalness"]
    along, beside = (((x - 1) / (x + 1)) ** 2 for x in (n, ratio))
    albedo = mix(mix(v["base_color"], 1.0, beside), v["base_color"], metal)
    rough = mix(mix(1.0, v["specular_roughness"], beside), v["specular_roughness"], metal)
    back = mix(along, internal_diffuse_reflectance(n), rough)
    darkened = v["base_color"] * mix(1.0, (1 - back) / (1 - albedo * back), v["coat_weight"])
    return darkened, jnp.sqrt(base_width(v)), ratio


def openpbr_inputs(result: Result) -> dict[str, Any]:
    """Values by OpenPBR's names, with those that the model has fixed."""
    return {**FIXED, **values_of(result)}
