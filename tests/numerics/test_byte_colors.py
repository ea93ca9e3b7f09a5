"""The warning of colours that look like bytes names the line that gave them."""

import runpy
import warnings

import numpy as np

from softras2d.numerics import byte_colors


def test_a_script_whose_path_begins_as_the_package_is_outside_it():
    script = byte_colors.__file__.replace("/numerics/byte_colors.py", "_demo.py")
    assert script.endswith("/softras2d_demo.py")
    code = compile("\nwarn_of_bytes({'`colors`': white})\n", script, "exec")
    # A copy of the module whose calls are not type-checked, which would add lines of other files.
    warn_of_bytes = runpy.run_path(byte_colors.__file__)["warn_of_bytes"]
    white = np.full((1, 3), 255.0, np.float32)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        exec(code, {"warn_of_bytes": warn_of_bytes, "white": white})
    assert [(entry.filename, entry.lineno) for entry in caught] == [(script, 2)]
