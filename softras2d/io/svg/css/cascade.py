"""Finds the declarations of every element, from attributes, style sheets and `style`, by rank.

tinycss2 parses style sheets, and cssselect2 matches selectors. This module sorts declarations by
importance, and bounds the work.

**Source:** *CSS Cascading and Inheritance 4*, "Cascading"; SVG 2, section 6.6 (presentation
attributes precede all style sheets, with specificity 0).
"""

from typing import Any, NamedTuple

import cssselect2
import tinycss2

from ...budget import Budget
from ..values.css_color import nesting
from ..xml.notices import INVALID, WITHOUT_EFFECT, Notices
from ..xml.tree import Element
from . import media_queries
from .selector_costs import Cost, max_tests, selector_costs

_MAX_NESTING = 32
"""Maximum depth of nested brackets in CSS, since tinycss2 recurses for each."""

_MAX_SELECTORS = 20_000
"""Maximum number of selectors in a document, since each is compiled to Python code."""


class Declarations(NamedTuple):
    """The declarations of one element: texts of values, by property name.

    - `css`: values from style sheets and the attribute `style`. Of several, it is the one of
      highest rank.
    - `attributes`: all attributes of the element. Those that are presentation attributes have an
      effect where `css` has no valid value.
    - `outranked`: the other values from CSS, lowest rank first. If the value in `css` is invalid,
      one of these counts.
    """

    css: dict[str, str]
    attributes: dict[str, str]
    outranked: dict[str, list[str]]

    def css_values(self, name: str) -> list[str]:
        """All values of a property from CSS, highest rank first; empty if there is none."""
        if name not in self.css:
            return []
        return [self.css[name], *reversed(self.outranked.get(name, ()))]


_Block = dict[str, list[str]]
"""Values of each property in a block of declarations, lowest rank first."""

_MAX_OUTRANKED = 16
"""Maximum number of values of one property that are kept in case higher ones are invalid."""


class _Rule(NamedTuple):
    """Declarations of a rule, with and without `!important`, and the cost of one selector."""

    important: _Block
    normal: _Block
    cost: Cost


