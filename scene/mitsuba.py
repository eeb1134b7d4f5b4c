"""Materials inside Mitsuba 3: the BSDF ``merlfit``, whose tables `merlfit export --to mitsuba` writes.

:func:`register` makes it known to the variant that is set (``mitsuba.set_variant``), scalar or LLVM, of three channels
or spectral (`colour.reflectances` of R, G and B then), not polarised; it needs the extra
``merlfit[mitsuba]``. ``python -m merlfit.scene.mitsuba SCENE.xml -o PICTURE.exr`` renders a scene with it. LLVM
variants need LLVM's library: Debian's libllvm19, found here, or ``DRJIT_LIBLLVM_PATH``.
"""

# pyright: reportMissingImports=false

import argparse
import os
import sys
import time
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from ..merl_io.archive import arrays
from ..merl_io.source import PLAIN, MerlError, opened, shortened
from .colour import REFLECTANCE_NM, reflectances

LIBRARIES = tuple(
    f"/usr/lib/{folder}/libLLVM{end}"
    for folder in ("x86_64-linux-gnu", "llvm-19/lib", "aarch64-linux-gnu")
    for end in (".so.19.1", "-19.so.1", "-19.so")
)
if "DRJIT_LIBLLVM_PATH" not in os.environ:
    there = [path for path in LIBRARIES if Path(path).exists()]
    if there:
        os.environ["DRJIT_LIBLLVM_PATH"] = there[0]

import drjit  # noqa: E402 - of the extra; after its library is named
import mitsuba  # noqa: E402

dr: Any = drjit  # types of values depend on the variant
mi: Any = mitsuba

# as in `model.sampling.visible`, without JAX (tests/scene/test_mitsuba.py), but for SMALLEST: here it is of float32
CELLS, LINEAR, STEEPEST = 256, 2e-4, 1e3
GRAZING, INCIDENCES, NEWTON, SMALLEST = np.radians(89.9), 48, 5, 1e-6
LONGEST = float(np.arcsinh(STEEPEST / LINEAR))
TABLES = {"brdf", "share", "below"}
PICTURES = (".exr", ".png")
PASS = 4  # samples of a pixel, between two words of a scalar variant


