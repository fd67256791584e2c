"""Pages of the reference, written from the code: commands, files, tables, recordings, effects and the Python API."""

import json
from collections.abc import Iterator, Mapping
from types import ModuleType
from typing import Any

import typer

import msp_lab
import msp_range
import msp_sim
from msp_lab.campaigns.campaign import Campaign
from msp_lab.campaigns.flights import FlightCampaign
from msp_lab.cli import app as laboratory
from msp_lab.readings.column_map import ColumnMap
from msp_range.cli import app as bridge
from msp_range.config import Airframe
from msp_range.reading_model.sensor_model import SensorModel
from msp_range.recording.columns import BASE_COLUMNS, BRIDGE_COLUMNS, CONTEXT_COLUMNS
from msp_range.recording.topics import RANGE_PREFIX, TOPICS, TRUTH_PREFIX, schema_of
from msp_range.yaml_file import Section
from msp_sim.acoustics.atmosphere import Atmosphere
from msp_sim.acoustics.echo import Target
from msp_sim.acoustics.materials import MATERIALS
from msp_sim.cli import app as simulator
from msp_sim.effects import CATALOGUE
from msp_sim.effects.listing import as_data
from msp_sim.flight.scenario import Scenario
from msp_sim.flight.simulate import SimulatedFlight

FILES: dict[str, tuple[str, type[Section], str]] = {
    "airframe": ("Airframe file", Airframe, "The vehicle: sensors, link, streams. `msp-range schema airframe`."),
    "sensor": ("Sensor model file", SensorModel, "A sensor and how it reads. `msp-range schema sensor`."),
    "scenario": ("Scenario file", Scenario, "A simulated flight, for `msp-sim fly`. `msp-range schema scenario`."),
    "campaign": ("Campaign file", Campaign, "A campaign at the bench, for `msp-lab collect`."),
    "flights": ("Flight campaign file", FlightCampaign, "A campaign of flights, for `msp-lab collect`."),
    "map": ("Column map", ColumnMap, "Where the columns of somebody else's table are, for `--map`."),
}


def pages() -> dict[str, str]:
    """Every page's text by its name."""
    commands = {f"cli-{app.info.name}": _commands(app) for app in (bridge, simulator, laboratory)}
    files = {f"file-{name}": _file(*each) for name, each in FILES.items()}
    tables = {"form-csv": _csv(), "form-mcap": _mcap(), "effects": _effects()}
    tables["surfaces"] = _surfaces()
    tables["python"] = _python(msp_range, msp_sim, msp_lab)
    return {name: "\n\n".join(parts) + "\n" for name, parts in {**commands, **files, **tables}.items()}


def _table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    lines = [head, ("---",) * len(head), *rows]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in lines)


def _text(words: str) -> str:
    """A sentence of a docstring or description, with nothing in it that Markdown would take for its own."""
    return " ".join(words.split()).replace("*", "\\*").replace("<", "&lt;").replace("$", "\\$").replace("[", "\\[")


# Commands


def _commands(app: typer.Typer) -> list[str]:
    program: Any = typer.main.get_command(app)
    name = app.info.name
    context = program.context_class(program, info_name=name)
    parts = [f"# `{name}`: commands and options", _text(program.help)]
    for command in program.commands.values():
        if command.hidden:
            continue
        of_command = command.context_class(command, info_name=command.name, parent=context)
        usage = " ".join(command.get_usage(of_command).split()).removeprefix("Usage: ")
        parts += [f"## {name} {command.name}", f"    {usage}"]
        parts += [_text(each) for each in command.help.split("\n\n")]
        records = [each.get_help_record(of_command) for each in command.get_params(of_command)]
        rows = [(f"`{record[0]}`", _text(record[1])) for record in records if record is not None]
        parts.append(_table(("argument or option", "meaning"), rows))
    return parts


# Files


def _file(title: str, section: type[Section], sentence: str) -> list[str]:
    schema = section.model_json_schema()
    sections = {section.__name__: schema, **schema.get("$defs", {})}
    parts = [f"# {title}", sentence]
    for name, each in sections.items():
        parts += [f"## {name}", _text(each.get("description", ""))]
        if "properties" not in each:
            parts.append(_kind(each))
            continue
        needed = each.get("required", ())
        rows = [
            (f"`{key}`", _kind(what), _default(what, key in needed), _text(what.get("description", "")))
            for key, what in each["properties"].items()
        ]
        parts.append(_table(("key", "value", "default", "meaning"), rows) if rows else "It has no keys.")
    return parts


def _default(what: Mapping[str, Any], is_needed: bool) -> str:
    if is_needed:
        return "required"
    value = what.get("default")
    return "" if value is None or isinstance(value, dict) else f"`{json.dumps(value)}`"


def _kind(what: Mapping[str, Any]) -> str:
    """What a value may be, in words: type, limits, choices, and the section that it is."""
    if "$ref" in what:
        name = what["$ref"].split("/")[-1]
        return f"[{name}](#{name.lower()})"
    for key in ("anyOf", "oneOf", "allOf"):
        if key in what:
            return " or ".join(dict.fromkeys(_kind(each) for each in what[key] if each.get("type") != "null"))
    if "const" in what:
        return f"`{what['const']}`"
    if "enum" in what:
        return ", ".join(f"`{each}`" for each in what["enum"])
    if what.get("type") == "array":
        inside = [_kind(each) for each in what.get("prefixItems", [])] or [_kind(what.get("items", {}))]
        return "list of " + ", ".join(inside)
    if what.get("type") == "object" and isinstance(what.get("additionalProperties"), dict):
        return "name: " + _kind(what["additionalProperties"])
    return " ".join([what.get("type", "any value"), *_limits(what)])


