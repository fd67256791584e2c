"""The part of YAML that configuration files need, with limits on the cost of reading.

The values are plain ones of Python: mappings, lists, text, numbers, true and false, nothing. Anchors and merge keys
work. Refused, each with its place: input that would silently be changed (duplicate keys; 010, which could be 8), tags,
control characters, and structures of unlimited size (deep nesting, aliases of aliases, lists that contain themselves).
PyYAML parses, in C if libyaml is installed; values are made here of its events, because its own composers recurse
without a limit.
"""

import re
from itertools import takewhile
from typing import Any

import yaml
from yaml.constructor import SafeConstructor
from yaml.resolver import Resolver

from msp_range.input_file import text_fault

MOST_DEPTH = 32
"""Deepest nesting of mappings and lists. Files of this project have 7; the stack of a thread allows some hundreds."""
MOST_NODES = 20_000
"""Largest number of values in a file, with aliases expanded. The largest file of this project has 700; the limit takes
0.2 s and 20 MB."""
LARGEST_NUMBER = 1e12
"""Largest magnitude of a number: larger than any quantity of a vehicle, and sums and squares do not overflow."""

_TAG = "tag:yaml.org,2002:"
_EXPONENT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)[eE][-+]?[0-9]+")
"""1e3 is text in YAML 1.1, and a number to the section that holds it."""


class _Values:
    """The values of a YAML text, made of the parser's events; every error is a `yaml.MarkedYAMLError` with its place.

    Methods take the event with which their value begins.
    """

    def __init__(self, text: str) -> None:
        self._events = yaml.parse(text, Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader))
        self._nodes = 0
        self._anchors: dict[str, tuple[Any, int] | None] = {}
        """Value of each anchor and the number of values in it; None while it is being read."""

    def document(self) -> Any:
        """The value of the only document; None where there is none."""
        found = None
        for event in self._events:
            if isinstance(event, yaml.DocumentStartEvent):
                if self._nodes:
                    raise _error("expected a single document, but found another document", event)
                found = self._value(next(self._events))
        return found

    def _value(self, event: Any, depth: int = 1) -> Any:
        """The next value, checked and counted."""
        if isinstance(event, yaml.AliasEvent):
            if event.anchor not in self._anchors:
                raise _error(f"found *{event.anchor}, but no &{event.anchor} before it", event)
            known = self._anchors[event.anchor]
            if known is None:
                raise _error(f"*{event.anchor} is inside &{event.anchor} itself", event)
            self._count(known[1], event)
            return known[0]
        if event.tag is not None:
            raise _error(f"found the tag {event.tag.replace(_TAG, '!!')}, expected a value without a tag", event)
        before = self._nodes
        self._count(1, event)
        if depth > MOST_DEPTH:
            raise _error(f"found more than {MOST_DEPTH} mappings and lists inside each other", event)
        if event.anchor in self._anchors:
            raise _error(f"the anchor &{event.anchor} is given twice", event)
        if event.anchor is not None:
            self._anchors[event.anchor] = None
        value: Any
        if isinstance(event, yaml.ScalarEvent):
            value = _scalar(event)
        elif isinstance(event, yaml.SequenceStartEvent):
            value = [self._value(part, depth + 1) for part in self._parts()]
        else:
            value = self._mapping(depth)
        if event.anchor is not None:
            self._anchors[event.anchor] = value, self._nodes - before
        return value

    def _parts(self) -> Any:
        """The events with which the parts of a list or mapping begin; who takes one reads its value before the next."""
        return takewhile(lambda event: not isinstance(event, yaml.CollectionEndEvent), self._events)

    def _mapping(self, depth: int) -> dict[Any, Any]:
        """A mapping, whose keys are text or numbers, each given once; what it merges stands before its own."""
        own: dict[Any, Any] = {}
        merged: dict[Any, Any] = {}
        seen = set()
        for key in self._parts():
            name = self._value(key, depth + 1)
            if isinstance(name, list | dict):
                raise _error(
                    f"found a {'list' if isinstance(name, list) else 'mapping'} as a key, expected a word", key
                )
            if name in seen:
                raise _error(f"the key {name!r} is given twice", key)
            seen.add(name)
            start = next(self._events)
            value = self._value(start, depth + 1)
            if name == "<<" and isinstance(key, yaml.ScalarEvent) and key.implicit[0]:
                for mapping in reversed(value if isinstance(value, list) else [value]):
                    if not isinstance(mapping, dict):
                        raise _error(
                            f"expected a mapping or list of mappings for merging, but found {mapping!r}", start
                        )
                    merged |= mapping
            else:
                own[name] = value
        return merged | own

    def _count(self, nodes: int, event: Any) -> None:
        self._nodes += nodes
        if self._nodes > MOST_NODES:
            raise _error(f"found more than {MOST_NODES} values, aliases counted as what they stand for", event)


def _scalar(event: Any) -> Any:
    """Text, a number, true, false or nothing. A date stays text, and so does a time such as 12:30, which YAML 1.1 takes
    for a number; infinity and NaN are accepted here and refused by the section."""
    word = event.value
    if (fault := text_fault(word)) is not None:  # an escape sequence makes it of characters that are text
        raise _error(fault[2], event)
    if not event.implicit[0] or ":" in word:
        return word
    text = word.replace("_", "").lower()
    tags = [tag for tag, form in Resolver.yaml_implicit_resolvers.get(word[:1], ()) if form.match(word)]
    kind = tags[0].removeprefix(_TAG) if tags else ""
    if kind == "null":
        return None
    if kind == "bool":
        return SafeConstructor.bool_values[text]
    if kind == "int" and re.fullmatch(r"[-+]?0[0-7]+", text):
        raise _error(
            f"found {word[:40]}, which may be read as an octal number; expected no 0 in front, 0x if it is "
            "hexadecimal, or quotes around it if it is text",
            event,
        )
    is_number = kind in ("int", "float")
    if not is_number and not _EXPONENT.fullmatch(word):
        return word
    try:
        number = int(text, 0) if kind == "int" else float(text.replace(".inf", "inf").replace(".nan", "nan"))
    except ValueError:  # 0x without a digit, or more digits than Python reads
        number = LARGEST_NUMBER * 2
    if abs(number) > LARGEST_NUMBER and not text.endswith("inf"):
        raise _error(f"found {word[:40]}, expected a number of at most {LARGEST_NUMBER:g}", event)
    return number if is_number else word


def _error(problem: str, at: Any) -> yaml.MarkedYAMLError:
    return yaml.MarkedYAMLError(problem=problem, problem_mark=at.start_mark)


def load_yaml(text: str) -> Any:
    """Parse a YAML text, as `read_text` returns it, into plain Python values.

    Raises
    ------
    yaml.YAMLError
        It is not YAML, or beyond the limits of this module.

    Examples
    --------
    >>> load_yaml("a: &a {x: 0x70, y: 2026-13-45}\\nb: {<<: *a, y: 1.5}")
    {'a': {'x': 112, 'y': '2026-13-45'}, 'b': {'x': 112, 'y': 1.5}}
    """
    return _Values(text).document()
