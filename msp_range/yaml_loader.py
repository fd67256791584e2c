"""The part of YAML that configuration files need, with limits on the cost of reading.

Text enters, plain Python values leave: mappings, lists, text, numbers, true and false, nothing. Anchors and merge keys
work. Refused, each with its place: input that would silently be changed (duplicate keys; 010, which could be 8), tags,
control characters, and structures of unlimited size (deep nesting, aliases of aliases, lists that contain themselves).
Scanning is done in C if libyaml is installed; composing is done here, because libyaml's composer recurses without a
limit.
"""

import re
from typing import Any

import yaml
from yaml.composer import Composer
from yaml.constructor import SafeConstructor
from yaml.resolver import Resolver

from msp_range.input_file import CONTROL

MOST_DEPTH = 32
"""Deepest nesting of mappings and lists. Files of this project have 7; the stack of a thread allows some hundreds."""
MOST_NODES = 20_000
"""Largest number of values in a file, with aliases expanded. The largest file of this project has 700; the limit takes
0.2 s and 20 MB."""
LARGEST_NUMBER = 1e12
"""Largest magnitude of a number: larger than any quantity of a vehicle, and sums and squares do not overflow."""

_TAG = "tag:yaml.org,2002:"
_TYPES = ("bool", "int", "float", "null", "merge")
_EXPONENT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)[eE][-+]?[0-9]+")
"""1e3 is text in YAML 1.1, and a number to the section that holds it."""
_OCTAL = re.compile(r"[-+]?0[0-7]+")

if yaml.__with_libyaml__:
    from yaml._yaml import CParser as _Parser
else:
    from yaml.parser import Parser
    from yaml.reader import Reader
    from yaml.scanner import Scanner

    class _Parser(Reader, Scanner, Parser):  # type: ignore[no-redef]
        """PyYAML's own parser, which is slower."""

        def __init__(self, text: str) -> None:
            Reader.__init__(self, text)
            Scanner.__init__(self)
            Parser.__init__(self)


