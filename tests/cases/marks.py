"""Pytest marks for parameters of tests."""

from typing import Any

import pytest


def slowly(*values: Any) -> Any:
    """Mark a parameter for the slow run: each structure of a scene takes seconds to compile."""
    return pytest.param(*values, marks=pytest.mark.slow)
