"""What a fit simulated and what it left out, in words, and the command that makes it again."""

import shlex

import numpy as np

from ...merl_io.inputs import SCATTERED
from ...model.two_scale import TwoScale
from ..pipeline.editing import as_set
from ..results.schema import Result
from .terminal_tables import number

DIFFRACTION = {
    "lobe": "with the normals of facets taken as all alike",
    "quadrature": "blurred by the distribution of normals, by quadrature",
    "exact": "blurred by the distribution of normals, exactly",
}
SPLITS = {
    "printed": "as printed",
    "conserving": "such that no energy is made",
    "free": "as printed, but for a weight of the diffracted light in every channel",
}
BODIES = {
    "lambert": "a Lambert body under the interface",
    "plastic": "a diffuse body whose light crosses the interface twice",
    "subsurface": "light that was scattered below the surface",
}  # fmt: skip
NEVER = (
    "light that the surface scatters more than once, where the model does not say otherwise",
    "interreflection between samples, polarisation, fluorescence, anisotropy: no fit here has them",
    "the spectrum within a channel: one wavelength stands for it",
)


INTERFACES = {"complex": "a conductor", "real": "a dielectric", "film": "a thin film, which interferes, over matter"}


def simulated(result: Result) -> list[str]:
    """Effects that the fit has, a line each."""
    if result.model is None:
        return []
    m = result.model.material
    said = [f"the {m.name} model"] if not isinstance(m, TwoScale) else _two_scale(m)
    exponents = {lobe: x for lobe, x in result.model.acquisition.exponents.items() if x}
    if exponents:
        lost = " and ".join(f"{number(x, 3)} of {lobe} light" for lobe, x in exponents.items())
        how = "loss of light at grazing angles, by MERL's apparatus: exponent"
        said.append(f"{how} {lost} ({result.model.acquisition.grazing_loss})")
    return said


def _two_scale(m: TwoScale) -> list[str]:
    interface = INTERFACES[m.index]
    masked = "no masking" if m.masking == "none" else f"{m.masking.replace('_', ' ')} masking"
    fresnel = "Fresnel's formulas" if m.fresnel == "exact" else "Schlick's polynomial"
    said = [f"reflection by microfacets of {interface}: {fresnel}, {masked}"]
    if m.diffraction != "off":
        colour = "Rayleigh-Rice" if m.colour == "rayleigh_rice" else "the film" if m.index == "film" else "Fresnel"
        said.append(
            f"diffraction by nano-geometry: {DIFFRACTION[m.diffraction]}; colour by {colour}, "
            f"energy split {SPLITS[m.split]}"
        )
    if m.body in BODIES:
        said.append(BODIES[m.body])
    return said


def left_out(result: Result) -> list[str]:
    """What the fit does not have, a line each, and why where that is known."""
    if result.model is None:
        return []
    m, said = result.model.material, []
    if isinstance(m, TwoScale):
        if m.diffraction == "off":
            said.append("diffraction by nano-geometry: switched off")
        if m.body == "none":
            compared = len(result.fit.candidates) > 1
            said.append("a body under the interface" + (": the choice between kinds did without" if compared else ""))
        if m.masking == "none":
            said.append("masking and shadowing: switched off")
    if result.model.measured.lobes and not result.model.measured.loses:
        said.append("loss of light at grazing angles by the apparatus")
    if (limit := result.theta_max) is not None:
        said.append(f"directions past {np.degrees(limit):.0f} degrees from the normal: neither fitted nor assessed")
    return [*said, *NEVER]


def again(result: Result) -> str:
    """What makes an edited material again, in Python; or the command that fitted the file; empty without one."""
    if (origin := result.edited_from) is None:
        return shlex.join(reproducing(result))
    changed = {q.name: q.value for q in result.parameters if q.name in origin.fitted}
    values = ", ".join(f"{name}={value!r}" for name, value in as_set(result, changed).items())
    return f"merlfit.load({origin.result!r}).edited({values})"


def reproducing(result: Result) -> list[str]:
    """The words of the command that fitted this file, of a batch without its other files."""
    words = [str(word) for word in result.run.command]
    own = result.source.path
    if own not in words:
        return words
    measured = (".binary", *SCATTERED)
    return [
        word for k, word in enumerate(words)
        if word == own or not word.lower().endswith(measured) or words[k - 1] in ("-o", "--out")
    ]  # fmt: skip
