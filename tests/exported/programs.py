"""Pictures of exported files by the programs that read them: radiance (SIDE, SIDE, 3), by the same light and camera."""

import base64
import os
import shutil
import subprocess
import sys
import threading
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
from merlfit.fitting.commands.gltf_files import sphere
from merlfit.fitting.commands.mitsuba_files import SCENE
from merlfit.scene import images, lights
from merlfit.scene.description import Scene

SIDE, SAMPLES, FAST = 160, 256, 64  # pixels; samples of each, and of MaterialX's environment, which a CPU draws slowly
HERE = Path(__file__).parent
LAMP = {"towards": (0.45, 0.55, 0.7), "irradiance": 2.0, "radius_deg": 0}
STUDIO = Scene.model_validate({
    "camera": {"position": (0, 0, 6), "field_of_view_deg": 20, "width": SIDE, "height": SIDE}, "samples": SAMPLES,
    "environment": {"kind": "studio", "background": True}, "lamp": [LAMP], "sphere": [{"material": "a"}],
    "materials": {"a": {"model": "ggx"}},
})  # fmt: skip
ENVMAP = '<emitter type="envmap"><string name="filename" value="{path}"/></emitter>'


def write_studio(folder):
    """The studio as maps, whose first column looks where each program has it, its irradiance over pi, and a mesh."""
    import mitsuba as mi

    mi.set_variant("scalar_rgb")
    radiance = np.asarray(lights.studio(lights.directions(512, 1024)), np.float32)[..., None] * np.ones(3, np.float32)
    columns = radiance.shape[1]
    for name, turned in (("half", columns // 2), ("quarter", -columns // 4)):
        x = np.ascontiguousarray(np.roll(radiance, turned, 1))
        images.write_exr(folder / f"{name}.exr", x)
        mi.Bitmap(x).write(str(folder / f"{name}.hdr"))
    at, normal = lights.directions(128, 256), lights.directions(32, 64).reshape(-1, 3)
    solid = np.sin((np.arange(128) + 0.5) / 128 * np.pi)[:, None] * (np.pi / 128) * (2 * np.pi / 256)
    weighted = (np.asarray(lights.studio(at)) * solid).ravel()
    facing = np.maximum(normal @ at.reshape(-1, 3).T, 0) @ weighted / np.pi
    even = np.repeat(np.roll(facing.reshape(32, 64, 1), 32, 1), 3, -1).astype(np.float32)
    mi.Bitmap(even).write(str(folder / "irradiance.hdr"))
    points, corners = sphere()
    lines = [f"v{kind} {x} {y} {z}" for kind in ("", "n") for x, y, z in points]
    lines += ["f " + " ".join(f"{k + 1}//{k + 1}" for k in row) for row in corners]
    (folder / "sphere.obj").write_text("\n".join(lines) + "\n")


def by_mitsuba(path, folder, variant="llvm_ad_rgb", **given):
    """An exported scene, its even room replaced by the studio."""
    from merlfit.scene import mitsuba as plugin

    mi = plugin.mi
    mi.set_variant(variant)
    plugin.register()
    room = next(line for line in SCENE.splitlines() if 'type="constant"' in line).strip()
    text = path.read_text().replace(room, ENVMAP.format(path=folder / "half.exr"))
    text = text.replace('value="256"/></film>', 'value="256"/><rfilter type="box"/></film>').replace("256", str(SIDE))
    other = path.with_name("studio.xml")
    other.write_text(text)
    picture = mi.render(mi.load_file(str(other), **given), spp=SAMPLES)
    return np.array(picture)[..., :3]


def by_blender(path, folder, script):
    """An exported script, or a glTF file; None where there is no Blender: BLENDER_PYTHON names a Python that has it."""
    python, out = os.environ.get("BLENDER_PYTHON"), folder / "blender.exr"
    if python is None:
        return None
    words = [python, HERE / "in_blender.py", path, folder / "quarter.exr", SIDE, SAMPLES, out, script]
    subprocess.run([str(x) for x in words], check=True, capture_output=True, timeout=300)
    return images.read_map(out)


def by_materialx(path, folder):
    """A document, by MaterialX' own renderer; None without a display to draw below."""
    if shutil.which("xvfb-run") is None:
        return None
    names, out = ("sphere.obj", "half.hdr", "irradiance.hdr"), folder / "materialx.npy"
    words = ["xvfb-run", "-a", sys.executable, HERE / "in_materialx.py", path, *(folder / n for n in names), SIDE]
    subprocess.run([str(x) for x in (*words, FAST, out)], check=True, capture_output=True, timeout=300)
    return np.load(out)[::-1]  # its first row is the lowest


VALIDATE = (
    "require('gltf-validator').validateBytes(new Uint8Array(require('fs').readFileSync(process.argv[1])))"
    ".then(x => console.log(x.issues.numErrors, x.issues.numWarnings))"
)


def validated(path):
    """Errors and warnings that Khronos' glTF-Validator finds; None where NODE_MODULES names no folder that has it."""
    modules = os.environ.get("NODE_MODULES")
    if modules is None:
        return None
    words = ["node", "-e", VALIDATE, str(path)]
    said = subprocess.run(words, check=True, capture_output=True, text=True, env={**os.environ, "NODE_PATH": modules})
    return [int(x) for x in said.stdout.split()]


def by_three(path, folder):
    """A glTF file, by three.js in Chromium; None where NODE_MODULES names no folder that has it."""
    from playwright.sync_api import sync_playwright

    from ..support import chromium

    modules, samples = os.environ.get("NODE_MODULES"), 4
    if modules is None:
        return None
    site = folder / "site"
    site.mkdir(exist_ok=True)
    parts = {
        "three": Path(modules) / "three", "index.html": HERE / "in_three.html", "exported.gltf": path,
        "studio.hdr": folder / "quarter.hdr",
    }  # fmt: skip
    for name, target in parts.items():
        (site / name).unlink(missing_ok=True)
        (site / name).symlink_to(target.resolve())
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(_Quiet, directory=str(site)))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    software = ("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox")
    try:
        with sync_playwright() as driver:
            browser = driver.chromium.launch(executable_path=chromium.found(), args=list(software))
            page = browser.new_page()
            page.goto(f"http://127.0.0.1:{server.server_port}/index.html")
            page.wait_for_function("window.ready")
            text = page.evaluate("([side, samples]) => window.draw(side, samples)", [SIDE, samples])
            browser.close()
    finally:
        server.shutdown()
    wide = np.frombuffer(base64.b64decode(text), "<f4").reshape(SIDE * samples, SIDE * samples, 4)[::-1, :, :3]
    return wide.reshape(SIDE, samples, SIDE, samples, 3).mean((1, 3))


class _Quiet(SimpleHTTPRequestHandler):
    def log_message(self, *words):
        pass
