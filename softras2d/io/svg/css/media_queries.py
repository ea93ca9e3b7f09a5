"""Decides whether media queries of style sheets match the canvas.

The canvas counts as the viewport of a screen on which a browser shows an image: with the light
colour scheme, and without a pointer. The value of a query is True, False, or None, which means
"unknown", for features and values that this module does not know.

**Source:** *Media Queries 4*, section 3; unknown values by its section 3.2.
"""

import operator
import re
from collections.abc import Callable
from typing import Any

import tinycss2

from ..values.css_color import nesting
from ..values.numbers import finite, length

_MAX_NESTING = 8
"""Maximum depth of nested brackets in a list of queries, since tinycss2 recurses for each."""

_RANGE = re.compile(r"([a-z-]++)\s*+(<=|>=|<|>|=|:)\s*+([^<>=:]++)\Z")
_REVERSED_RANGE = re.compile(r"([^<>=:]++)(<=|>=|<|>)\s*+([a-z-]++)\s*+\Z")
_DOUBLE_RANGE = re.compile(r"([^<>=:]++)(<=?+|>=?+)\s*+([a-z-]++)\s*+(<=?+|>=?+)([^<>=:]++)\Z")

_COMPARISONS: dict[str, Callable[[float, float], bool]] = {
    "<": operator.lt, "<=": operator.le, ">": operator.gt, ">=": operator.ge,
    "=": operator.eq, ":": operator.eq,
}  # fmt: skip
_REVERSED = {"<": ">", "<=": ">=", ">": "<", ">=": "<="}

_KEYWORDS = {
    # The values of each feature that is compared with a keyword; the first is that of the canvas.
    "hover": ("none", "hover"),
    "any-hover": ("none", "hover"),
    "pointer": ("none", "coarse", "fine"),
    "any-pointer": ("none", "coarse", "fine"),
    "prefers-color-scheme": ("light", "dark"),
    "prefers-contrast": ("no-preference", "more", "less", "custom"),
    "prefers-reduced-motion": ("no-preference", "reduce"),
    "scripting": ("none", "initial-only", "enabled"),
    "update": ("none", "slow", "fast"),
}


def matches(text: str, height: int, width: int) -> bool | None:
    """Whether at least one query of a list matches a canvas.

    - `text`: list of media queries, separated by commas; an empty list matches.
    - `height`, `width`: size of the canvas in pixels, which count as CSS px.

    A query with an error does not match. Returns None if no query is known to match, and the value
    of one is unknown. Returns None too if brackets are nested too deeply, and for an integer of
    more digits than Python converts.
    """
    if nesting(text) > _MAX_NESTING:
        return None
    try:
        parsed = tinycss2.parse_component_value_list(text.lower(), skip_comments=True)
    except ValueError:
        # Raised for integers of thousands of digits.
        return None
    tokens: list[Any] = [token for token in parsed if token.type != "whitespace"]
    if not tokens:
        return True
    queries: list[list[Any]] = [[]]
    for token in tokens:
        if token.type == "literal" and token.value == ",":
            queries.append([])
        else:
            queries[-1].append(token)
    return _any([_query(query, height, width) for query in queries])


def _query(tokens: list[Any], height: int, width: int) -> bool | None:
    """The value of one media query, given its tokens: True, False, or None for unknown.

    A query is a medium, a medium with conditions joined by `and`, or conditions alone. A query of
    any other form, or with malformed conditions, is False. `height` and `width` are the size of the
    canvas in pixels.
    """
    try:
        return _well_formed_query(tokens, height, width)
    except ValueError:
        return False


def _well_formed_query(tokens: list[Any], height: int, width: int) -> bool | None:
    """The value of one media query, like `_query`, but raises `ValueError` for a malformed one."""
    words = [token.value if token.type == "ident" else "" for token in tokens]
    is_negated = words[:1] == ["not"] and len(words) > 1 and words[1] != ""
    start = 1 if is_negated or words[:1] == ["only"] else 0
    if not words[start : start + 1] or words[start] == "":
        return _condition(tokens, height, width)
    if words[start] == "not":
        return _condition(tokens, height, width)
    if words[start] in ("and", "or", "only"):
        raise ValueError("is no medium")
    value: bool | None = words[start] in ("all", "screen")
    if len(tokens) > start + 1:
        if words[start + 1] != "and" or "or" in words:
            raise ValueError("has a medium that is not followed by conditions joined by `and`")
        value = _all([value, _condition(tokens[start + 2 :], height, width)])
    return _not(value) if is_negated else value


