"""Collects the declarations that apply to an element, and sorts them by rank.

A declaration gives a value to a property. It stands in an attribute of the element, in a style
sheet, or in the attribute `style`. Its rank is its position in the order of the CSS cascade: of two
declarations of one property, the one of higher rank takes effect. tinycss2 parses style sheets, and
cssselect2 matches selectors. This module ranks the declarations, and limits the work.

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
from .selector_costs import Cost, max_tests, selector_cost, split_selectors

_MAX_NESTING = 32
"""Maximum depth of nested brackets in CSS, since tinycss2 recurses for each bracket.

A style sheet or an attribute `style` with deeper brackets is left out as a whole.
"""

_MAX_SELECTORS = 20_000
"""Maximum number of selectors in a document, since cssselect2 compiles each to Python code."""


class Declarations(NamedTuple):
    """The declarations that apply to one element, as texts of values by property name.

    Of two values of one property, the one of higher rank in the CSS cascade takes effect. Names of
    properties are in lower case.

    - `css`: for each property, the value of highest rank from style sheets and the attribute
      `style`. The properties are in the order of the ranks of these values, lowest first.
    - `attributes`: all attributes of the element. A presentation attribute, such as `fill`, takes
      effect only if neither `css` nor `outranked` has a valid value of the property.
    - `outranked`: for each property, the values from style sheets and `style` whose rank is below
      that of the value in `css`, lowest rank first; at most the `_MAX_OUTRANKED` highest. If the
      value in `css` is invalid, the last valid value of this list takes effect.
    """

    css: dict[str, str]
    attributes: dict[str, str]
    outranked: dict[str, list[str]]

    def css_values(self, name: str) -> list[str]:
        """All values of a property from style sheets and `style`, highest rank first.

        The list is empty if there are none.
        """
        if name not in self.css:
            return []
        return [self.css[name], *reversed(self.outranked.get(name, ()))]


_Block = dict[str, list[str]]
"""The values in a block of declarations, such as the body of a rule: a list for each property.

