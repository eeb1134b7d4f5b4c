"""The materials of the benchmarks: neural reconstructions of MERL (Sztrajman et al. 2021), not measurements."""

from pathlib import Path

import numpy as np

from ..support import reconstructions
from .processes import worker

BODIES = {
    "none": ("chrome", "nickel", "aluminium", "brass", "gold-metallic-paint2", "tungsten-carbide"),
    "plastic": ("gray-plastic", "blue-acrylic", "white-marble", "red-plastic", "alumina-oxide", "yellow-phenolic"),
}
TWELVE = {material: body for body, materials in BODIES.items() for material in materials}


def file(folder, material):
    """Its MERL file in the folder, made if it is not there."""
    path = Path(folder) / f"{material}.binary"
    return path if path.is_file() else reconstructions.make(folder, material)


def measured(record, materials, folder, *arguments):
    """Materials that an unfinished run of the section lacks, and what its ``measure`` finds of file and body.

    Every one in a process of its own, with further arguments.
    """
    record.resume()
    for material in materials:
        if material not in record.column("material"):
            yield material, worker(record.section, file(folder, material), TWELVE[material], *arguments)[0]


def every():
    """Names of all 100 materials."""
    with np.load(reconstructions.maker().NETWORKS) as networks:
        return sorted({key.split("/")[0] for key in networks.files})