class Cascade:
    """The style sheets of a document.

    - `notices`: receives what is invalid or not supported.
    - `budget`: charged for tests of selectors.
    - `height`, `width`: size of the canvas in pixels, for media queries.
    """

    def __init__(self, notices: Notices, budget: Budget, height: int, width: int):
        self._height = height
        self._width = width
        self._notices = notices
        self._matcher = _ChargedMatcher(budget)
        self._selectors = 0
        self._noted: set[tuple[int, str, str]] = set()

    def add_sheet(self, element: Element) -> None:
        """Add the rules of a `<style>` element, unless it is of another type or medium.

        What is invalid or not supported is noted. Raises `ValueError` for more than
        `_MAX_SELECTORS` selectors in all style sheets.
        """
        kind = element.attrib.get("type", "text/css").strip().lower() or "text/css"
        if kind != "text/css":
            return
        if not self._matches(element.attrib.get("media", ""), element, "media"):
            return
        text = "".join(element.texts)
        if nesting(text) > _MAX_NESTING:
            detail = f"brackets are nested deeper than {_MAX_NESTING}"
            self._notices.add(INVALID, element.tag, element.line, "text", detail)
            return
        try:
            rules = tinycss2.parse_stylesheet(text, skip_comments=True, skip_whitespace=True)
        except ValueError as error:
            # Raised for integers of thousands of digits.
            self._notices.add(INVALID, element.tag, element.line, "text", str(error))
            return
        self._add_rules(rules, element)

    def _add_rules(self, rules: list[Any], element: Element) -> None:
        for rule in rules:
            if rule.type == "qualified-rule":
                self._add_rule(rule, element)
            elif rule.type == "at-rule" and rule.lower_at_keyword == "media" and rule.content:
                if self._matches(tinycss2.serialize(rule.prelude), element, "@media"):
                    rules_within = tinycss2.parse_rule_list(
                        rule.content, skip_comments=True, skip_whitespace=True
                    )
                    self._add_rules(rules_within, element)
            elif rule.type == "at-rule":
                # These three change nothing that is drawn, since no text is drawn.
                if rule.lower_at_keyword not in ("charset", "namespace", "font-face"):
                    name = f"@{rule.lower_at_keyword}"
                    self._notices.add(WITHOUT_EFFECT, element.tag, element.line, name)
            else:
                self._notices.add(INVALID, element.tag, element.line, "rule", str(rule.message))

    def _matches(self, media: str, element: Element, attribute: str) -> bool:
        """Whether a list of media queries matches the canvas.

        A list whose value is unknown does not match, and is noted as a fault of `attribute`.
        """
        is_match = media_queries.matches(media, self._height, self._width)
        if is_match is None:
            self._notices.add(WITHOUT_EFFECT, element.tag, element.line, attribute, media.strip())
        return bool(is_match)

    def _add_rule(self, rule: Any, element: Element) -> None:
        important, normal = self._parsed(rule.content, element, "rule")
        selector_text = tinycss2.serialize(rule.prelude).strip()
        costs = selector_costs(rule.prelude)
        try:
            if costs is None:
                raise cssselect2.SelectorError("is not supported")
            selectors = cssselect2.compile_selector_list(rule.prelude)
        except (cssselect2.SelectorError, NotImplementedError, SyntaxError, ValueError):
            # A rule with one invalid selector is dropped as a whole.
            self._notices.add(WITHOUT_EFFECT, element.tag, element.line, "selector", selector_text)
            return
        self._selectors += len(selectors)
        if self._selectors > _MAX_SELECTORS:
            raise ValueError(f"brings the style sheets to more than {_MAX_SELECTORS} selectors.")
        for selector, cost in zip(selectors, costs, strict=True):
            if selector.pseudo_element is None:
                self._matcher.add_selector(selector, _Rule(important, normal, cost))

    def declarations(self, element: Element) -> Declarations:
        """The declarations of an element, by rank.

        A `style` attribute that is invalid is noted. Raises `BudgetError` if testing selectors
        exceeds the budget.
        """
        text = element.attrib.get("style")
        if not self._selectors:
            if text is None:
                return Declarations({}, element.attrib, {})
            important, normal = self._style_attribute(text, element)
            return _ranked([normal, important], element)
        rules = [payload for _, _, _, payload in self._matcher.match(element)]
        inline = ({}, {}) if text is None else self._style_attribute(text, element)
        blocks = [rule.normal for rule in rules]
        blocks += [inline[1], *(rule.important for rule in rules), inline[0]]
        return _ranked(blocks, element)

    def _style_attribute(self, text: str, element: Element) -> tuple[_Block, _Block]:
        if not set("\"'\\{}[]@/(!") & set(text):
            # This common form is split here, which takes a tenth of the parser's time.
            pairs = [part.partition(":") for part in text.split(";") if part.strip()]
            plain = [(name.strip().lower(), value.strip()) for name, _, value in pairs]
            if all(name.replace("-", "").isalpha() and value for name, value in plain):
                block: _Block = {}
                for name, value in plain:
                    _append(block, name, [value])
                return {}, block
        return self._parsed(text, element, "style")

    def _parsed(self, content: Any, element: Element, attribute: str) -> tuple[_Block, _Block]:
        """Parse the declarations of a block, which are tokens, or of a `style` attribute, a text.

        Returns the important declarations and the normal ones. What is invalid is noted as a fault
        of `attribute`.
        """
        if isinstance(content, str) and nesting(content) > _MAX_NESTING:
            detail = f"brackets are nested deeper than {_MAX_NESTING}"
            self._note(INVALID, element, attribute, detail)
            return {}, {}
        important: _Block = {}
        normal: _Block = {}
        try:
            nodes = tinycss2.parse_blocks_contents(
                content, skip_comments=True, skip_whitespace=True
            )
        except ValueError as error:
            self._note(INVALID, element, attribute, str(error))
            return {}, {}
        for node in nodes:
            if node.type != "declaration":
                is_rule = node.type in ("qualified-rule", "at-rule")
                detail = "a rule within a rule" if is_rule else "a part is not a declaration"
                self._note(WITHOUT_EFFECT if is_rule else INVALID, element, attribute, detail)
                continue
            values = important if node.important else normal
            _append(values, node.lower_name, [tinycss2.serialize(node.value).strip()])
        return important, normal

    def _note(self, kind: str, element: Element, attribute: str, detail: str) -> None:
        """Note a fault of an element once, although `style` is parsed for each of its copies."""
        key = (id(element), attribute, detail)
        if key not in self._noted:
            self._noted.add(key)
            self._notices.add(kind, element.tag, element.line, attribute, detail)


def _append(block: _Block, name: str, values: list[str]) -> None:
    # The name moves to the end of the block, since a shorthand such as `font` and its longhands
    # override each other in this order.
    block[name] = [*block.pop(name, ()), *values][-_MAX_OUTRANKED - 1 :]


def _ranked(blocks: list[_Block], element: Element) -> Declarations:
    """Merge blocks, lowest rank first, into the declarations of an element."""
    merged: _Block = {}
    for block in blocks:
        for name, values in block.items():
            _append(merged, name, values)
    css = {name: values[-1] for name, values in merged.items()}
    outranked = {name: values[:-1] for name, values in merged.items() if len(values) > 1}
    return Declarations(css, element.attrib, outranked)


class _ChargedMatcher(cssselect2.Matcher):
    """A matcher that charges `selector_tests` to a budget before it tests selectors."""

    def __init__(self, budget: Budget):
        super().__init__()
        self._budget = budget

    def add_relevant_selectors(self, element: Element, selectors: list, relevant: list) -> None:
        """Append to `relevant` the selectors that match an element; called by `match`.

        Raises `BudgetError` if the tests exceed the budget.
        """
        if not selectors:
            return
        tests = len(selectors)
        depth = siblings = None
        for *_, rule in selectors:
            if not any(rule.cost):
                continue
            if depth is None or siblings is None:
                ancestors = list(element.ancestors)
                depth = len(ancestors)
                # Combinators above a descendant combinator choose siblings of an ancestor.
                siblings = sum(len(e.etree_siblings) for e in (element, *ancestors))
            tests += max_tests(rule.cost, depth, siblings)
        self._budget.charge("selector_tests", tests)
        super().add_relevant_selectors(element, selectors, relevant)
