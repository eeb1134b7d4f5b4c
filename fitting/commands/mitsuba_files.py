"""Scenes for Mitsuba 3, a sphere under a lamp in an even room: of merlfit's own plugin, and of `principled`."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

from ...merl_io.atomic import write_text
from ...scene.surface import Material
from ...scene.tables import write_tables
from .xml_text import comment, word

SCENE = """<?xml version="1.0" encoding="utf-8"?>
<!-- {said} -->
<scene version="3.0.0">
    <integrator type="path"/>
    <sensor type="perspective">
        <float name="fov" value="20"/>
        <transform name="to_world"><lookat origin="0, 0, 6" target="0, 0, 0" up="0, 1, 0"/></transform>
        <film type="hdrfilm"><integer name="width" value="256"/><integer name="height" value="256"/></film>
        <sampler type="multijitter"><integer name="sample_count" value="32"/></sampler>
    </sensor>
    <emitter type="constant"><rgb name="radiance" value="0.3"/></emitter>
    <emitter type="directional">
        <vector name="direction" value="-0.45, -0.55, -0.7"/><rgb name="irradiance" value="2"/>
    </emitter>
    <shape type="sphere">{bsdf}</shape>
</scene>
"""


def to_mitsuba(name: str, material: Material, said: str, out: Path) -> list[Path]:
    """Tables and a scene that renders at once: a sphere under a lamp in an even room."""
    tables = out / f"{word(name)}.mitsuba.npz"
    write_tables(tables, material)
    bsdf = f'<bsdf type="merlfit"><string name="filename" value={quoteattr(tables.name)}/></bsdf>'
    render = "Render this file: python -m merlfit.scene.mitsuba THIS.xml -o PICTURE.exr"
    return [tables, write_text(out / f"{name}.xml", SCENE.format(said=comment(f"{said}. {render}"), bsdf=bsdf))]


def to_principled(name: str, inputs: Mapping[str, Any], said: str, what: str, out: Path) -> Path:
    """A scene as of `to_mitsuba`, of Mitsuba's own plugin; ``what`` its inputs are, in words."""
    lines = "".join(
        f'<rgb name="{key}" value="{", ".join(f"{x:.6g}" for x in value)}"/>' if isinstance(value, list)
        else f'<float name="{key}" value="{value:.6g}"/>'
        for key, value in inputs.items()
    )  # fmt: skip
    words = f"{said}: {what}. Render this file: mitsuba THIS.xml"
    text = SCENE.format(said=comment(words), bsdf=f'<bsdf type="principled">{lines}</bsdf>')
    return write_text(out / f"{name}.principled.xml", text)
