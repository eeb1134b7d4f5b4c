"""glTF 2.0 assets: a sphere of the material, in one file."""

import base64
import json
from pathlib import Path
from typing import Any

import numpy as np

from ...merl_io.atomic import write_text

ROWS, COLUMNS = 48, 96  # of the sphere's quadrangles: its outline is off by less than a thousandth of its radius
FLOAT, UNSIGNED_SHORT, ARRAY, ELEMENTS = 5126, 5123, 34962, 34963  # of the specification, 5.1 and 5.11


def to_gltf(name: str, found: dict[str, Any], said: str, what: str, out: Path) -> Path:
    """A sphere of radius 1 of one material; ``what`` the values are, in words."""
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
    points, corners = sphere()
    first, second = points.astype("<f4").tobytes(), corners.astype("<u2").tobytes()
    data = base64.b64encode(first + second).decode()
    of_points = {"bufferView": 0, "componentType": FLOAT, "count": len(points), "type": "VEC3"}
    extent = {"min": points.min(0).tolist(), "max": points.max(0).tolist()}
    asset = {
        "asset": {"version": "2.0", "generator": "merlfit"}, "extensionsUsed": ["KHR_materials_ior"],
        "materials": [material], "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"name": name, "mesh": 0}],
        "meshes": [{
            "name": "sphere",
            "primitives": [{"attributes": {"POSITION": 0, "NORMAL": 1}, "indices": 2, "material": 0}],
        }],
        "accessors": [
            {**of_points, **extent}, of_points,
            {"bufferView": 1, "componentType": UNSIGNED_SHORT, "count": corners.size, "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": len(first), "byteStride": 12, "target": ARRAY},
            {"buffer": 0, "byteOffset": len(first), "byteLength": len(second), "target": ELEMENTS},
        ],
        "buffers": [{
            "byteLength": len(first) + len(second), "uri": f"data:application/octet-stream;base64,{data}",
        }],
    }  # fmt: skip
    return write_text(out / f"{name}.gltf", json.dumps(asset, indent=2, allow_nan=False) + "\n")


def sphere() -> tuple[np.ndarray, np.ndarray]:
    """Points of the unit sphere, which are its normals, too, (N, 3), and triangles, seen from outside, (T, 3)."""
    latitude, longitude = np.linspace(0, np.pi, ROWS + 1)[:, None], np.linspace(0, 2 * np.pi, COLUMNS + 1)
    across = np.sin(latitude)
    points = np.stack(np.broadcast_arrays(
        across * np.sin(longitude), np.cos(latitude), across * np.cos(longitude)
    ), -1).reshape(-1, 3).astype(np.float32)  # fmt: skip
    corner = np.arange(ROWS)[:, None] * (COLUMNS + 1) + np.arange(COLUMNS)
    below = corner + COLUMNS + 1
    upper = np.stack([corner[1:], below[1:] + 1, corner[1:] + 1], -1)  # none at the poles, where they have no area
    lower = np.stack([corner[:-1], below[:-1], below[:-1] + 1], -1)
    return points, np.concatenate([upper.reshape(-1, 3), lower.reshape(-1, 3)])
