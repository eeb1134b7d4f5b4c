"""Scenes that cannot be rendered are refused in one line that says what to mend."""

import sys

import numpy as np
import pytest
from merlfit.merl_io.atomic import WriteError
from merlfit.scene.description import SceneError, load
from merlfit.scene.images import read_map, write_exr, write_png

GOOD = """
[camera]
position = [0, 0, 6]
[[lamp]]
towards = [0, 1, 1]
[[sphere]]
material = "a"
[materials.a]
model = "ggx"
"""
CASES = {
    "no shape": (GOOD.replace("[[sphere]]\nmaterial = \"a\"\n", ""), r"no \[\[sphere\]\]"),
    "no light": (GOOD.replace("[[lamp]]\ntowards = [0, 1, 1]\n", ""), "no light"),
    "no material": (GOOD.replace('material = "a"', 'material = "b"'), r"no \[materials.b\]"),
    "unused": (GOOD + '[materials.z]\nmodel = "ggx"\n', r"\[materials.z\]"),
    "two sources": (GOOD + 'result = "x.json"\n', "result and model"),
    "misspelt": (GOOD.replace("position", "positon"), "camera"),
    "on top": (GOOD.replace("[0, 0, 6]", "[0, 0, 0]"), "look_at should differ"),
    "dark lamp": (GOOD.replace("[0, 1, 1]", "[0, 0, 0]"), "towards should not"),
    "tolerances": (GOOD + "[tolerance]\ncielab = 1\nradiance = 0.1\n", "either cielab or radiance"),
    "skewed": (
        GOOD.replace('[[sphere]]', '[[rectangle]]\ncorner=[0,0,0]\nacross=[1,0,0]\nup=[1,1,0]'), "right angles"
    ),
    "map without file": (GOOD + '[environment]\nkind = "map"\n', "file is for"),
    "not TOML": ("[camera", "is not TOML"),
    "too deep": ("x = " + "[" * 9999 + "]" * 9999, "too deeply"),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_what_is_wrong_is_named(case, tmp_path):
    text, said = CASES[case]
    path = tmp_path / "scene.toml"
    path.write_text(text)
    with pytest.raises(SceneError, match=said) as error:
        load(path)
    assert str(error.value).startswith(str(path))
    assert "\n" not in str(error.value)


def test_a_missing_file(tmp_path):
    with pytest.raises(SceneError, match="no such file"):
        load(tmp_path / "none.toml")


def test_what_is_left_out_has_its_default(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text("\ufeff" + GOOD, encoding="utf-8")  # as Windows editors write it
    found = load(path)
    assert (found.samples, found.camera.width, found.tolerance.cielab) == (64, 256, 1.0)


def test_a_full_disk_leaves_no_half_picture(tmp_path, monkeypatch):
    class Full:
        """As OpenEXR says it."""

        def __init__(self, *_):
            pass

        def __enter__(self):
            return self

        def __exit__(self, *_):
            pass

        def write(self, name):
            raise RuntimeError(f"Failed to write pixel data to image file {name}. No space left on device.")

    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("OpenEXR.File", Full)
    monkeypatch.setattr("PIL.Image.Image.save", full)
    for name, write in (("x.exr", write_exr), ("x.png", write_png)):
        with pytest.raises(WriteError, match=rf"{name}: cannot be written .*No space left"):
            write(tmp_path / name, np.zeros((2, 2, 3)))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"PK\x03\x04 and no archive", "cannot be read as a map"), (np.ones((2, 4, 3)) + 1j, "real, not complex"),
        (np.full((2, 4, 3), 1e39), r"at most 3\.4\d*e\+38, not 1e\+39"), (np.full((2, 4, 3), np.nan), "finite"),
        (np.ones((2, 4)), "has the shape"),
    ],
)  # fmt: skip
def test_a_map_that_is_none_is_named(content, said, tmp_path):
    path = tmp_path / "map.npy"
    path.write_bytes(content) if isinstance(content, bytes) else np.save(path, content)
    with pytest.raises(SceneError, match=said) as error:
        read_map(path)
    assert str(error.value).startswith(str(path))
    assert "\n" not in str(error.value)


def test_a_map_of_radiance_is_read_and_what_resizing_left_below_0_is_black(tmp_path):
    import OpenImageIO

    light = np.random.default_rng(0).random((8, 16, 3)).astype(np.float32)
    assert OpenImageIO.ImageBuf(light).write(str(tmp_path / "map.hdr"))
    np.testing.assert_allclose(read_map(tmp_path / "map.hdr"), light, atol=2**-8)
    whole = (tmp_path / "map.hdr").read_bytes()
    (tmp_path / "map.hdr").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(SceneError, match=r"map\.hdr: cannot be read as a map \(.*scanline"):
        read_map(tmp_path / "map.hdr")
    light[0, 0] = -1e-3
    write_exr(tmp_path / "map.exr", light)
    assert read_map(tmp_path / "map.exr").min() == 0


def test_a_map_of_radiance_without_its_library_says_how_to_get_it(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "OpenImageIO", None)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(SceneError, match=r"pip install 'merlfit\[hdr\]', or convert it to \.exr"):
        read_map(tmp_path / "map.hdr")


@pytest.mark.parametrize("name", ["map.NPY", "map.EXR"])
def test_capitals_in_a_maps_name_do_not_matter(name, tmp_path):
    if name.endswith("EXR"):
        write_exr(tmp_path / name, np.ones((2, 4, 3)))
    else:
        with (tmp_path / name).open("wb") as file:
            np.save(file, np.ones((2, 4, 3)))
    np.testing.assert_array_equal(read_map(tmp_path / name), 1.0)