def make() -> type:
    """The BSDF's class for the variant that is set."""

    class Merlfit(mi.BSDF):
        """A tabulated isotropic BRDF, with directions drawn as facets are seen."""

        def __init__(self, props: Any) -> None:  # noqa: ANN401 - of Mitsuba
            mi.BSDF.__init__(self, props)
            self.path = str(mi.file_resolver().resolve(props["filename"]))  # beside the scene
            with opened(Path(self.path)) as (file, _):
                found = arrays(file, TABLES.__contains__)
            if missing := TABLES - found.keys():
                raise MerlError(f"{self.path}: has no {', '.join(sorted(missing))}, as `merlfit export` writes them")
            brdf, share, below = (found[name] for name in ("brdf", "share", "below"))
            linear, nearest = dr.FilterMode.Linear, dr.FilterMode.Nearest
            self.brdf = mi.Texture3f(mi.TensorXf(brdf), filter_mode=linear, wrap_mode=dr.WrapMode.Clamp)
            self.share, self.below = (
                mi.Texture2f(mi.TensorXf(x[..., None]), filter_mode=nearest, wrap_mode=dr.WrapMode.Clamp)
                for x in (share, below)
            )
            self.spectra = mi.Texture1f(
                mi.TensorXf(reflectances().T.astype(np.float32)), filter_mode=linear, wrap_mode=dr.WrapMode.Clamp
            )
            flags = mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.FrontSide
            self.m_components = [flags]
            self.m_flags = flags

        def _value(self, wi: Any, wo: Any, wavelengths: Any) -> Any:  # noqa: ANN401
            half = wi + wo
            length = dr.maximum(dr.norm(half), 1e-8)
            sine = dr.sqrt(half.x * half.x + half.y * half.y) / length
            tangent = dr.sqrt(half.x * half.x + half.y * half.y) / dr.maximum(half.z, 1e-8)
            theta_d = dr.atan2(dr.norm(wi - wo), length)
            cos_phi = dr.abs(wo.z - wi.z) / dr.maximum(2 * sine * dr.sin(theta_d), 1e-9)
            place = (
                dr.asinh(tangent / LINEAR) / LONGEST,
                theta_d * (2 / dr.pi),
                dr.acos(dr.minimum(cos_phi, 1.0)) * (2 / dr.pi),
            )
            *logs, weight = self.brdf.eval(mi.Point3f(place[2], place[1], place[0]))
            inverse = dr.select(weight > 0, 1 / dr.maximum(weight, 1e-8), 0.0)
            colour = [dr.exp(x * inverse) for x in logs]
            value = self._spectrum(colour, wavelengths) if mi.is_spectral else mi.Color3f(*colour)
            return dr.select((wi.z > 0) & (wo.z > 0) & (weight > 0), value, 0.0)

        def _spectrum(self, colour: list[Any], wavelengths: Any) -> Any:  # noqa: ANN401
            """Of R, G and B at the wavelengths (nm) of rays."""
            found = []
            for nm in wavelengths:
                place = dr.clip((nm - REFLECTANCE_NM[0]) / (REFLECTANCE_NM[-1] - REFLECTANCE_NM[0]), 0.0, 1.0)
                place = (place * (len(REFLECTANCE_NM) - 1) + 0.5) / len(REFLECTANCE_NM)
                shares = self.spectra.eval(mi.Point1f(place))
                found.append(sum(x * share for x, share in zip(colour, shares, strict=True)))
            return mi.UnpolarizedSpectrum(found)

        def _look(self, table: Any, row: Any, cell: Any) -> Any:  # noqa: ANN401
            return table.eval(mi.Point2f((cell + 0.5) / CELLS, (row + 0.5) / INCIDENCES))[0]

        def _density(self, wi: Any, wo: Any) -> Any:  # noqa: ANN401
            half = wi + wo
            tangent = dr.maximum(dr.sqrt(half.x * half.x + half.y * half.y) / dr.maximum(half.z, 1e-8), SMALLEST)
            place = dr.asinh(tangent / LINEAR) * (CELLS / LONGEST)
            cell = dr.minimum(dr.floor(place), CELLS - 1)
            row, t = _row(wi.z)
            found = self._look(self.share, row, cell) * (1 - t) + self._look(self.share, row + 1, cell) * t
            along, end = _ring(wi.z, tangent)
            grown = dr.sqrt(1 + tangent * tangent)
            by_tangent = found * (CELLS / LONGEST) / dr.sqrt(tangent * tangent + LINEAR * LINEAR)
            by_azimuth = grown / dr.maximum(
                2 * (wi.z * end + along * dr.sin(end)), 1e-20
            )  # over cos_d, which the Jacobian has again
            found = by_tangent * by_azimuth * grown * grown * grown / (4 * tangent)
            return dr.select((wi.z > 0) & (wo.z > 0) & (end > 0) & (place < CELLS), found, 0.0)

        def _draw(self, wi: Any, u: Any) -> Any:  # noqa: ANN401
            row, t = _row(wi.z)
            first = u.x >= t
            row = dr.select(first, row, row + 1)
            v = dr.select(first, (u.x - t) / dr.maximum(1 - t, 1e-8), u.x / dr.maximum(t, 1e-8))
            cell, step = row * 0.0, CELLS // 2
            while step:
                cell = dr.select(self._look(self.below, row, cell + step) <= v, cell + step, cell)
                step //= 2
            inside = (v - self._look(self.below, row, cell)) / dr.maximum(self._look(self.share, row, cell), 1e-12)
            tangent = LINEAR * dr.sinh((cell + dr.clip(inside, 0.0, 1.0)) * (LONGEST / CELLS))
            along, end = _ring(wi.z, tangent)
            turn = _azimuth(wi.z, along, end, 2 * u.y - 1)
            horizontal = dr.sqrt(wi.x * wi.x + wi.y * wi.y)
            there = horizontal > 1e-12
            x = dr.select(there, wi.x / dr.maximum(horizontal, 1e-12), 1.0)
            y = dr.select(there, wi.y / dr.maximum(horizontal, 1e-12), 0.0)
            c, s, up = dr.cos(turn), dr.sin(turn), 1 / dr.sqrt(1 + tangent * tangent)
            facet = mi.Vector3f(tangent * up * (x * c - y * s), tangent * up * (y * c + x * s), up)
            return 2 * dr.dot(wi, facet) * facet - wi

        def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any = True) -> Any:  # noqa: ANN401
            wo = self._draw(si.wi, sample2)
            density = self._density(si.wi, wo)
            bs = mi.BSDFSample3f()
            bs.wo, bs.pdf, bs.eta = wo, density, 1.0
            bs.sampled_component = mi.UInt32(0)
            bs.sampled_type = mi.UInt32(+mi.BSDFFlags.GlossyReflection)
            there = active & (density > 0) & (si.wi.z > 0) & (wo.z > 0)
            value = self._value(si.wi, wo, si.wavelengths) * (wo.z / dr.maximum(density, 1e-20))
            return bs, dr.select(there, value, 0.0)

        def eval(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:  # noqa: ANN401
            return dr.select(active, self._value(si.wi, wo, si.wavelengths) * dr.maximum(wo.z, 0.0), 0.0)

        def pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:  # noqa: ANN401
            return dr.select(active, self._density(si.wi, wo), 0.0)

        def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:  # noqa: ANN401
            return self.eval(ctx, si, wo, active), self.pdf(ctx, si, wo, active)

        def traverse(self, cb: Any) -> None:  # noqa: ANN401 - nothing to edit
            pass

        def to_string(self) -> str:
            return f"Merlfit[filename={self.path}]"

    return Merlfit


def _row(cos: Any) -> tuple[Any, Any]:  # noqa: ANN401
    position = dr.clip(dr.acos(dr.clip(cos, -1.0, 1.0)) * ((INCIDENCES - 1) / GRAZING), 0.0, INCIDENCES - 1.0)
    row = dr.minimum(dr.floor(position), INCIDENCES - 2.0)
    return row, position - row


def _ring(cos: Any, tangent: Any) -> tuple[Any, Any]:  # noqa: ANN401
    along = tangent * dr.sqrt(dr.maximum(1 - cos * cos, 0.0))
    level = cos * (tangent * tangent - 1) / 2 / dr.maximum(along, 1e-12)
    return along, dr.acos(dr.clip(level, -1.0, 1.0))


def _azimuth(cos: Any, along: Any, end: Any, v: Any) -> Any:  # noqa: ANN401
    aim = dr.abs(v) * (cos * end + along * dr.sin(end))
    phi = dr.abs(v) * end
    for _ in range(NEWTON):
        slope = dr.maximum(cos + along * dr.cos(phi), 1e-7)
        phi = dr.clip(phi - (cos * phi + along * dr.sin(phi) - aim) / slope, 0.0, end)
    return dr.select(v < 0, -phi, phi)


def register() -> None:
    """Make ``<bsdf type="merlfit">`` known to the variant that is set."""
    kind = make()
    mi.register_bsdf("merlfit", lambda props: kind(props))


def rendered(scene: Any, samples: int) -> Any:  # noqa: ANN401 - of Mitsuba
    """A picture, the scalar variants' in passes, after each of which what is done is said: they take minutes."""
    step = min(PASS, samples) if mi.variant().startswith("scalar") else samples
    total, start = 0.0, time.perf_counter()
    for done in range(0, samples, step):
        count = min(step, samples - done)
        total = total + count * np.array(mi.render(scene, spp=count, seed=done))
        if step < samples:
            seconds = time.perf_counter() - start
            print(f"{done + count} of {samples} samples, {seconds:.0f} s", file=sys.stderr, flush=True)
    return mi.TensorXf(total / samples)


def _unusable(variant: str) -> str | None:
    """Why nothing can be rendered by a variant, and what can; None if it can."""
    known = [name for name in mi.variants() if name.endswith(("_rgb", "_spectral"))]
    if variant not in known:
        what = "has one channel, or polarised light" if variant in mi.variants() else "is none of Mitsuba's"
        return f"variant {variant!r} {what}; scenes are rendered by {', '.join(known)}"
    if variant.startswith("llvm") and "DRJIT_LIBLLVM_PATH" not in os.environ:
        return (
            f"variant {variant!r} needs LLVM's library, and Debian's libllvm19 is not here: install it, name another "
            "in DRJIT_LIBLLVM_PATH, or take --variant scalar_rgb, which needs none"
        )
    return None


class _Parser(argparse.ArgumentParser):
    """Says what is wrong in one line, in which no name steers a terminal."""

    def error(self, message: str) -> NoReturn:
        super().error(_one_line(message))


def _one_line(text: str) -> str:
    return shortened(" ".join(text.split()).translate(PLAIN))


def main() -> None:
    """Render a scene file."""
    parser = _Parser(prog="python -m merlfit.scene.mitsuba", description="Render a scene by Mitsuba 3.")
    parser.add_argument("scene", help="SCENE.xml, as `merlfit export --to mitsuba` writes it")
    parser.add_argument("-o", "--out", default="picture.exr", help="picture to write (.exr or .png)")
    parser.add_argument("--variant", default="llvm_ad_rgb", help="of Mitsuba; scalar_rgb needs no LLVM")
    parser.add_argument("--samples", type=int, default=0, help="of each pixel, if not as the scene says")
    asked = parser.parse_args()
    if why := _unusable(asked.variant):
        parser.error(why)
    if not (out := Path(asked.out)).parent.is_dir() or out.suffix not in PICTURES:
        parser.error(f"{out}: should be {' or '.join(PICTURES)}, in a folder that is there")
    mi.set_variant(asked.variant)
    register()
    try:
        scene = mi.load_file(asked.scene)
    except (RuntimeError, ValueError, OSError) as error:  # of a file that is missing, no scene, or of what it names
        parser.error(f"{asked.scene}: cannot be read as a scene ({error})")
    picture = rendered(scene, asked.samples or scene.sensors()[0].sampler().sample_count())
    try:
        mi.util.write_bitmap(asked.out, picture, write_async=False)
    except (RuntimeError, ValueError, OSError) as error:  # of a folder that is not there, or an ending of no picture
        parser.error(f"{asked.out}: cannot be written ({error})")
    print(_one_line(f"wrote {asked.out}"))


if __name__ == "__main__":
    main()
