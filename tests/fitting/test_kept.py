"""Programs that are kept between processes: the same values, from the same file, whatever happens to it."""

import hashlib
import json
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import Array, export
from merlfit.fitting.support import compilation, kept
from merlfit.fitting.support.kept import Kept, Unnamed, loaded_ahead
from merlfit.model.two_scale import TwoScale


class Pair(eqx.Module):
    one: Array
    other: Array
    which: str = eqx.field(static=True, default="sum")


def combined(model, values, pair):
    assert model.name == "two-scale"
    factor = 2.0 if model.body == "lambert" else 3.0
    both = pair.one + pair.other if pair.which == "sum" else pair.one * pair.other
    return {"scaled": factor * values["x"] * both, "norm": jnp.linalg.cholesky(jnp.outer(both, both) + jnp.eye(3))}


def paired(model, x):
    return Pair(x, 2 * x)


combined.__module__ = paired.__module__ = "merlfit.tests"
PAIR = Pair(np.arange(3.0), np.ones(3))


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty cache, into which everything is written, in a process that has asked for nothing."""
    monkeypatch.setenv("MERLFIT_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(kept, "LEAST", 0.0)
    monkeypatch.setattr(kept, "_ahead", kept._Ahead())
    kept._folder.cache_clear()
    yield kept._folder()
    kept._folder.cache_clear()


def never(*_):
    raise AssertionError("it is traced")


def arguments(**settings):
    return TwoScale(**settings), {"x": np.float64(2.0)}, PAIR


def test_what_is_read_is_what_was_traced(folder, monkeypatch):
    expected = combined(*arguments(body="lambert"))
    first = Kept(combined)(*arguments(body="lambert"))
    assert len(list(folder.glob("*.bin"))) == 1
    monkeypatch.setattr(export, "export", never)
    again = Kept(combined)(*arguments(body="lambert"))  # as in another process
    for found in (first, again):
        assert found.keys() == expected.keys()
        for name, x in expected.items():
            np.testing.assert_array_equal(found[name], jax.jit(lambda x: x)(x))
    moved = Kept(combined)(TwoScale("lambert"), {"x": np.float64(5.0)}, PAIR)
    np.testing.assert_allclose(moved["scaled"], 2.5 * expected["scaled"])


def test_each_static_argument_shape_and_structure_has_its_own(folder):
    function = Kept(combined)
    for given in (
        arguments(body="lambert"),
        arguments(body="none"),
        (TwoScale("lambert"), {"x": np.ones(3)}, PAIR),
        (TwoScale("lambert"), {"x": np.float64(2.0)}, Pair(PAIR.one, PAIR.other, "product")),
    ):
        found, expected = function(*given), combined(*given)
        np.testing.assert_allclose(found["scaled"], expected["scaled"])
    assert len(list(folder.glob("*.bin"))) == 4


def test_the_same_number_has_the_same_program_wherever_it_came_from(folder):
    for number in (np.float64(2.0), 2.0, jnp.float64(2.0), jnp.asarray(2.0), jnp.asarray(2)):  # JAX's: weak or not
        Kept(combined)(TwoScale("lambert"), {"x": number}, PAIR)
    assert len(list(folder.glob("*.bin"))) == 2  # float64 and int64


def test_a_damaged_file_is_made_anew(folder):
    expected = Kept(combined)(*arguments())
    (path,) = folder.glob("*.bin")
    whole = path.read_bytes()
    flipped = bytearray(whole)
    flipped[len(whole) // 2] ^= 1
    for damaged in (b"", b"nothing", whole[: len(whole) // 2], bytes(flipped)):
        path.write_bytes(damaged)
        np.testing.assert_array_equal(Kept(combined)(*arguments())["scaled"], expected["scaled"])
        assert path.read_bytes()[:40] == hashlib.sha1(path.read_bytes()[40:]).hexdigest().encode()


def test_traced_by_another_function_it_is_a_part_of_that(folder):
    function = Kept(combined)
    scaled = lambda x: function(TwoScale("lambert"), {"x": x}, PAIR)["scaled"].sum()  # noqa: E731
    assert jax.grad(scaled)(2.0) == pytest.approx(2.0 * (PAIR.one + PAIR.other).sum())
    assert not list(folder.glob("*.bin"))


def test_what_no_text_says_all_of_is_not_kept(folder):
    @dataclass(frozen=True)
    class Local:
        body: str = "lambert"
        name: str = "two-scale"

    found = Kept(combined)(Local(), {"x": np.float64(2.0)}, PAIR)
    np.testing.assert_allclose(found["scaled"], 4.0 * (PAIR.one + PAIR.other))
    assert not folder.exists()
    for unnamed in (lambda: 0, Local(), object(), np.sin):
        with pytest.raises(Unnamed):
            kept._said((1, {"a": unnamed}))


def test_programs_of_another_precision_are_others(folder):
    for precise in (True, False):
        with jax.enable_x64(precise):
            Kept(combined)(*arguments())
    assert len([*folder.glob("*.bin")]) == 2


def test_what_was_used_is_loaded_ahead_the_next_time(folder, monkeypatch):
    with loaded_ahead("fits"):
        Kept(combined)(*arguments())
        Kept(combined)(*arguments(body="lambert"))
    (listed,) = folder.glob("*.json")
    assert {path.stem for path in folder.glob("*.bin")} == set(json.loads(listed.read_text()))
    monkeypatch.setattr(kept, "_ahead", kept._Ahead())
    with loaded_ahead("fits"):
        loading = list(kept._ahead.loading.values())
        programs = [each.result() for each in loading]
        monkeypatch.setattr(kept, "_read", never)
        again = Kept(combined)
        again(*arguments())
    assert len(programs) == 2
    assert next(iter(again._programs.values())) in programs
    with loaded_ahead("fits"):  # of a process that has its programs
        assert not kept._ahead.loading


def test_a_cache_that_cannot_be_written_is_done_without(folder):
    folder.parent.parent.joinpath("programs").write_text("in the way")
    found = Kept(combined)(*arguments(body="lambert"))
    np.testing.assert_allclose(found["scaled"], 4.0 * (PAIR.one + PAIR.other))


def test_a_cache_of_somebody_else_is_done_without(folder, monkeypatch):
    def refused(*_):
        raise PermissionError("of somebody else")

    for name in ("_read", "_make_folder"):
        monkeypatch.setattr(kept, name, refused)
    found = Kept(combined)(*arguments(body="lambert"))
    np.testing.assert_allclose(found["scaled"], 4.0 * (PAIR.one + PAIR.other))


def test_no_more_than_some_versions_are_kept(folder):
    for k in range(5):
        folder.parent.joinpath(f"version{k}").mkdir(parents=True)
    Kept(combined)(*arguments())
    assert folder.is_dir()
    assert len(list(folder.parent.iterdir())) == kept.SOURCES


def test_programs_are_forgotten_with_those_of_jax(folder, monkeypatch):
    function = Kept(combined)
    function(*arguments())
    monkeypatch.setattr(compilation, "MAPPINGS", 0)
    compilation.make_room()
    assert not function._programs


def test_what_was_changed_since_it_was_imported_is_not_kept(folder, monkeypatch):
    monkeypatch.setattr(kept, "_source", lambda: "another")
    Kept(combined)(*arguments())
    assert not folder.exists()


def test_several_threads_trace_it_once(folder, monkeypatch):
    traced, real = [], export.export
    monkeypatch.setattr(export, "export", lambda function: traced.append(1) or real(function))
    function = Kept(combined)
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda _: function(*arguments())["scaled"], range(8)))
    assert len(traced) == 1
    for x in found:
        np.testing.assert_array_equal(x, found[0])


class Stop(BaseException):
    pass


def test_a_stop_ends_what_is_loaded_ahead_and_remembers_nothing(folder):
    @loaded_ahead("fits")
    def stopped():
        Kept(combined)(*arguments())
        raise Stop

    with pytest.raises(Stop):
        stopped()
    assert not list(folder.glob("*.json"))
    assert not kept._ahead.loading


@pytest.mark.parametrize("listed", ["", "3", "[3]", '["gone"]', "{}"])
def test_a_list_that_says_nothing_is_passed_over(folder, listed, monkeypatch):
    with loaded_ahead("fits"):
        Kept(combined)(*arguments())
    (path,) = folder.glob("*.json")
    whole = path.read_text()
    path.write_text(listed)
    monkeypatch.setattr(kept, "_ahead", kept._Ahead())
    with loaded_ahead("fits"):
        Kept(combined)(*arguments())
    assert path.read_text() == whole


def test_what_returns_what_cannot_be_kept_is_compiled_as_ever(folder):
    found = Kept(paired)(TwoScale(), np.arange(3.0))
    assert isinstance(found, Pair)
    assert not list(folder.glob("*.bin"))