class LimitedLoader(Composer, _Parser, SafeConstructor, Resolver):
    """The loader; every error is a `yaml.MarkedYAMLError` with its place."""

    yaml_implicit_resolvers = {  # noqa: RUF012 - PyYAML's own name; a date stays text
        first: [each for each in resolvers if each[0].removeprefix(_TAG) in _TYPES]
        for first, resolvers in Resolver.yaml_implicit_resolvers.items()
    }

    def __init__(self, text: str) -> None:
        _Parser.__init__(self, text)
        Composer.__init__(self)
        SafeConstructor.__init__(self)
        Resolver.__init__(self)
        self._depth = 0
        self._nodes = 0
        self._sizes: dict[int, int] = {}

    def compose_node(self, parent: Any, index: Any) -> Any:
        """The next value, checked and counted."""
        event: Any = self.peek_event()
        if isinstance(event, yaml.AliasEvent):
            node = super().compose_node(parent, index)
            size = self._sizes.get(id(node))
            if size is None:
                raise _error(f"*{event.anchor} is inside &{event.anchor} itself", event)
            self._count(size, event)
            return node
        if event.tag is not None:
            raise _error(f"found the tag {event.tag.replace(_TAG, '!!')}, expected a value without a tag", event)
        before = self._nodes
        self._count(1, event)
        self._depth += 1
        if self._depth > MOST_DEPTH:
            raise _error(f"found more than {MOST_DEPTH} mappings and lists inside each other", event)
        node = super().compose_node(parent, index)
        self._depth -= 1
        if event.anchor is not None:
            self._sizes[id(node)] = self._nodes - before
        return node

    def _count(self, nodes: int, event: Any) -> None:
        self._nodes += nodes
        if self._nodes > MOST_NODES:
            raise _error(f"found more than {MOST_NODES} values, aliases counted as what they stand for", event)

    def compose_scalar_node(self, anchor: Any) -> Any:
        """A scalar: text or a number."""
        node = super().compose_scalar_node(anchor)
        control = CONTROL.search(node.value)
        if control is not None:
            raise _error(_control_character(control[0]), node)
        if node.style in (None, "") and _EXPONENT.fullmatch(node.value) and abs(float(node.value)) > LARGEST_NUMBER:
            raise _error(_too_large(node), node)
        return node

    def compose_mapping_node(self, anchor: Any) -> Any:
        """A mapping, whose keys are text or numbers, each given once; what it merges stands before its own.

        Merged here and not by PyYAML: its 6.0.4 takes a key of one letter from what a mapping had merged itself.
        """
        node = super().compose_mapping_node(anchor)
        own: dict[str, Any] = {}
        merged: dict[str, Any] = {}
        for key, value in node.value:
            if not isinstance(key, yaml.ScalarNode):
                raise _error(f"found a {'list' if key.id == 'sequence' else key.id} as a key, expected a word", key)
            if key.value in own:
                raise _error(f"the key {key.value!r} is given twice", key)
            own[key.value] = (key, value)
            if key.tag == _TAG + "merge":
                for each in reversed(value.value if isinstance(value, yaml.SequenceNode) else [value]):
                    if not isinstance(each, yaml.MappingNode):
                        raise _error(f"expected a mapping or list of mappings for merging, but found {each.id}", each)
                    merged |= {pair[0].value: pair for pair in each.value}
        if merged:
            del own["<<"]
            node.value = list((merged | own).values())
        return node

    def construct_int(self, node: Any) -> int | str:
        """A whole number, or the text of a time such as 12:30, which YAML 1.1 also treats as a number."""
        text = node.value.replace("_", "")
        if ":" in text:
            return str(node.value)
        if _OCTAL.fullmatch(text):
            raise _error(
                f"found {node.value[:40]}, which may be read as an octal number; expected no 0 in front, 0x if it is "
                "hexadecimal, or quotes around it if it is text",
                node,
            )
        try:
            number = int(text, 0)
        except ValueError:  # 0x without a digit, or more digits than Python reads
            raise _error(_too_large(node), node) from None
        if abs(number) > LARGEST_NUMBER:
            raise _error(_too_large(node), node)
        return number

    def construct_float(self, node: Any) -> float | str:
        """A number; infinity and NaN are accepted here and refused by the section."""
        text = node.value.replace("_", "").lower()
        if ":" in text:
            return str(node.value)
        number = float(text.replace(".inf", "inf").replace(".nan", "nan"))
        if abs(number) > LARGEST_NUMBER and not text.endswith("inf"):
            raise _error(_too_large(node), node)
        return number

    yaml_constructors = {  # noqa: RUF012
        **SafeConstructor.yaml_constructors,
        _TAG + "int": construct_int,
        _TAG + "float": construct_float,
    }


def _error(problem: str, at: Any) -> yaml.MarkedYAMLError:
    return yaml.MarkedYAMLError(problem=problem, problem_mark=at.start_mark)


def _too_large(node: Any) -> str:
    return f"found {node.value[:40]}, expected a number of at most {LARGEST_NUMBER:g}"


def _control_character(found: str) -> str:
    return f"found the control character {found!r}, expected text without any"


def load_yaml(text: str) -> Any:
    """Parse a YAML text into plain Python values.

    Raises
    ------
    yaml.YAMLError
        It is not YAML, or beyond the limits of this module.

    Examples
    --------
    >>> load_yaml("a: &a {x: 0x70, y: 2026-13-45}\\nb: {<<: *a, y: 1.5}")
    {'a': {'x': 112, 'y': '2026-13-45'}, 'b': {'x': 112, 'y': 1.5}}
    """
    control = CONTROL.search(text)
    if control is not None:
        before = text[: control.start()]
        mark = yaml.Mark("", 0, before.count("\n"), control.start() - before.rfind("\n") - 1, "", 0)
        raise yaml.MarkedYAMLError(problem=_control_character(control[0]), problem_mark=mark)
    return LimitedLoader(text).get_single_data()
