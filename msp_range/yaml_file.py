"""Read and validate YAML files, with helpful error messages.

Every configuration file of the project is a `Section` read by `load`. Errors become one `ConfigError` whose lines
contain the file, the path inside it, what was found, what was expected and, for an unknown key, the most similar one.
"""

import difflib
import os
import types
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, TypeVar, Union, get_args, get_origin

import yaml
from pydantic import BaseModel, ConfigDict, GetJsonSchemaHandler, ValidationError, ValidationInfo
from pydantic_core import CoreSchema

from msp_range.descriptions import descriptions
from msp_range.errors import UserError
from msp_range.input_file import printable, read_text
from msp_range.state_folder import CHOOSE_AIRFRAME, SERVICE_AIRFRAME
from msp_range.yaml_loader import load_yaml

SHIPPED = Path(__file__).parent / "configs"
"""Configuration files of the package: airframes, and folders for the other kinds."""
LARGEST_FILE_BYTES = 2**20
"""Largest configuration file: those of this project have at most 6 kB. Reading one of this size takes 0.1 s."""
MOST_LINES = 20
"""Largest number of errors reported for one file."""
MOST_PROBLEMS = 1000
"""Largest number of pydantic's problems examined for these lines; unions give several for each error. Each costs 50
us."""
LONGEST_LINE = 1000
"""Length of an error message; of a long value the start is enough."""
FILE_KINDS = {
    "an airframe file": {"vehicle", "sensors"},
    "a sensor model": {"minimum_cm", "reading_model"},
    "a scenario": {"airframe", "duration_s"},
    "a campaign": {"campaign", "conditions"},
    "a campaign of flights": {"campaign", "flights"},
    "a column map": {"columns"},
}
"""Kind of file -> keys by which it is recognised where a file of another kind is expected: it has all keys wrong."""
_QUOTE = "'"


class ConfigError(UserError, ValueError):
    """A configuration file that cannot be used; the message is for the author of the file."""