A list has the value of lowest rank first.
"""

_MAX_OUTRANKED = 16
"""Maximum number of values of one property that are stored in `Declarations.outranked`."""


class _Rule(NamedTuple):
    """A style rule for one of its selectors.

    - `important`, `normal`: the declarations of the rule with and without `!important`.
    - `cost`: bounds the time of testing the selector.
    """

    important: _Block
    normal: _Block
    cost: Cost


class Cascade:
    """The style sheets of a document, from which the declarations of each element are computed.

    - `notices`: receives a notice about what is invalid or not supported.
    - `budget`: charged before a selector is tested on an element.
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
        """Add the rules of a `<style>` element, if it is CSS and its media queries match.

        Call it in document order: of rules whose selectors have the same specificity, the one added
        last has the highest rank. Rules that are invalid, or not supported although they may change
        the image, are noted and left out. Raises `ValueError` for more than `_MAX_SELECTORS`
        selectors in all style sheets of the document.
        """
        content_type = element.attrib.get("type", "text/css").strip().lower() or "text/css"
        if content_type != "text/css":
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
        """Add rules that tinycss2 has parsed, including those in `@media` blocks that match.

        Other rules are left out, and noted unless they change nothing that is drawn. `element` is
        the `<style>` element, which notices name. Raises `ValueError` for too many selectors.
        """
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
        """Whether the list of media queries in `media` matches the canvas.

        If that cannot be decided, the result is False, and the list is noted as a fault in
        `attribute` of `element`.
        """
        is_match = media_queries.matches(media, self._height, self._width)
        if is_match is None:
            self._notices.add(WITHOUT_EFFECT, element.tag, element.line, attribute, media.strip())
        return bool(is_match)

    def _add_rule(self, rule: Any, element: Element) -> None:
        """Add a style rule that tinycss2 has parsed, once for each of its selectors.

        If one selector is invalid or not supported, the rule is noted and left out as a whole. A
        selector with a pseudo-element, such as `::before`, is noted and matches nothing, but the
        others of the rule apply. `element` is the `<style>` element, which notices name. Raises
        `ValueError` for too many selectors.
        """
        important, normal = self._parse_block(rule.content, element, "rule")
        split_prelude = split_selectors(rule.prelude)
        costs = [selector_cost(tokens) for tokens in split_prelude]
        try:
            if None in costs:
                raise cssselect2.SelectorError("is not supported")
            selectors = cssselect2.compile_selector_list(rule.prelude)
        except (cssselect2.SelectorError, NotImplementedError, SyntaxError, ValueError):
            # A rule with one invalid selector is dropped as a whole.
            self._note_selector(rule.prelude, element)
            return
        self._selectors += len(selectors)
        if self._selectors > _MAX_SELECTORS:
            raise ValueError(f"brings the style sheets to more than {_MAX_SELECTORS} selectors.")
        for tokens, selector, cost in zip(split_prelude, selectors, costs, strict=True):
            if selector.pseudo_element is not None:
                self._note_selector(tokens, element)
            elif cost is not None:
                self._matcher.add_selector(selector, _Rule(important, normal, cost))

    def _note_selector(self, tokens: list[Any], element: Element) -> None:
        """Note that selectors of a `<style>` element, given their tokens, have no effect."""
        text = tinycss2.serialize(tokens).strip()
        self._notices.add(WITHOUT_EFFECT, element.tag, element.line, "selector", text)

    def declarations(self, element: Element) -> Declarations:
        """The declarations that apply to an element, from style sheets and its own attributes.

        Errors in its attribute `style` are noted. Raises `BudgetError` if testing selectors exceeds
        the budget.
        """
        text = element.attrib.get("style")
        if not self._selectors:
            if text is None:
                return Declarations({}, element.attrib, {})
            important, normal = self._style_attribute(text, element)
            return _merge([normal, important], element)
        rules = [rule for _, _, _, rule in self._matcher.match(element)]
        important, normal = ({}, {}) if text is None else self._style_attribute(text, element)
        blocks = [rule.normal for rule in rules]
        blocks += [normal, *(rule.important for rule in rules), important]
        return _merge(blocks, element)

    def _style_attribute(self, text: str, element: Element) -> tuple[_Block, _Block]:
        """Parse the attribute `style`; returns its important and its normal declarations.

        Errors are noted as by `_parse_block`.
        """
        if not set("\"'\\{}[]@/(!") & set(text):
            # This common form is split here, which takes a tenth of the parser's time.
            split_texts = [
                declaration.partition(":") for declaration in text.split(";") if declaration.strip()
            ]
            name_values = [(name.strip().lower(), value.strip()) for name, _, value in split_texts]
            if all(name.replace("-", "").isalpha() and value for name, value in name_values):
                block: _Block = {}
                for name, value in name_values:
                    _append(block, name, [value])
                return {}, block
        return self._parse_block(text, element, "style")

    def _parse_block(self, content: Any, element: Element, attribute: str) -> tuple[_Block, _Block]:
        """Parse a block of declarations; returns the important declarations and the normal ones.

        - `content`: the tokens in the body of a rule, or the text of an attribute `style`.
        - `attribute`: name that notices give to the block, `"rule"` or `"style"`.

        What is no declaration is noted as a fault of `element`, and left out. A text whose brackets
        are nested deeper than `_MAX_NESTING` is noted, and left out as a whole. Values are not
        checked.
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
            block = important if node.important else normal
            _append(block, node.lower_name, [tinycss2.serialize(node.value).strip()])
        return important, normal

    def _note(self, kind: str, element: Element, attribute: str, detail: str) -> None:
        """Add a notice about an attribute of an element, unless it was added before.

        The attribute `style` is parsed each time that an element is drawn, and a `use` may draw it
        often.
        """
        key = (id(element), attribute, detail)
        if key not in self._noted:
            self._noted.add(key)
            self._notices.add(kind, element.tag, element.line, attribute, detail)


def _append(block: _Block, name: str, values: list[str]) -> None:
    """Append values of the property `name` to a block, and move the property to the block's end.

    `values` are of higher rank than those in the block, and in order of rank, lowest first. The
    block is changed. At most `_MAX_OUTRANKED + 1` values are stored, those of highest rank.
    """
    # The name moves to the end of the block, since a shorthand such as `font` and its longhands
    # override each other in this order.
    block[name] = [*block.pop(name, ()), *values][-_MAX_OUTRANKED - 1 :]


def _merge(blocks: list[_Block], element: Element) -> Declarations:
    """Merge blocks of declarations that apply to an element, and add the element's attributes.

    `blocks` are given from the lowest rank to the highest.
    """
    merged: _Block = {}
    for block in blocks:
        for name, values in block.items():
            _append(merged, name, values)
    css = {name: values[-1] for name, values in merged.items()}
    outranked = {name: values[:-1] for name, values in merged.items() if len(values) > 1}
    return Declarations(css, element.attrib, outranked)


class _ChargedMatcher(cssselect2.Matcher):
    """A matcher of selectors that charges the budget before it tests selectors on an element.

    The budget counts these tests as `selector_tests`.
    """

    def __init__(self, budget: Budget):
        super().__init__()
        self._budget = budget

    def add_relevant_selectors(self, element: Element, selectors: list, relevant: list) -> None:
        """Append to `relevant` those of `selectors` that match an element.

        `selectors` are tuples, whose first item is the test of a selector and whose last item is
        its `_Rule`; they are appended without the test. `cssselect2.Matcher.match` calls this
        method. Raises `BudgetError`, before any test, if the tests exceed the budget.
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
