"""Files of fits with random changes are read as valid fits, or refused in one line."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import softras2d as sr
from softras2d.fitting.prepare import check_images, check_resume

from ..cases.fuzzing import cases, damaged
from ..cases.saved_fits import KINDS, packed, saved, target_of

pytestmark = pytest.mark.slow

_TYPES = ("float32", "float64", "float16", "int32", "int64", "uint8", "bool", ">f4", "U2", "c8")

_NUMBERS = (np.nan, np.inf, -np.inf, -1.0, 0.0, 0.5, 1.0, 2.0, 255.0, 1e9, -1e9, 3e38, 2.0**31)

_WORDS: tuple[Any, ...] = (
    None, True, -1, 0, 1, 2, 10**30, 1.5, 1e308, "", "adam", "lm", "bfgs", "mesh", "layers", "flat",
    "linear", "gouraud", "given", "uniform", [], [1.0, 2.0], [0, 1e-300], {}, "x" * 300, "a\nb",
)  # fmt: skip


def changed_array(value: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """The array with another type, another shape, or other numbers."""
    kind = rng.integers(6)
    with np.errstate(all="ignore"):
        if kind == 0:
            # An array may be changed twice, and be complex the second time.
            return np.real(value).astype(str(rng.choice(_TYPES)))
        if kind == 1:
            return (
                value[None] if rng.random() < 0.5 or not (value.ndim and value.size) else value[0]
            )
        if kind == 2 and value.ndim and value.size:
            axis = rng.integers(value.ndim)
            return np.take(value, rng.integers(0, value.shape[axis], rng.integers(0, 40)), axis)
        if kind == 3 and value.ndim > 1:
            return value.swapaxes(0, rng.integers(value.ndim))
        other = np.array(value)
        flat = other.reshape(-1)
        if kind == 4 and flat.size:
            for at in rng.integers(0, flat.size, rng.integers(1, 4)):
                flat[at] = np.array(rng.choice(_NUMBERS)).astype(other.dtype)
            return other
        return np.frombuffer(rng.bytes(other.nbytes), other.dtype).reshape(other.shape)


def changed_facts(packed_facts: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """The JSON entry `facts` of a file, with one setting changed or removed."""
    facts = json.loads(packed_facts.tobytes())
    section = facts["settings"] if rng.random() < 0.8 else facts
    name = str(rng.choice([*section, "more"]))
    if rng.random() < 0.2:
        section.pop(name, None)
    else:
        section[name] = _WORDS[rng.integers(len(_WORDS))]
    return np.frombuffer(json.dumps(facts).encode(), np.uint8)


def changed_file(arrays: dict[str, np.ndarray], rng: np.random.Generator) -> bytes:
    """The bytes of a file with up to three changed entries."""
    arrays = dict(arrays)
    for _ in range(rng.integers(1, 4)):
        name = str(rng.choice(list(arrays)))
        kind = rng.random()
        if kind < 0.15:
            del arrays[name]
        elif kind < 0.25:
            other = str(rng.choice(list(arrays)))
            arrays[other] = arrays[name]
        elif kind < 0.3:
            arrays[f"{name}{rng.integers(20)}"] = arrays[name]
        elif kind < 0.5:
            arrays["facts"] = changed_facts(saved_facts(arrays), rng)
        elif kind < 0.9:
            arrays[name] = changed_array(arrays[name], rng)
        else:
            return damaged(packed(arrays), rng)
    return packed(arrays)


def saved_facts(arrays: dict[str, np.ndarray]) -> np.ndarray:
    """The JSON entry `facts` of the arrays, or of an intact fit if it is damaged already."""
    facts = arrays.get("facts")
    valid = saved("layers")["facts"]
    try:
        assert facts is not None
        json.loads(facts.tobytes())["settings"].keys()
    except (AssertionError, ValueError, KeyError, TypeError, AttributeError):
        return valid
    return facts


def test_changed_fits_are_read_or_refused_in_one_line(tmp_path: Path):
    path = tmp_path / "fit.npz"
    # Looking up each kind makes its fit, before the time limit starts.
    kinds = [kind for kind in KINDS if saved(kind)]
    outcomes = {"read": 0, "refused": 0, "resumed": 0}
    for number, rng in cases():
        kind = kinds[number % len(kinds)]
        path.write_bytes(changed_file(saved(kind), rng))
        try:
            fit = sr.FitResult.load(path)
        except ValueError as error:
            check_message(str(error), f"{path}: ", number)
            outcomes["refused"] += 1
            continue
        except Exception as error:
            raise AssertionError(f"case {number}: {error!r}") from error
        outcomes["read"] += 1
        assert np.isfinite(fit.image).all(), f"case {number}"
        sr.check(fit.scene)
        (target,) = check_images([target_of(kind)])
        try:
            check_resume(fit, target)
            # Resuming compiles a step, so only a few of the readable fits are resumed.
            if outcomes["read"] % 50 == 1:
                steps = fit.history[-1].steps if fit.history else 0
                sr.fit(target_of(kind), resume=fit, steps=steps + 1)
                outcomes["resumed"] += 1
        except ValueError as error:
            check_message(str(error), "`resume`", number)
        except Exception as error:
            raise AssertionError(f"case {number}: {error!r}") from error
    print(outcomes)
    assert outcomes["refused"]


def check_message(message: str, start: str, number: int) -> None:
    assert message.startswith(start), f"case {number}: {message!r}"
    assert message.isprintable(), f"case {number}: {message!r}"
