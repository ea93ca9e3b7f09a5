"""Batches, tiles and fits on four devices give the results of one, measured in another process."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest


@pytest.mark.slow
def test_four_devices_give_the_results_of_one():
    flags = f"{os.environ.get('XLA_FLAGS', '')} --xla_force_host_platform_device_count=4"
    done = subprocess.run(
        [sys.executable, "-m", "tests.cases.four_devices"],
        env=os.environ | {"XLA_FLAGS": flags, "JAX_PLATFORMS": "cpu"},
        cwd=Path(__file__).parent.parent,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    measured = json.loads(done.stdout.splitlines()[-1])
    for batch in (measured["small"], measured["large"]):
        assert not batch["overflow"] and batch["images equal"] and batch["devices"] == 4
        assert batch["gradient error"] < 1e-5 and batch["loss error"] < 1e-5
        assert batch["image collectives"] == {}
        # The one collective sums the loss over the shards.
        assert batch["gradient collectives"] == {"all-reduce": 1}
    tiles = measured["tiles"]
    assert tiles["images equal"] and tiles["gradients equal"] and tiles["largest"] > 0
    fits = measured["fits"]
    assert len(fits["psnr"]) == 6
    assert fits["psnr of four"] == pytest.approx(fits["psnr"], abs=1e-3)
