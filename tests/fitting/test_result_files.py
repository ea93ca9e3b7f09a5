"""Files of fits: what is saved comes back, and what is broken is named in one line."""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest

import softras2d as sr
from softras2d.fitting import archive, result
from softras2d.fitting.archive import read_arrays
from tests.cases.saved_fits import KINDS, TARGET, bomb, packed, saved, target_of

"""`softras2d.fit` is the function, so that no path through it finds a module."""


def refused(path: Path) -> str:
    """What `load` says of a file: one line that begins with its name."""
    with pytest.raises(ValueError) as caught:
        sr.FitResult.load(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: ") and len(message.splitlines()) == 1
    assert message.isprintable()
    return message.removeprefix(f"{path}: ")


def written(folder: Path, arrays: dict[str, np.ndarray]) -> Path:
    path = folder / "fit.npz"
    path.write_bytes(packed(arrays))
    return path


def with_facts(**change) -> dict[str, np.ndarray]:
    arrays = dict(saved("layers"))
    facts = json.loads(arrays["facts"].tobytes())
    for name, value in change.items():
        place = facts if name in facts else facts["settings"]
        if value is None:
            del place[name]
        else:
            place[name] = value
    arrays["facts"] = np.frombuffer(json.dumps(facts).encode(), np.uint8)
    return arrays


OTHERS = [pytest.param(kind, marks=pytest.mark.slow) for kind in KINDS if kind != "layers"]
"""To make a fit of another kind takes seconds."""


@pytest.mark.parametrize("kind", ["layers", *OTHERS])
class TestEveryKind:
    @pytest.mark.slow
    def test_it_goes_on(self, kind, tmp_path):
        found = sr.FitResult.load(written(tmp_path, saved(kind)))
        steps = found.history[-1].steps
        longer = sr.fit(target_of(kind), resume=found, steps=steps + 1)
        assert longer.history[-1].steps == steps + 1

    def test_it_comes_back(self, kind, tmp_path):
        path = written(tmp_path, saved(kind))
        found = sr.FitResult.load(path)
        found.save(tmp_path / "again.npz")
        again = read_arrays(tmp_path / "again.npz")
        assert again.keys() == saved(kind).keys()
        for name, value in saved(kind).items():
            assert again[name].dtype == value.dtype
            np.testing.assert_array_equal(again[name], value)

    def test_an_entry_that_is_missing_is_named(self, kind, tmp_path):
        for name in saved(kind):
            rest = {k: v for k, v in saved(kind).items() if k != name}
            if name in ("state.kept", "state.weights", "state.weights.given"):
                continue
            assert f"`{name}` must be " in refused(written(tmp_path, rest))

    def test_an_entry_of_another_type_is_named(self, kind, tmp_path):
        for name, value in saved(kind).items():
            for dtype in (np.float16, np.int8, np.complex64, "U1", value.dtype.newbyteorder()):
                other = value.astype(dtype)
                if other.dtype != value.dtype:
                    message = refused(written(tmp_path, saved(kind) | {name: other}))
                    assert f"`{name}` must be " in message

    def test_an_entry_of_another_shape_is_named(self, kind, tmp_path):
        for name, value in saved(kind).items():
            others = [value[None]]
            # Of vertices and records there may be any number.
            if value.ndim and name not in ("scene.positions", "history"):
                others += [value[:0], value[:-1], np.concatenate([value, value[:1]])]
            for other in others:
                message = refused(written(tmp_path, saved(kind) | {name: other}))
                # Sizes are held against each other: another may be the one that does not fit.
                assert "` must " in message or "`settings` say" in message, message

    def test_numbers_that_are_not_finite_are_named(self, kind, tmp_path):
        """But in the solver's memory, and in scores, where infinity means an exact image."""
        for name, value in saved(kind).items():
            if value.dtype.kind != "f" or name.startswith("state.solve.") or name == "scores":
                continue
            for bad in (np.nan, np.inf):
                other = value.copy()
                other.reshape(-1)[0] = bad
                # Of the history, the first number is a count.
                message = refused(written(tmp_path, saved(kind) | {name: other}))
                assert f"`{name.removeprefix('scene.')}` must " in message

    def test_unknown_entries_are_named(self, kind, tmp_path):
        for name in ("more", "scene.depth", "state.solve.99", "state.kept.9", "state."):
            arrays = saved(kind) | {name: np.zeros(3)}
            assert f"`{name}` is no entry of a fit" in refused(written(tmp_path, arrays))


SETTINGS = {
    "settings": None, "interrupted": None, "format": 2, "triangles": None, "family": "quads",
    "solver": 3, "seed": -1, "size": "big", "shading": "phong", "translucent": 1,
    "softness": [1, 2, 3], "colors": [], "loss": {}, "light": None, "start": "here", "more": 1,
}  # fmt: skip


@pytest.mark.parametrize("name", SETTINGS)
def test_settings_that_no_fit_has(name, tmp_path):
    message = refused(written(tmp_path, with_facts(**{name: SETTINGS[name]})))
    assert name in message and ("`facts`" in message or "`settings`" in message)


@pytest.mark.parametrize("softness", [10**30, 10**400, [1, 10**30], -1, 65])
def test_numbers_beyond_all_types(softness, tmp_path):
    """NumPy has no integers that large, and no opinion whether they are finite."""
    message = refused(written(tmp_path, with_facts(softness=softness)))
    assert "`settings`: `softness` must be" in message


@pytest.mark.parametrize("text", [b"", b"[]", b"{", b"\xff", b"[" * 100_000, b"3"])
def test_facts_that_are_no_object(text, tmp_path):
    arrays = saved("layers") | {"facts": np.frombuffer(text, np.uint8)}
    assert "`facts` must be " in refused(written(tmp_path, arrays))


@pytest.mark.parametrize("text", [b"{}", b'{"bit_generator": "PCG64", "state": 1}', b"null"])
def test_a_random_state_that_is_none(text, tmp_path):
    arrays = saved("layers") | {"state.random": np.frombuffer(text, np.uint8)}
    assert "`state.random` must be " in refused(written(tmp_path, arrays))


@pytest.mark.slow
def test_indices_and_meshes_are_looked_at(tmp_path):
    mesh = saved("mesh")
    for name in ("state.mesh.triangles", "scene.triangles"):
        for value in (-1, 2**31 - 1):
            other = mesh[name].copy()
            other[0, 0] = value
            assert "triangles` must be " in refused(written(tmp_path, mesh | {name: other}))
    turned = mesh["state.mesh.triangles"][:, ::-1]
    arrays = mesh | {"state.mesh.triangles": turned}
    assert "`state.mesh` must tile the canvas" in refused(written(tmp_path, arrays))
    arrays = mesh | {"state.mesh.positions": 2 * mesh["state.mesh.positions"]}
    assert "`state.mesh` must cover the fit, 20 x 16" in refused(written(tmp_path, arrays))


def test_counts_agree(tmp_path):
    arrays = saved("layers")
    assert "`state.steps` must be 40" in refused(
        written(tmp_path, arrays | {"state.steps": np.array(41)})
    )
    backwards = arrays["history"][::-1]
    assert "`history` must" in refused(written(tmp_path, arrays | {"history": backwards}))


class TestSize:
    """3 MB may unpack to 3 GB."""

    HEADER = "{'descr': '<f4', 'fortran_order': False, 'shape': (%d,), }"

    def test_what_the_directory_claims_is_refused_unread(self, tmp_path, monkeypatch):
        monkeypatch.setattr(archive, "MAX_BYTES", 2**22)
        path = tmp_path / "bomb.npz"
        path.write_bytes(bomb(self.HEADER % 2**20, 2**22))
        assert "unpacks to" in refused(path) and path.stat().st_size < 2**14

    def test_what_a_header_claims_is_held_against_it(self, tmp_path):
        path = tmp_path / "claim.npz"
        path.write_bytes(bomb(self.HEADER % 10**9, 64))
        assert "`image` must have 4000000000 bytes" in refused(path)

    def test_a_fit_that_could_not_be_read_is_not_written(self, tmp_path, monkeypatch):
        found = sr.FitResult.load(written(tmp_path, saved("layers")))
        monkeypatch.setattr(result, "MAX_BYTES", 1000)
        with pytest.raises(ValueError, match=r"new\.npz: a fit of .* bytes is too large"):
            found.save(tmp_path / "new.npz")
        assert not (tmp_path / "new.npz").exists()

    @pytest.mark.slow
    @pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="Linux tells the peak")
    def test_memory_stays_small(self, tmp_path):
        path = tmp_path / "bomb.npz"
        path.write_bytes(bomb(self.HEADER % (3 * 2**28), 3 * 2**30))
        script = (
            "import sys\nimport softras2d as sr\n"
            "try:\n    sr.FitResult.load(sys.argv[1])\n"
            "except ValueError as error:\n    print(error)\n"
            "print(open('/proc/self/status').read().split('VmHWM:')[1].split()[0])"
        )
        run = [sys.executable, "-c", script, str(path)]
        told, kibibytes = subprocess.run(run, capture_output=True, text=True).stdout.splitlines()
        assert "unpacks to" in told and int(kibibytes) < 2**20


