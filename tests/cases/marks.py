"""Marks of parameters."""

from typing import Any

import pytest


def slowly(*values: Any) -> Any:
    """Mark a parameter for the slow run: each structure that is drawn takes seconds to compile."""
    return pytest.param(*values, marks=pytest.mark.slow)
