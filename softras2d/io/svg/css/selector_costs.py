"""Bounds the time that it takes to test whether a CSS selector matches an element.

cssselect2 tests a selector from right to left, and tries all ways to assign elements to the
compounds of the selector. A short selector can therefore cause any amount of work. `cascade.py`
charges the bounds that are computed here to the budget before cssselect2 tests a selector.
"""

from typing import Any, NamedTuple

_PSEUDO_CLASSES = frozenset(
    [
        "root",
        "empty",
        "first-child",
        "last-child",
        "only-child",
        "link",
        "visited",
        "hover",
        "active",
        "focus",
        "target",
        "focus-within",
        "focus-visible",
        "any-link",
        "enabled",
        "disabled",
        "checked",
    ]
)
"""Pseudo-classes that are tested in constant time."""

_COSTLY_PSEUDO_CLASSES = frozenset(["first-of-type", "last-of-type", "only-of-type"])
"""Pseudo-classes whose test examines all siblings of an element."""

_PSEUDO_ELEMENTS_AFTER_ONE_COLON = frozenset(["before", "after", "first-line", "first-letter"])
"""Pseudo-elements that may be written like pseudo-classes, as in `:before`."""

_FUNCTIONS = {
    "not": False, "is": False, "where": False, "matches": False, "nth-child": False,
    "nth-last-child": False, "nth-of-type": True, "nth-last-of-type": True,
}  # fmt: skip
"""Functional pseudo-classes, such as `:not(...)`, and whether they examine all siblings.

`:has(...)` is not supported, as it examines all descendants.
"""


class Cost(NamedTuple):
    """Properties of a CSS selector that determine how long it takes to test it on an element.

    A selector consists of compounds, such as `rect.a`, with combinators between them. The last
    compound is tested on the element itself, and the others on its ancestors and siblings.

    - `descendants`: number of descendant combinators (blanks). Each may match at any ancestor.
    - `later_sibling_combinators`: number of combinators `~`. Each may match at any earlier sibling.
    - `last_looks_at_siblings`: whether the last compound has a pseudo-class that examines all
      siblings, such as `:first-of-type`.
    - `others_look_at_siblings`: whether any other compound has such a pseudo-class, or siblings are
      tested by another selector, as for `:nth-child(2 of .a)`.
    """

    descendants: int
    later_sibling_combinators: int
    last_looks_at_siblings: bool
    others_look_at_siblings: bool


def max_tests(cost: Cost, depth: int, siblings: int) -> int:
    """Upper bound on the number of tests that one selector needs on one element.

    A test is one choice of ancestors and siblings for the combinators, or one sibling that a
    pseudo-class examines. The combinators `>` and `+` leave no choice and do not count.

    - `cost`: properties of the selector.
    - `depth`: number of ancestors of the element.
    - `siblings`: number of siblings of the element and of each ancestor, added up. An element
      counts as a sibling of itself.
    """
    tests = _choices(depth, cost.descendants) * _choices(siblings, cost.later_sibling_combinators)
    if cost.others_look_at_siblings:
        tests *= siblings
    return tests + siblings * cost.last_looks_at_siblings


def _choices(among: int, count: int) -> int:
    """Number of ways to choose at most `count` of `among` elements, without regard to order.

    It bounds the tests that a chain of `count` combinators causes: each combinator chooses one
    element, and a chain is also tested before all of its elements are chosen. The sum stops above
    2^40, which exceeds every limit of the budget.
    """
    choices = total = 1
    for k in range(min(count, among)):
        choices = choices * (among - k) // (k + 1)
        total += choices
        if total > 2**40:
            break
    return total


def split_selectors(prelude: list[Any]) -> list[list[Any]]:
    """Split a list of selectors at its commas; returns the tokens of each selector.

    `prelude` has the tokens of the list, as tinycss2 makes them.
    """
    selectors: list[list[Any]] = [[]]
    for token in prelude:
        if token.type == "literal" and token.value == ",":
            selectors.append([])
        else:
            selectors[-1].append(token)
    return selectors


def selector_cost(tokens: list[Any]) -> Cost | None:
    """The cost of one selector, given its tokens, as tinycss2 makes them.

    Returns None for a pseudo-class or function that is not supported, for a function inside of a
    function, and for a pseudo-class that examines all siblings after `of`. A pseudo-element
    that is no function costs nothing, whatever its name.
    """
    while tokens and tokens[-1].type == "whitespace":
        tokens = tokens[:-1]
    descendants, later_sibling_combinators = _combinators(tokens)
    last_looks_at_siblings = others_look_at_siblings = False
    colons = 0
    for token in tokens:
        if token.type == "whitespace" or (token.type == "literal" and token.value in ">+~"):
            others_look_at_siblings |= last_looks_at_siblings
            last_looks_at_siblings = False
        elif token.type == "ident" and colons == 1:
            if token.lower_value in _COSTLY_PSEUDO_CLASSES:
                last_looks_at_siblings = True
            elif token.lower_value not in _PSEUDO_CLASSES | _PSEUDO_ELEMENTS_AFTER_ONE_COLON:
                return None
        elif token.type == "function":
            if token.lower_name not in _FUNCTIONS:
                return None
            if any(argument.type == "function" for argument in token.arguments):
                return None
            words = {word.lower_value for word in token.arguments if word.type == "ident"}
            is_costly = not words.isdisjoint(_COSTLY_PSEUDO_CLASSES)
            last_looks_at_siblings |= is_costly or _FUNCTIONS[token.lower_name]
            if "of" in words:
                # The selector after `of` is tested on all siblings.
                if is_costly:
                    return None
                others_look_at_siblings = True
            more_descendants, more_later_sibling_combinators = _combinators(token.arguments)
            descendants, later_sibling_combinators = (
                descendants + more_descendants,
                later_sibling_combinators + more_later_sibling_combinators,
            )
        colons = colons + 1 if token.type == "literal" and token.value == ":" else 0
    return Cost(
        descendants, later_sibling_combinators, last_looks_at_siblings, others_look_at_siblings
    )


def _combinators(tokens: list[Any]) -> tuple[int, int]:
    """Count the combinators among the tokens of a selector, or of a function's arguments.

    Returns the number of descendant combinators, which are blanks between compounds, and the number
    of combinators `~`.
    """
    descendants = later_sibling_combinators = 0
    is_separated, is_after_compound = False, False
    for token in tokens:
        if token.type == "comment":
            continue
        if token.type == "whitespace":
            is_separated = True
            continue
        is_combinator = token.type == "literal" and token.value in (">", "+", "~", ",")
        later_sibling_combinators += is_combinator and token.value == "~"
        descendants += is_separated and is_after_compound and not is_combinator
        is_separated, is_after_compound = False, not is_combinator
    return descendants, later_sibling_combinators