def _condition(tokens: list[Any], height: int, width: int) -> bool | None:
    """The value of the conditions of a media query, given their tokens.

    Conditions are features joined by `and` or by `or`, or a feature negated by `not`. The value is
    True, False, or None for unknown. `height` and `width` are the size of the canvas in pixels.
    Raises `ValueError` for tokens that have no such form.
    """
    if len(tokens) == 2 and tokens[0].type == "ident" and tokens[0].value == "not":
        return _not(_feature(tokens[1], height, width))
    values = [_feature(token, height, width) for token in tokens[0::2]]
    joints = {token.value if token.type == "ident" else "" for token in tokens[1::2]}
    if len(tokens) % 2 == 0 or len(joints) > 1 or not joints <= {"and", "or"}:
        raise ValueError("is malformed")
    return _any(values) if joints == {"or"} else _all(values)


def _feature(token: Any, height: int, width: int) -> bool | None:
    """The value of one media feature, such as `(width > 300px)`, or of conditions in parentheses.

    Returns None for a feature that is not known, for a keyword that is not known, as in `(hover:
    x)`, for a keyword in a range, for a size that cannot be parsed, for malformed conditions in
    parentheses, and for a function. `height` and `width` are the size of the canvas in pixels.
    Raises `ValueError` for any other token.
    """
    if token.type == "function":
        return None
    if token.type != "() block":
        raise ValueError("is no feature in parentheses")
    content = [t for t in token.content if t.type not in ("whitespace", "comment")]
    if any(t.type == "() block" for t in content):
        try:
            return _condition(content, height, width)
        except ValueError:
            # Parentheses around anything are valid: later versions of CSS may give it a meaning.
            return None
    text = tinycss2.serialize(token.content).strip()
    sizes = {"height": float(height), "width": float(width), "aspect-ratio": width / height}
    orientations = ("portrait", "landscape") if height >= width else ("landscape", "portrait")
    keywords = {"orientation": orientations, **_KEYWORDS}
    if text in (*sizes, "color"):
        return True
    if match := _DOUBLE_RANGE.match(text):
        low, first, name, second, high = match.groups()
        return _all([
            _compared(sizes, name, _REVERSED[first], low), _compared(sizes, name, second, high),
        ])  # fmt: skip
    if match := _REVERSED_RANGE.match(text):
        return _compared(sizes, match[3], _REVERSED[match[2]], match[1])
    match = _RANGE.match(text)
    if match is None:
        return keywords[text][0] not in ("none", "no-preference") if text in keywords else None
    name, comparison, value = match[1], match[2], match[3].strip()
    if name in keywords:
        is_known = comparison == ":" and value in keywords[name]
        return value == keywords[name][0] if is_known else None
    if name.startswith(("min-", "max-")):
        comparison = ">=" if name.startswith("min-") else "<="
        name = name[4:]
    return _compared(sizes, name, comparison, value)


def _compared(sizes: dict[str, float], name: str, comparison: str, text: str) -> bool | None:
    """Compare a size of the canvas with the length or ratio in `text`; 1 `em` or `rem` is 16 px.

    - `sizes`: height and width of the canvas in pixels, and the ratio of width to height, by the
      name of the feature.
    - `name`: name of the feature, without `min-` and `max-`.
    - `comparison`: key of `_COMPARISONS`, whose left operand is the size of the canvas.

    Returns None for a feature that is not in `sizes`, and for text that cannot be parsed or divides
    by 0.
    """
    if name not in sizes:
        return None
    try:
        if name == "aspect-ratio":
            numerator, _, denominator = text.partition("/")
            value = finite(numerator.strip()) / finite(denominator.strip() or "1")
        else:
            # Relative to the initial font size, whatever the root's is.
            value = length(text, None, {"em": 16.0, "rem": 16.0})
    except (ValueError, ZeroDivisionError):
        return None
    return _COMPARISONS[comparison](sizes[name], value)


def _not(value: bool | None) -> bool | None:
    """Negation in three-valued logic, where None means unknown."""
    return None if value is None else not value


def _all(values: list[bool | None]) -> bool | None:
    """Whether all values are True, in three-valued logic; None if that is unknown."""
    return False if False in values else None if None in values else True


def _any(values: list[bool | None]) -> bool | None:
    """Whether any value is True, in three-valued logic; None if that is unknown."""
    return True if True in values else None if None in values else False
