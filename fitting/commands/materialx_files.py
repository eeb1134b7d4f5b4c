"""MaterialX documents."""

import re
from pathlib import Path
from typing import Any

from ...merl_io.atomic import write_text
from .xml_text import comment

MATERIALX = """<?xml version="1.0"?>
<!-- {said} -->
<materialx version="1.39" colorspace="lin_rec709">
  <open_pbr_surface name="{name}_surface" type="surfaceshader">
{inputs}
  </open_pbr_surface>
  <surfacematerial name="{name}" type="material">
    <input name="surfaceshader" type="surfaceshader" nodename="{name}_surface"/>
  </surfacematerial>
</materialx>
"""


def to_openpbr(name: str, inputs: dict[str, Any], said: str, what: str, out: Path) -> Path:
    """A MaterialX document of one OpenPBR surface; ``what`` its inputs are, in words."""
    plain = re.sub(r"[^A-Za-z0-9_]", "_", name)  # letters of other alphabets are none of MaterialX'
    lines = []
    for key, value in inputs.items():
        kind, numbers = ("color3", value) if isinstance(value, list) else ("float", [value])
        lines.append(f'    <input name="{key}" type="{kind}" value="{", ".join(f"{x:.6g}" for x in numbers)}"/>')
    text = MATERIALX.format(said=comment(f"{said}: {what}"), name=f"m_{plain}", inputs="\n".join(lines))
    return write_text(out / f"{name}.mtlx", text)