class Section(BaseModel):
    """Base of every part of a configuration file: frozen, with unknown keys and NaN as errors."""

    model_config = ConfigDict(
        extra="forbid",
        frozen=True,
        allow_inf_nan=False,
        strict=False,
        # Sections inside others are built with them; building them separately took 20 ms of each start of the bridge.
        defer_build=True,
    )

    @classmethod
    def __get_pydantic_json_schema__(cls, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        """The JSON Schema with each key's description."""
        described = handler(schema)
        properties = handler.resolve_ref_schema(described)["properties"]
        for key, description in descriptions(cls).items():
            properties[key]["description"] = description
        return described


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Context in which the file ``path``, which a user named, is written.

    Raises
    ------
    ConfigError
        It cannot be.
    """
    try:
        yield
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error.strerror}") from None


def write_file(path: Path, text: str) -> None:
    """Write a text into a file that a user named; raises ConfigError as `writing` does."""
    with writing(path):
        path.write_text(text, encoding="utf-8")


Place = tuple[int | str, ...]
"""Keys and indices that lead to a value in a file."""
SectionT = TypeVar("SectionT", bound=Section)
ReadT = TypeVar("ReadT")


def read_yaml(path: Path) -> Any:
    """Read a YAML file as plain Python values.

    Raises
    ------
    ConfigError
        The file is missing, unreadable, not YAML, or beyond the limits of `msp_range.yaml_loader`.
    """
    text = read_config(path)
    try:
        return load_yaml(text)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        place = f":{mark.line + 1}:{mark.column + 1}" if mark is not None else ""
        problem = _short(getattr(error, "problem", None) or str(error))
        raise ConfigError(f"{path}{place}: not valid YAML: {problem}") from None


def read_config(path: Path) -> str:
    """Return the text of a configuration file.

    Raises
    ------
    ConfigError
        The file is missing, cannot be read, is too large, or is not text.
    """
    try:
        return read_text(path, LARGEST_FILE_BYTES)
    except FileNotFoundError:
        names = sorted(file.name for file in path.parent.iterdir()) if path.parent.is_dir() else []
        near = difflib.get_close_matches(path.name, names, n=1)
        hint = f" (next to it there is {near[0]})" if near else ""
        if path == SERVICE_AIRFRAME:
            hint = f"; name the airframe file of your vehicle, or choose one: {CHOOSE_AIRFRAME}"
        raise ConfigError(f"{path}: no such file{hint}") from None
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from None


def load(path: Path | str, section: type[SectionT]) -> SectionT:
    """Read the YAML file ``path`` as a ``section``.

    Files that ``section`` names by relative path are read by its own validators, with `load_named`.

    Raises
    ------
    ConfigError
        One line per error, all errors at once.
    """
    path = Path(path)
    return check(path, section, read_yaml(path), {"folder": path.parent, "read": {}})


def check(source: Path | str, section: type[SectionT], content: Any, context: dict[str, Any] | None) -> SectionT:
    """Read plain values as a ``section``.

    Parameters
    ----------
    source
        Their origin, for messages.
    section
        The expected section.
    content
        The values.
    context
        For the validators of ``section``: its file's folder, and files read already.

    Raises
    ------
    ConfigError
        One line per error, all errors at once.
    """
    if not isinstance(content, dict):
        raise ConfigError(
            f"{source}: found {_show(content)}, expected a mapping with the keys {_join(section.model_fields)}"
        )
    lines = [
        f"{source}: {place_of(path)}: found a truth value (true, yes, on, or their opposites); expected a number"
        for path in _truths(content, [section])
    ]
    try:
        found = section.model_validate(content, context=context)
    except ArithmeticError:
        raise ConfigError(f"{source}: found a number in quotes that is too large to calculate with") from None
    except ValidationError as error:
        _refuse_other_kind(source, section, content)
        lines += _explain(source, section, error)
    if lines:
        more = [f"{source}: and {len(lines) - MOST_LINES} more"] if len(lines) > MOST_LINES else []
        raise ConfigError("\n".join([*map(_short, lines[:MOST_LINES]), *more]))
    return found


def _truths(content: Any, choices: list[Any], path: Place = ()) -> Iterator[Place]:
    """Places of truth values where a number is expected, which pydantic takes for 1 and 0."""
    if isinstance(content, bool) and bool not in choices and (int in choices or float in choices):
        yield path
    parts = content.items() if isinstance(content, dict) else enumerate(content) if isinstance(content, list) else ()
    for part, value in parts:
        inner = [member for choice in choices for each in _inside(choice, part) for member in _members(each)]
        yield from _truths(value, inner, (*path, part))


def _refuse_other_kind(source: Path | str, section: type[Section], content: dict[Any, Any]) -> None:
    """Report in one line that a file is of another kind, instead of all its keys."""
    expected = [kind for kind, keys in FILE_KINDS.items() if keys <= section.model_fields.keys()]
    found = [kind for kind, keys in FILE_KINDS.items() if keys <= content.keys() and kind not in expected]
    if expected and found:
        raise ConfigError(f"{source}: found {found[0]}; expected {expected[0]}") from None


def folder_of(info: ValidationInfo) -> Path:
    """The folder of the file that `load` is reading, from which the names in it are taken."""
    return Path((info.context or {}).get("folder", Path()))


def config_path(name: Path | str, kind: str, folder: Path = Path()) -> Path:
    """Find a configuration file by its path, or by its name if it is part of the package.

    Parameters
    ----------
    name
        A path relative to ``folder``; or, if there is no such file, a word without a suffix, such as ``mb1242``.
    kind
        Folder of `SHIPPED` in which names are looked for.
    folder
        Start of a relative path.

    Raises
    ------
    ConfigError
        There is no such file, and the package has none of this name.

    Examples
    --------
    >>> config_path("mb1242", "sensors").name
    'mb1242.yaml'
    """
    path = folder / name
    word = str(name)
    if "/" in word or "." in word or os.path.exists(path):  # unlike Path's, False for a name that is too long
        return path
    known = {file.stem: file for file in (SHIPPED / kind).glob("*.yaml")}
    if word not in known:
        raise ConfigError(
            f"{path}: no such file, and none of this name comes with the package.{suggest(word, known)} "
            f"Known names: {_join(sorted(known))}"
        )
    return known[word]


def load_named(info: ValidationInfo, name: str, kind: str, read: Callable[[Path], ReadT]) -> ReadT:
    """Read a file that is named in the file being read; each one is read only once.

    Raises
    ------
    ConfigError
        Raised by ``read``, or there is no such file, see `config_path`.
    """
    known: dict[Any, Any] = (info.context or {}).get("read", {})
    key = (read, name)
    if key not in known:
        try:
            known[key] = read(config_path(name, kind, folder_of(info)))
        except ConfigError as error:
            known[key] = error
    if isinstance(known[key], ConfigError):
        raise known[key]
    found: ReadT = known[key]
    return found


class _Spot(NamedTuple):
    """The place of an error in a file.

    ``path`` is in readable form, ``choices`` are the types allowed there, ``around`` those that may contain it, and
    ``union`` is the path of the first union on the way whose members cannot be distinguished by anything in the file.
    """

    path: Place
    choices: list[Any]
    around: list[Any]
    union: Place | None


def _explain(path: Path | str, section: type[Section], error: ValidationError) -> Iterator[str]:
    problems = error.errors(include_url=False)[:MOST_PROBLEMS]
    spots = [(_locate(section, problem["loc"]), problem) for problem in problems]
    deepest: dict[Any, int] = {}
    for spot, _ in spots:
        deepest[spot.union] = max(deepest.get(spot.union, 0), len(spot.path))
    lines: dict[tuple[str, str], list[str]] = {}
    places: dict[str, list[str]] = {}
    for spot, problem in spots:
        # The member of a union that the value fits best is probably the intended one.
        if spot.union is not None and len(spot.path) < deepest[spot.union]:
            continue
        cause = problem.get("ctx", {}).get("error")
        if isinstance(cause, ConfigError):
            # The error is in another file, which this one names here.
            places.setdefault(str(cause), []).append(place_of(spot.path))
        else:
            found, expected = _describe(spot, problem)
            place = place_of(spot.path)
            if (discriminator := problem.get("ctx", {}).get("discriminator")) is not None:
                place += f".{discriminator.strip(_QUOTE)}"
            # Checks of the whole file contain the place in their message.
            prefix = f"{path}: {place}: " if place else f"{path}: "
            lines.setdefault((prefix, found), []).append(expected)
    for text, named_at in places.items():
        yield f"{text} (named in {': '.join(filter(None, [str(path), _join(named_at)]))})"
    for (prefix, found), expected_here in lines.items():
        yield f"{prefix}{found}{' or '.join(dict.fromkeys(expected_here))}"


def _describe(spot: _Spot, problem: Any) -> tuple[str, str]:
    """What was found and what was expected."""
    around, kind, context, value = spot.around, problem["type"], problem.get("ctx", {}), problem.get("input")
    if kind == "extra_forbidden":
        keys = _keys(around)
        return "", f"unknown key.{suggest(spot.path[-1], keys)} Known keys here: {_join(keys)}"
    if kind == "missing":
        if isinstance(spot.path[-1], int):
            return "", "this value is missing from the list"
        return "", f"this key is missing; expected {_meaning(around, spot.path[-1])}"
    if kind in ("union_tag_not_found", "union_tag_invalid"):
        key, tag = context["discriminator"].strip(_QUOTE), context.get("tag")
        known = [
            str(tag_value) for section in spot.choices for tag_value in get_args(section.model_fields[key].annotation)
        ]
        if tag is None:
            return "", f"this key is missing; expected one of {_join(known)}"
        return f"found {_show(tag)}; expected one of ", f"{_join(known)}.{suggest(tag, known)}"
    if kind == "value_error":
        text = str(context["error"])
        is_shown = isinstance(value, dict | list) or (isinstance(value, str) and _show(value) in text)
        return "" if is_shown else f"found {_show(value)}; ", text
    expected = problem["msg"].removeprefix("Input should be ")
    if kind in ("model_type", "model_attributes_type"):
        expected = f"a mapping with the keys {_join(_keys(spot.choices))}"
    elif kind in ("list_type", "tuple_type"):
        expected = "a list"
    elif kind == "string_pattern_mismatch":
        expected = f"text that matches {context['pattern']}"
    elif kind == "literal_error":
        options = [str(option) for choice in spot.choices for option in get_args(choice)]
        near = suggest(value, options)
        expected += f".{near}" if near else ""
    return f"found {_show(value)}; expected ", expected


def _locate(section: type[Section], loc: Sequence[int | str]) -> _Spot:
    """Follow pydantic's path through the annotations and leave out the names that it adds for members of unions."""
    path: list[int | str] = []
    around: list[Any] = [section]
    choices = around
    at_union = False
    union: Place | None = None
    for part in loc:
        if at_union:
            named = [choice for choice in choices if part in _literals(choice)]
            if not named and union is None:
                union = tuple(path)
            choices, at_union = named or choices, False
            continue
        path.append(part)
        around = choices
        inner = [annotation for choice in choices for annotation in _inside(choice, part)]
        at_union = any(len(_members(annotation)) > 1 for annotation in inner)
        choices = [member for annotation in inner for member in _members(annotation)]
    return _Spot(tuple(path), choices, around, union)


def _is_section(annotation: Any) -> bool:
    return isinstance(annotation, type) and issubclass(annotation, Section)


def _inside(annotation: Any, part: int | str) -> list[Any]:
    if _is_section(annotation):
        field = annotation.model_fields.get(part)
        return [] if field is None else [field.annotation]
    inside = [argument for argument in get_args(annotation) if argument is not Ellipsis]
    return inside[1:] if get_origin(annotation) is dict else inside


def _members(annotation: Any) -> list[Any]:
    """The members of a union without None, or the annotation itself."""
    if get_origin(annotation) is Annotated:
        return _members(get_args(annotation)[0])
    if get_origin(annotation) in (Union, types.UnionType):
        return [
            member
            for argument in get_args(annotation)
            if argument is not types.NoneType
            for member in _members(argument)
        ]
    return [annotation]


def _literals(annotation: Any) -> set[Any]:
    """Allowed values of a section's literal fields, which distinguish the members of a union."""
    if not _is_section(annotation):
        return set()
    return {
        value
        for field in annotation.model_fields.values()
        if get_origin(field.annotation) is Literal
        for value in get_args(field.annotation)
    }


def _keys(choices: list[Any]) -> list[str]:
    return sorted({name for choice in choices if _is_section(choice) for name in choice.model_fields})


def _meaning(choices: list[Any], key: str) -> str:
    for choice in choices:
        if _is_section(choice) and key in choice.model_fields:
            return descriptions(choice).get(key, "a value").split("\n")[0]
    return "a value"


def suggest(word: Any, known: Iterable[str]) -> str:
    # The search time grows with the square of the word's length, and no name is longer.
    near = difflib.get_close_matches(str(word)[:64], list(known), n=1, cutoff=0.5)
    return f" Did you mean {near[0]!r}?" if near else ""


def place_of(path: Sequence[int | str]) -> str:
    """A place in a file for a person.

    Examples
    --------
    >>> place_of(("sensors", 0, "position_m", 1))
    'sensors[0].position_m[1]'
    """
    text = ""
    for part in path:
        text += f"[{part}]" if isinstance(part, int) else f".{part}"
    return text.lstrip(".")


def with_value(values: Any, place: Sequence[int | str], value: Any) -> Any:
    """A copy of YAML's values with another one at a place; sections on the way that are absent are added.

    An anchor's value is copied for each place that uses it.
    """
    if not place:
        return value
    first, rest = place[0], place[1:]
    if isinstance(first, int):
        return [with_value(each, rest, value) if i == first else each for i, each in enumerate(values)]
    known = dict(values) if isinstance(values, dict) else {}
    known[first] = with_value(known.get(first), rest, value)
    return known


def _join(names: Any) -> str:
    return ", ".join(names)


def _short(line: str) -> str:
    line = printable(line)
    return line if len(line) <= LONGEST_LINE else f"{line[:LONGEST_LINE]}..."


def _show(found: Any) -> str:
    if found is None:
        return "nothing"
    text = repr(found)
    return text if len(text) <= 80 else text[:77] + "..."
