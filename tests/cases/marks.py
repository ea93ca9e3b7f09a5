"""Pytest marks for parameters of tests."""

from typing import Any

import pytest


def slowly(*values: Any) -> Any:
    """Mark a parameter for the slow run, since each structure of a scene compiles for seconds."""
    return pytest.param(*values, marks=pytest.mark.slow)