@pytest.mark.parametrize("cut", [0, 1, 10, 0.3, 0.9, -1])
def test_files_that_are_cut_short(cut, tmp_path):
    data = packed(saved("layers"))
    path = tmp_path / "fit.npz"
    path.write_bytes(data[: int(cut * len(data)) if isinstance(cut, float) else cut])
    assert "not a whole .npz file" in refused(path)


def test_files_that_are_not_there_or_something_else(tmp_path):
    assert refused(tmp_path / "none.npz") == "no such file."
    assert refused(tmp_path) == "no such file."
    (tmp_path / "text.npz").write_text("words")
    assert "not a whole .npz file" in refused(tmp_path / "text.npz")


class TestResume:
    """A result in memory is looked at like a file."""

    def resume(self, kind: str, **state) -> str:
        found = loaded(kind)
        for name, value in state.items():
            found.state[name] = value
        with pytest.raises(ValueError) as caught:
            sr.fit(target_of(kind), resume=found, steps=41)
        assert len(str(caught.value).splitlines()) == 1
        return str(caught.value)

    def test_entries_are_named(self):
        message = self.resume("layers", **{"solve.0": np.zeros((8, 3, 2), "U1")})
        assert message.startswith("`resume`: `state.solve.0` must be float32 [8, 3, 2]; got <U1")
        message = self.resume("layers", **{"solve.2": np.zeros((8, 3, 2), np.int64)})
        assert "`state.solve.2` must be float32" in message
        message = self.resume("layers", **{"solve.0": np.full((8, 3, 2), np.nan, np.float32)})
        assert "`state.solve`" in message and "finite" in message

    def test_a_result_without_state(self):
        found = loaded("layers")
        found.state.clear()
        with pytest.raises(ValueError, match="`resume` has no state"):
            sr.fit(TARGET, resume=found, steps=41)

    def test_a_result_without_settings(self):
        found = loaded("layers")
        found.settings.clear()
        with pytest.raises(ValueError, match="`resume`: `settings` must have 'triangles'"):
            sr.fit(TARGET, resume=found, steps=41)


def loaded(kind: str) -> sr.FitResult:
    """A fresh copy."""
    with tempfile.TemporaryDirectory() as folder:
        return sr.FitResult.load(written(Path(folder), saved(kind)))


HOSTILE = os.environ.get("SOFTRAS2D_DATA")


@pytest.mark.skipif(HOSTILE is None, reason="SOFTRAS2D_DATA is not set")
def test_hostile_files():
    paths = sorted(Path(HOSTILE or "", "hostile").glob("*.npz"))
    assert paths
    for path in paths:
        refused(path)


def test_reading_compiles_nothing(count_compilations, tmp_path):
    path = written(tmp_path, saved("layers"))
    with count_compilations() as compiled:
        sr.FitResult.load(path)
    assert compiled.names == []
