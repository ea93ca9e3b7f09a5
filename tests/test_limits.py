"""A large canvas takes a bounded amount of memory."""

import subprocess
import sys

import pytest

# The peak is read from `VmHWM`, because `ru_maxrss` starts at the size of the parent process.
SCRIPT = """
import re
from pathlib import Path
import numpy as np
import softras2d as sr
rng = np.random.default_rng(0)
corners = rng.uniform(0, 4096, (1000, 1, 2)) + rng.normal(size=(1000, 3, 2)) * 200
scene = sr.Scene.from_soup(corners.astype(np.float32), rng.random((1000, {shape})))
plan = sr.plan(scene, height=4096, width=4096, coverage=sr.Hard(samples=16))
image = np.asarray(sr.render(scene, plan))
assert image.shape == (4096, 4096, 3)
print(int(re.search(r"VmHWM:\\s+(\\d+)", Path("/proc/self/status").read_text())[1]) / 2**20)
"""


@pytest.mark.slow
@pytest.mark.parametrize("shape", ["3", "4", "3, 3"], ids=["flat", "translucent", "interpolated"])
def test_memory_of_a_large_canvas_is_below_4_gib(shape):
    """The process peaks below 4 GiB for 4096 x 4096 pixels at 16 samples."""
    script = SCRIPT.format(shape=shape)
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert float(done.stdout) < 4.0
