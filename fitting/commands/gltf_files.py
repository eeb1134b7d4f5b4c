"""glTF assets."""

import json
from pathlib import Path
from typing import Any

from ...merl_io.atomic import write_text


def to_gltf(name: str, found: dict[str, Any], said: str, what: str, out: Path) -> Path:
    """A glTF 2.0 asset of one material; ``what`` the values are, in words."""
    more = {key: found[key] for key in ("intervals", "left_out") if key in found}
    material = {
        "name": name,
        "pbrMetallicRoughness": {
            "baseColorFactor": [*found["base_color"], 1.0], "metallicFactor": found["metallic"],
            "roughnessFactor": found["roughness"],
        },
        "extensions": {"KHR_materials_ior": {"ior": found["ior"]}},
        "extras": {"merlfit": {"source": said, "what": what, "error": found["error"], **more}},
    }  # fmt: skip
    asset = {
        "asset": {"version": "2.0", "generator": "merlfit"}, "extensionsUsed": ["KHR_materials_ior"],
        "materials": [material],
    }  # fmt: skip
    return write_text(out / f"{name}.gltf", json.dumps(asset, indent=2, allow_nan=False) + "\n")
