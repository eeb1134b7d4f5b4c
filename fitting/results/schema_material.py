"""What was fitted to what: the file, the model, and what the apparatus does to the material."""

from dataclasses import asdict
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import jax.numpy as jnp
from pydantic import Field, model_validator

from ...merl_io import inputs
from ...merl_io.bands import Bands, ColourSpace
from ...merl_io.columns import PLAUSIBLE_UM
from ...merl_io.scattered import Format, Quantity
from ...model.apparatus import APPARATUS, Apparatus, GrazingLoss
from ...model.measured import Measured
from ...model.reflectance import Reflectance, Values
from ...model.registry import made
from .strict import FileName, Many, Strict, Text, same_length


class Source(Strict):
    """Where the data came from."""

    format: Literal["MERL"] | Format
    """Format of the file: MERL's bins, a table of scattered directions, or another program's (docs/formats.md)."""
    path: Text
    """File that was fitted, as it was named; relative to where the fit ran, unless it is absolute."""
    material: FileName
    """Name of the file without its folder and its ending."""
    sha1: str
    """SHA-1 of the file."""
    git_blob_sha1: str
    """SHA-1 of the file as git computes it for a blob."""
    genuine_merl: str | None
    """Name of the MERL material whose published file this is, bit by bit; null for any other file."""
    dims: tuple[int, int, int] | None
    """Numbers of bins of theta_h, theta_d and phi_d in the file; null of scattered directions."""
    fraction_valid: float
    """Share of the bins that hold a datum in every channel; of scattered directions that of values that are data."""
    outliers: int | None
    """Number of valid bins that are very much brighter than their neighbours; null of scattered directions."""
    fraction_uncertain: float | None = None
    """Share of the data whose uncertainty the file states; null of a file that states none."""

    quantity: Quantity = "brdf"
    """What the file's numbers are, as the user declared it; everything here is of BRDFs."""

    def read(self, file: Path) -> inputs.Input:
        """The data again, from a file that has to be the one that was fitted.

        Raises:
            merlfit.merl_io.binary.MerlError: it cannot be used, or is another one.
        """
        return inputs.read(file, self.sha1, self.dims, quantity=self.quantity)


class Acquisition(Strict):
    """What the apparatus does to the material."""

    grazing_loss: Annotated[float, Field(ge=0, le=1)] | GrazingLoss
    """Loss of light at grazing angles: ``off``, ``free`` (exponents are parameters), ``derived`` from the widths of the
    lobes, or the exponent itself."""
    apparatus: Apparatus | None = None
    """Sphere, pixel and lamp that a derived loss assumes; null otherwise."""
    exponents: dict[str, float]
    """Exponent of the loss by sharp lobe, ``specular`` or ``diffracted`` (HP17 Eq. 60); 0 where no light is lost."""


class Model(Strict):
    """What was fitted: a material, and what the apparatus made of it."""

    name: str
    """Name of the material's model (``merlfit models``)."""
    settings: dict[str, Any]
    """Settings of the model by name; of the two-scale model, which physical effects it simulates."""
    acquisition: Acquisition
    """What the apparatus does to the material."""
    channels: Many[str]
    """Names of the colour channels; lists by channel have this order."""
    colour_space: ColourSpace = "linear RGB of MERL, as stored"
    """Colour space of channels and albedos. The files have no white point of their own; nothing is converted."""
    wavelengths_um: Many[float]
    """Wavelength that stands for each channel (micrometres)."""

    @model_validator(mode="after")
    def _of_a_fit(self) -> Self:
        low, high = PLAUSIBLE_UM
        if self.acquisition.exponents.keys() != {*self.material.lobes}:
            raise ValueError(f"acquisition.exponents should be those of {', '.join(self.material.lobes) or 'no lobe'}")
        if not self.channels or len(set(self.channels)) < len(self.channels):
            raise ValueError(f"channels should be different names, not {', '.join(self.channels) or 'none'}")
        same_length("channels", len(self.channels), wavelengths_um=self.wavelengths_um)
        for x in self.wavelengths_um:
            if not low <= x <= high:
                raise ValueError(f"wavelengths_um {x:g} is not between {low:g} and {high:g}")
        return self

    @classmethod
    def of(
        cls, model: Measured, values: Values, bands: Bands, colour_space: ColourSpace = "linear RGB of MERL, as stored"
    ) -> Self:
        """What a fit with these parameter values was of."""
        material, derived = model.material, model.grazing_loss == "derived"
        given = {name: jnp.asarray(x) for name, x in values.items()}
        return cls(
            name=material.name,
            settings=asdict(material),  # pyright: ignore[reportArgumentType] - models are dataclasses
            acquisition=Acquisition(
                grazing_loss=model.grazing_loss, apparatus=model.apparatus if derived else None,
                exponents={lobe: float(model.exponent(lobe, given, bands.wavelengths_um)) for lobe in model.lobes},
            ),
            channels=list(bands.names), colour_space=colour_space, wavelengths_um=list(bands.wavelengths_um),
        )  # fmt: skip

    @cached_property
    def measured(self) -> Measured:
        """The model that was fitted: the material as the apparatus sees it."""
        a = self.acquisition
        return Measured(made(self.name, self.settings), a.grazing_loss, a.apparatus or APPARATUS)

    @property
    def material(self) -> Reflectance:
        """The material, without the apparatus."""
        return self.measured.material

    @property
    def bands(self) -> Bands:
        """Channels and their wavelengths."""
        return Bands(tuple(self.channels), tuple(self.wavelengths_um))
