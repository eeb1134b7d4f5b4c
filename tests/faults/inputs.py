"""Damaged tables and damaged files of RGL's kind through the loaders."""

import io
import struct
import tracemalloc
import zipfile

import numpy as np
from merlfit.merl_io import inputs
from merlfit.merl_io.source import MerlError
from merlfit.merl_io.tensor import packed

from ..support import rgl_files
from .loaders import HEADER, HOSTILE, Executed, damaged, trial

TABLE = """# made
theta_i_deg,theta_o_deg,phi_deg,weight,450nm,0.55um,650.5nm
0,30,0,1,1,2,3
30, 30, 180,2, 10, 20, 30
60,10,90,0.5,0.5,-1,0.25
"""
CELLS = [
    "", "x", "nan", "inf", "-1", "90", "1e400", "1e-400", '"', "#", "1,1", "0x10", "1_0", "\u0661", "9" * 5000, "=1+1",
    "550nm", "weight", "R", "0nm", "1e9nm",
]  # fmt: skip
ARRAYS = {
    "theta_i_deg": np.array([0.0, 30, 60]), "theta_o_deg": np.array([30.0, 30, 10]),
    "phi_deg": np.array([0.0, 180, 90]), "wavelengths_um": np.array([0.45, 0.55, 0.6505]),
    "values": np.array([[1.0, 2, 3], [10, 20, 30], [0.5, -1, 0.25]]), "weight": np.array([1.0, 2, 0.5]),
}  # fmt: skip


def table(rng):
    """CSV with other bytes, or other cells, or its lines shuffled."""
    kind = rng.randrange(3)
    if kind == 0:
        return damaged(rng, TABLE.encode())
    lines = [line.split(",") for line in TABLE.splitlines()]
    if kind == 1:
        for _ in range(rng.randint(1, 3)):
            line = rng.choice(lines)
            line[rng.randrange(len(line))] = rng.choice(CELLS)
    else:
        lines = rng.choices(lines, k=rng.randint(0, 9))
    return "\n".join(",".join(line) for line in lines).encode()


def archive(rng):
    """NPZ with other bytes, or with an array of another kind."""
    name = rng.choice(sorted(ARRAYS))
    shape = ARRAYS[name].shape
    others = [
        np.full(shape, np.nan), np.full(shape, -1.0), np.full(shape, 1e308), np.empty(0), np.ones((2, 2, 2)), HEADER,
        np.array("x" * 99), np.zeros(shape, complex), np.array([Executed()], object), np.ones(shape, bool), None,
    ]  # fmt: skip
    arrays = ARRAYS | {name: rng.choice(others)} if rng.random() < 0.5 else ARRAYS
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as made:
        for each, array in arrays.items():
            if array is not None:
                member = io.BytesIO()
                if not isinstance(array, bytes):
                    np.lib.format.write_array(member, array)
                made.writestr(f"{each}.npy", array if isinstance(array, bytes) else member.getvalue())
    return file.getvalue() if arrays is not ARRAYS else damaged(rng, file.getvalue())


def fields(spectral=True):
    """Of a small file of RGL's kind."""
    where = rgl_files.parameterization(0.4, (0, 30, 60), resolution=8, nodes=5)
    nm = np.array([450, 550, 650]) if spectral else None
    return rgl_files.made(where, lambda i, o, phi: np.ones((3, len(phi))), nm)


def tensors(rng, known):
    """Of RGL's kind: other bytes, header or length, hostile numbers, a field of another shape or type or none."""
    kind = rng.randrange(5)
    if kind < 3:
        content = packed(known)
        if kind == 0:
            return damaged(rng, content)
        if kind == 1:
            header = bytearray(content)
            at = rng.randrange(14, 300)
            size = rng.choice("BHIQ")
            value = rng.choice([0, 1, 2, 255, 65535, 2**31, 2**32 - 1, 2**63, 2**64 - 1, len(content)])
            header[at : at + struct.calcsize(size)] = struct.pack(f"<{size}", value % 2 ** (8 * struct.calcsize(size)))
            return bytes(header)
        return content[: rng.randrange(len(content))] if rng.random() < 0.5 else content + rng.randbytes(99)
    name = rng.choice(sorted(known))
    array = known[name].copy()
    if kind == 3 and array.dtype == np.float32:
        flat = array.reshape(-1)
        with np.errstate(over="ignore"):
            flat[[rng.randrange(flat.size) for _ in range(rng.choice([1, 3, flat.size]))]] = rng.choice(HOSTILE)
    else:
        array = rng.choice([
            array.astype(np.float64), array.reshape(-1), array[:0], np.repeat(array, 3, 0), array[..., :1],
            array.astype(np.uint8), array.reshape((*array.shape, 1)),
        ])  # fmt: skip
    changed = {each: x for each, x in (known | {name: array}).items() if each != name or rng.random() < 0.9}
    return packed(changed)


def as_documented(found, path):
    """What is wrong with scattered directions that were read."""
    count = len(found.theta_i)
    angles = np.stack([found.theta_i, found.theta_o])
    if found.values.shape != (len(found.bands), count) or not found.phi.shape == found.share.shape == (count,):
        return "shapes do not agree"
    if not (np.isfinite(found.phi).all() and (angles >= 0).all() and (angles < np.pi / 2).all()):
        return "a direction is none, or below the horizon"
    if not (np.isfinite(found.share).all() and (found.share >= 0).all()):
        return "a share is negative or not finite"
    if np.isinf(found.values).any() or (found.values < 0).any() or not found.valid.any():
        return "a value is negative or infinite, or none is a datum"
    return ""


def run(tried, few=False):
    """All of them."""
    share = 20 if few else 1
    whole = {spectral: fields(spectral) for spectral in (True, False)}
    tracemalloc.start()
    for what, make, suffix, count in (
        ("tables, CSV", table, ".csv", 500), ("tables, NPZ", archive, ".npz", 500),
        ("files of RGL's kind, spectral", lambda rng: tensors(rng, whole[True]), ".bsdf", 500),
        ("files of RGL's kind, RGB", lambda rng: tensors(rng, whole[False]), ".bsdf", 500),
    ):  # fmt: skip
        trial(tried, what, make, inputs.read, MerlError, as_documented, count // share, suffix, "inputs")
    tracemalloc.stop()
