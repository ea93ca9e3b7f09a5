"""Saved fits: loading gives what was saved, and damaged files give an error in one line."""

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

from ..cases.saved_fits import KINDS, TARGET, bomb, packed, saved, target_of


def error_of(path: Path) -> str:
    """The message of the error on loading a file: one line, without the file name in front."""
    with pytest.raises(ValueError) as caught:
        sr.FitResult.load(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: ") and len(message.splitlines()) == 1
    assert message.isprintable()
    return message.removeprefix(f"{path}: ")


def write_fit(folder: Path, arrays: dict[str, np.ndarray]) -> Path:
    path = folder / "fit.npz"
    path.write_bytes(packed(arrays))
    return path


def with_changed_facts(**change) -> dict[str, np.ndarray]:
    arrays = dict(saved("layers"))
    facts = json.loads(arrays["facts"].tobytes())
    for name, value in change.items():
        section = facts if name in facts else facts["settings"]
        if value is None:
            del section[name]
        else:
            section[name] = value
    arrays["facts"] = np.frombuffer(json.dumps(facts).encode(), np.uint8)
    return arrays


OTHER_KINDS = [pytest.param(kind, marks=pytest.mark.slow) for kind in KINDS if kind != "layers"]
"""These kinds are left to the slow run, since making a fit of each takes seconds."""


@pytest.mark.parametrize("kind", ["layers", *OTHER_KINDS])
class TestEveryKind:
    @pytest.mark.slow
    def test_a_loaded_fit_can_be_resumed(self, kind, tmp_path):
        loaded_fit = sr.FitResult.load(write_fit(tmp_path, saved(kind)))
        steps = loaded_fit.history[-1].steps
        longer = sr.fit(target_of(kind), resume=loaded_fit, steps=steps + 1)
        assert longer.history[-1].steps == steps + 1

    def test_saving_a_loaded_fit_gives_the_same_entries(self, kind, tmp_path):
        path = write_fit(tmp_path, saved(kind))
        loaded_fit = sr.FitResult.load(path)
        loaded_fit.save(tmp_path / "again.npz")
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
            assert f"`{name}` must be " in error_of(write_fit(tmp_path, rest))

    def test_an_entry_of_another_type_is_named(self, kind, tmp_path):
        for name, value in saved(kind).items():
            for dtype in (np.float16, np.int8, np.complex64, "U1", value.dtype.newbyteorder()):
                other = value.astype(dtype)
                if other.dtype != value.dtype:
                    message = error_of(write_fit(tmp_path, saved(kind) | {name: other}))
                    assert f"`{name}` must be " in message

    def test_an_entry_of_another_shape_is_named(self, kind, tmp_path):
        for name, value in saved(kind).items():
            others = [value[None]]
            # The number of vertices and of records is arbitrary.
            if value.ndim and name not in ("scene.positions", "history"):
                others += [value[:0], value[:-1], np.concatenate([value, value[:1]])]
            for other in others:
                message = error_of(write_fit(tmp_path, saved(kind) | {name: other}))
                # Sizes are compared with each other, so the error may name another array.
                assert "` must " in message or "`settings` say" in message, message

    def test_numbers_that_are_not_finite_are_named(self, kind, tmp_path):
        """Only the state of the solver and the scores may contain infinity or NaN.

        For example, an exact image has infinite PSNR.
        """
        for name, value in saved(kind).items():
            if value.dtype.kind != "f" or name.startswith("state.solve.") or name == "scores":
                continue
            for bad in (np.nan, np.inf):
                other = value.copy()
                other.reshape(-1)[0] = bad
                # In the history, the first number is a count of steps.
                message = error_of(write_fit(tmp_path, saved(kind) | {name: other}))
                assert f"`{name.removeprefix('scene.')}` must " in message

    def test_unknown_entries_are_named(self, kind, tmp_path):
        for name in ("more", "scene.depth", "state.solve.99", "state.kept.9", "state."):
            arrays = saved(kind) | {name: np.zeros(3)}
            assert f"`{name}` is not an array of a saved fit" in error_of(
                write_fit(tmp_path, arrays)
            )


SETTINGS = {
    "settings": None, "interrupted": None, "format": 2, "triangles": None, "family": "quads",
    "solver": 3, "seed": -1, "size": "big", "shading": "phong", "translucent": 1,
    "softness": [1, 2, 3], "colors": [], "loss": {}, "light": None, "start": "here", "more": 1,
    "freeze": [[1]],
}  # fmt: skip


@pytest.mark.parametrize("name", SETTINGS)
def test_invalid_settings_are_named(name, tmp_path):
    message = error_of(write_fit(tmp_path, with_changed_facts(**{name: SETTINGS[name]})))
    assert name in message and ("`facts`" in message or "`settings`" in message)


@pytest.mark.parametrize("softness", [10**30, 10**400, [1, 10**30], -1, 65])
def test_numbers_too_large_for_any_type_are_refused(softness, tmp_path):
    """NumPy has no integer type for such numbers, and `isfinite` fails for them."""
    message = error_of(write_fit(tmp_path, with_changed_facts(softness=softness)))
    assert "`settings`: `softness` must be" in message


@pytest.mark.parametrize("text", [b"", b"[]", b"{", b"\xff", b"[" * 100_000, b"3"])
def test_facts_that_are_no_json_object_are_refused(text, tmp_path):
    arrays = saved("layers") | {"facts": np.frombuffer(text, np.uint8)}
    assert "`facts` must be " in error_of(write_fit(tmp_path, arrays))


@pytest.mark.parametrize("text", [b"{}", b'{"bit_generator": "PCG64", "state": 1}', b"null"])
def test_invalid_random_states_are_refused(text, tmp_path):
    arrays = saved("layers") | {"state.random": np.frombuffer(text, np.uint8)}
    assert "`state.random` must be " in error_of(write_fit(tmp_path, arrays))


@pytest.mark.slow
@pytest.mark.parametrize("alpha", [-1.6e19, -1e-6, -1e-35, 1.1])
def test_a_background_whose_alpha_is_out_of_range_is_refused(alpha, tmp_path):
    arrays = saved("glass")
    background = np.array([0.5, 0.5, 0.5, alpha], np.float32)
    path = write_fit(tmp_path, arrays | {"state.background": background})
    assert error_of(path).startswith("the alpha of `state.background` must be in 0..1; got ")


@pytest.mark.slow
def test_indices_and_meshes_are_checked(tmp_path):
    mesh = saved("mesh")
    for name in ("state.mesh.triangles", "scene.triangles"):
        for value in (-1, 2**31 - 1):
            other = mesh[name].copy()
            other[0, 0] = value
            assert "triangles` must be " in error_of(write_fit(tmp_path, mesh | {name: other}))
    reversed_triangles = mesh["state.mesh.triangles"][:, ::-1]
    arrays = mesh | {"state.mesh.triangles": reversed_triangles}
    assert "`state.mesh` must tile the canvas" in error_of(write_fit(tmp_path, arrays))
    arrays = mesh | {"state.mesh.positions": 2 * mesh["state.mesh.positions"]}
    assert "`state.mesh` must cover the fit, 20 x 16" in error_of(write_fit(tmp_path, arrays))


def test_counts_that_disagree_are_refused(tmp_path):
    arrays = saved("layers")
    assert "`state.steps` must be 40" in error_of(
        write_fit(tmp_path, arrays | {"state.steps": np.array(41)})
    )
    backwards = arrays["history"][::-1]
    assert "`history` must" in error_of(write_fit(tmp_path, arrays | {"history": backwards}))


class TestSize:
    """Limits on what a file unpacks to: 3 MB may unpack to 3 GB."""

    HEADER = "{'descr': '<f4', 'fortran_order': False, 'shape': (%d,), }"

    def test_a_directory_that_claims_too_much_is_refused_unread(self, tmp_path, monkeypatch):
        monkeypatch.setattr(archive, "MAX_BYTES", 2**22)
        path = tmp_path / "bomb.npz"
        path.write_bytes(bomb(self.HEADER % 2**20, 2**22))
        assert "unpacks to" in error_of(path) and path.stat().st_size < 2**14

    def test_a_header_that_claims_more_than_the_data_is_refused(self, tmp_path):
        path = tmp_path / "claim.npz"
        path.write_bytes(bomb(self.HEADER % 10**9, 64))
        assert "`image` must have 4000000000 bytes" in error_of(path)

    @pytest.mark.parametrize("type_name", [",f4", "08f4", "(,)f4"])
    def test_a_type_that_numpy_cannot_parse_is_refused(self, type_name, tmp_path):
        path = tmp_path / "type.npz"
        path.write_bytes(bomb((self.HEADER % 16).replace("<f4", type_name), 64))
        assert "`image` must be an array of numbers" in error_of(path)

    def test_a_fit_that_could_not_be_read_is_not_written(self, tmp_path, monkeypatch):
        loaded_fit = sr.FitResult.load(write_fit(tmp_path, saved("layers")))
        monkeypatch.setattr(result, "MAX_BYTES", 1000)
        with pytest.raises(ValueError, match=r"new\.npz: a fit of .* bytes is too large"):
            loaded_fit.save(tmp_path / "new.npz")
        assert not (tmp_path / "new.npz").exists()

    @pytest.mark.slow
    @pytest.mark.skipif(
        not Path("/proc/self/status").exists(), reason="needs the peak of memory from Linux"
    )
    def test_refusing_a_bomb_takes_little_memory(self, tmp_path):
        path = tmp_path / "bomb.npz"
        path.write_bytes(bomb(self.HEADER % (3 * 2**28), 3 * 2**30))
        script = (
            "import sys\nimport softras2d as sr\n"
            "try:\n    sr.FitResult.load(sys.argv[1])\n"
            "except ValueError as error:\n    print(error)\n"
            "print(open('/proc/self/status').read().split('VmHWM:')[1].split()[0])"
        )
        run = [sys.executable, "-c", script, str(path)]
        error, kibibytes = subprocess.run(run, capture_output=True, text=True).stdout.splitlines()
        assert "unpacks to" in error and int(kibibytes) < 2**20


@pytest.mark.parametrize("cut", [0, 1, 10, 0.3, 0.9, -1])
def test_files_cut_short_are_refused(cut, tmp_path):
    data = packed(saved("layers"))
    path = tmp_path / "fit.npz"
    path.write_bytes(data[: int(cut * len(data)) if isinstance(cut, float) else cut])
    message = error_of(path)
    assert "not a complete .npz file" in message
    # The first four bytes tell an .npz from other files.
    if path.stat().st_size >= 4:
        assert f"cut short after {path.stat().st_size} bytes" in message


def test_missing_files_folders_and_text_are_refused(tmp_path):
    assert error_of(tmp_path / "none.npz") == "no such file."
    assert error_of(tmp_path) == "no such file."
    (tmp_path / "text.npz").write_text("words")
    assert "not a complete .npz file" in error_of(tmp_path / "text.npz")


class TestResume:
    """A result in memory is checked like a file before it is resumed."""

    def resume(self, kind: str, **state) -> str:
        fit = loaded(kind)
        for name, value in state.items():
            fit.state[name] = value
        with pytest.raises(ValueError) as caught:
            sr.fit(target_of(kind), resume=fit, steps=41)
        assert len(str(caught.value).splitlines()) == 1
        return str(caught.value)

    def test_entries_are_named(self):
        message = self.resume("layers", **{"solve.0": np.zeros((8, 3, 2), "U1")})
        assert message.startswith("`resume`: `state.solve.0` must be float32 [8, 3, 2]; got <U1")
        message = self.resume("layers", **{"solve.2": np.zeros((8, 3, 2), np.int64)})
        assert "`state.solve.2` must be float32" in message
        message = self.resume("layers", **{"solve.0": np.full((8, 3, 2), np.nan, np.float32)})
        assert "`state.solve`" in message and "finite" in message

    def test_a_result_without_state_is_refused(self):
        fit = loaded("layers")
        fit.state.clear()
        with pytest.raises(ValueError, match="`resume` has no state"):
            sr.fit(TARGET, resume=fit, steps=41)

    def test_a_result_without_settings_is_refused(self):
        fit = loaded("layers")
        fit.settings.clear()
        with pytest.raises(ValueError, match="`resume`: `settings` must have 'triangles'"):
            sr.fit(TARGET, resume=fit, steps=41)


def loaded(kind: str) -> sr.FitResult:
    """A fit of a kind, loaded from a new file."""
    with tempfile.TemporaryDirectory() as folder:
        return sr.FitResult.load(write_fit(Path(folder), saved(kind)))


HOSTILE = os.environ.get("SOFTRAS2D_DATA")


@pytest.mark.skipif(HOSTILE is None, reason="SOFTRAS2D_DATA is not set")
def test_hostile_files_are_refused():
    paths = sorted(Path(HOSTILE or "", "hostile").glob("*.npz"))
    assert paths
    for path in paths:
        error_of(path)


def test_reading_compiles_nothing(count_compilations, tmp_path):
    path = write_fit(tmp_path, saved("layers"))
    with count_compilations() as compiled:
        sr.FitResult.load(path)
    assert compiled.names == []