def _limits(what: Mapping[str, Any]) -> Iterator[str]:
    words = {"minimum": "from", "exclusiveMinimum": "above", "maximum": "to", "exclusiveMaximum": "below"}
    for key, word in words.items():
        if key in what:
            yield f"{word} {what[key]:g}"


# Tables and recordings


def _csv() -> list[str]:
    groups = {
        "Readings": (BASE_COLUMNS, "Every table has `reading_cm`; the others where they are known."),
        "Context": (CONTEXT_COLUMNS, "What effects depend on. Any other column is context of your own."),
        "What the bridge made of it": (BRIDGE_COLUMNS, "Written by `msp-range export`."),
    }
    parts = ["# CSV form", "The columns of a table of readings, one row a reading, a header first."]
    for title, (columns, sentence) in groups.items():
        rows = [(f"`{name}`", _text(meaning)) for name, meaning in columns.items()]
        parts += [f"## {title}", sentence, _table(("column", "content"), rows)]
    return parts


def _mcap() -> list[str]:
    topics = [f"{each}<sensor>" for each in (RANGE_PREFIX, TRUTH_PREFIX)]
    topics += [each for each in TOPICS if not each.endswith("/")]
    parts = [
        "# MCAP form",
        "A recording holds JSON messages on these topics, each with its JSON Schema. An absent key is unknown.",
    ]
    for topic in topics:
        schema = json.loads(schema_of(topic)[1])
        rows = [
            (f"`{key}`", each.get("type", ""), _text(each.get("description", "")))
            for key, each in schema["properties"].items()
        ]
        title = _text(topic)
        parts += [f"## {title}", _text(schema["description"]), _table(("key", "type", "content"), rows)]
    return parts


# Effects


def _effects() -> list[str]:
    parts = [
        "# Effects",
        "What a sensor model file may name under `effects:`, as `msp-lab effects` prints it: physical causes with "
        "bounded parameters. [How to add one of your own](../extending.md#a-new-effect).",
    ]
    for effect in as_data(CATALOGUE):
        requires = [*effect["requires"], *([f"{effect['per']} (one of them)"] if effect["per"] else [])]
        changes = ", ".join(effect["channels"])
        parts += [
            f"## {effect['name']}",
            _text(effect["sentence"]),
            f"- Physics: {_text(effect['physics'])}",
            f"- Source: {_text(effect['source'])}",
            f"- Changes: {changes}. Requires: {_text(', '.join(requires)) or 'nothing'}.",
            f"- Experiment that shows it alone: {_text(effect['experiment'])}.",
        ]
        if effect["equivalent_causes"]:
            parts.append(f"- Equivalent causes: {_text(', '.join(effect['equivalent_causes']))}.")
        rows = [
            (
                f"`{name}`",
                each["unit"],
                f"{each['low']:g} to {each['high']:g}",
                _number(each["neutral"]),
                _number(each["default"]),
                _text(each["meaning"]),
            )
            for name, each in effect["parameters"].items()
        ]
        if rows:
            parts.append(_table(("parameter", "unit", "bounds", "no effect at", "default", "meaning"), rows))
    return parts


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:g}"


# Surfaces


def _surfaces() -> list[str]:
    rows = [
        (
            f"`{name}`",
            f"{each.impedance_rayl:.3g}",
            f"{Target(each.impedance_rayl).reflection_db(Atmosphere()):.2g}",
            _text(f"{each.source}. Uncertainty: {each.doubt}"),
            f"{each.rms_m:g}",
            f"{each.length_m:g}" if each.rms_m else "",
            _text(each.roughness_source),
        )
        for name, each in MATERIALS.items()
    ]
    head = ("surface", "impedance [rayl]", "echo [dB]", "source", "rms [m]", "length [m]", "source of the roughness")
    return [
        "# Surfaces",
        "What is known of surfaces by name. Echo: its level relative to that of a perfect mirror, in air of 20 C. "
        "[How scenarios name them](../simulating.md#surfaces).",
        _table(head, rows),
    ]


# Python


def _python(*packages: ModuleType) -> list[str]:
    parts = [
        "# Python API",
        "What programs and notebooks import: `dir` of a package lists it, and the first use imports it. Other modules "
        "may change from version to version. [How it is used](../notebooks.md).",
    ]
    for package in packages:
        parts += [f"## `{package.__name__}`", _text((package.__doc__ or "").split("\n")[0])]
        parts += [_documented(getattr(package, name)) for name in package.__all__]
    return [*parts, "## What they return", _documented(SimulatedFlight)]


def _documented(what: Any) -> str:
    """Sphinx writes signature and docstring here."""
    kind, members = ("autoclass", ("   :members:",)) if isinstance(what, type) else ("autofunction", ())
    return "\n".join(["```{eval-rst}", f".. {kind}:: {what.__module__}.{what.__qualname__}", *members, "```"])
