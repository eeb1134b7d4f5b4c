"""The spectral bands of a measurement: their names, and a wavelength that stands for each."""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

ColourSpace = Literal["linear RGB of MERL, as stored", "linear RGB, as stored", "none: a channel is a wavelength"]
"""Colour space of a measurement's channels; nothing is converted."""


@dataclass(frozen=True)
class Bands:
    """Bands in the order of the measurement's planes; hashable, static under jit.

    Attributes:
        names: of the bands, each once. wavelengths_um: one for each (micrometres).
    """

    names: tuple[str, ...]
    wavelengths_um: tuple[float, ...]

    def __post_init__(self) -> None:
        """Refuse bands without a name or a wavelength of their own."""
        if not self.names or len(set(self.names)) < len(self.names) or "" in self.names:
            raise ValueError(f"bands need different names, one each, not {self.names}")
        if len(self.wavelengths_um) != len(self.names):
            raise ValueError(f"{len(self.names)} bands need as many wavelengths, not {len(self.wavelengths_um)}")
        if not all(math.isfinite(x) and x > 0 for x in self.wavelengths_um):
            raise ValueError(f"wavelengths must be positive (micrometres), not {self.wavelengths_um}")

    def __len__(self) -> int:
        return len(self.names)

    @property
    def middle(self) -> int:
        """Which band stands for all where one has to."""
        return len(self.names) // 2

    @property
    def middle_um(self) -> float:
        """Its wavelength."""
        return self.wavelengths_um[self.middle]


MERL = Bands(("R", "G", "B"), (0.645, 0.526, 0.444))
"""Those of MERL's files; the wavelengths are HP17's (Section 5)."""
XYZ = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
)
"""CIE XYZ of linear sRGB, whose white is D65."""
SHOWN = 3  # names of channels that a line repeats


def filled(values: np.ndarray, bands: Bands) -> tuple[np.ndarray, Bands, list[str]]:
    """Which channels (C, ...) hold anything but zeros, their bands, and a line on those that do not.

    All of them if none does: then there is nothing to fit.
    """
    some = np.array([bool(np.any((plane != 0) & np.isfinite(plane))) for plane in values])
    if some.all() or not some.any():
        return np.ones(len(some), bool), bands, []
    rows = np.flatnonzero(some)
    kept = Bands(tuple(bands.names[k] for k in rows), tuple(bands.wavelengths_um[k] for k in rows))
    empty = [name for name, k in zip(bands.names, some, strict=True) if not k]
    more = f" and {len(empty) - SHOWN} more" if len(empty) > SHOWN else ""
    are = "channels {} are" if len(empty) > 1 else "channel {} is"
    remark = f"{are.format(', '.join(empty[:SHOWN]) + more)} zero everywhere or blank, and left out"
    return some, kept, [remark]
