"""YAML: configuration files of every kind, changed in their bytes, their words and their structure."""

import contextlib
import io
import shutil
from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import Any

import typer
import yaml

from evaluation.fuzz import base, mutate
from msp_lab.campaigns.campaign import load_campaign
from msp_lab.campaigns.flights import is_of_flights, load_flights
from msp_lab.campaigns.plan import make_plan
from msp_lab.readings.column_map import ColumnMap
from msp_range import cli
from msp_range.input_file import CONTROL
from msp_range.reading_model.sensor_model import load_sensor_model
from msp_range.yaml_file import ConfigError, load
from msp_sim.flight.scenario import load_scenario
from msp_sim.model.model import load_model

CONFIGS = Path("configs")
LONGEST_MESSAGE = 25_000
"""Characters of all lines that are reported of one file: 20 lines of 1000 at most, and their places."""


def fuzz(seconds: float, seed: int) -> base.FuzzResult:
    """Read changed configuration files for so long [s]."""
    files = {kind: [path.read_text() for path in sorted(paths())] for kind, paths in _FILES.items()}
    return base.run("yaml", seconds, seed, lambda rng: _case(files, rng), prepare)


_FILES: dict[str, Callable[[], Any]] = {
    "airframe": lambda: CONFIGS.glob("*.yaml"),
    "sensor": lambda: (CONFIGS / "sensors").glob("*.yaml"),
    "named": lambda: (CONFIGS / "sensors").glob("mb12*.yaml"),
    "scenario": lambda: (CONFIGS / "scenarios").glob("*.yaml"),
    "campaign": lambda: (CONFIGS / "campaigns").glob("*.yaml"),
    "map": lambda: (CONFIGS / "maps").glob("*.yaml"),
}
"""Kind of a file -> those of the project, from which cases are made. named: a sensor model that an airframe names."""


def prepare(folder: Path) -> base.Check:
    """The check: read a case as its kind; only a ConfigError in plain lines may come of it."""
    configs = folder / "configs"
    shutil.copytree(CONFIGS, configs)
    airframe = (configs / "quad_pallet.yaml").read_text().replace("sensors/mb1242.yaml", "sensors/fuzzed.yaml")
    (configs / "naming.yaml").write_text(airframe)

    def check(data: bytes) -> None:
        kind, _, content = data.partition(b"\n")
        subfolder = {"airframe": "", "map": "maps", "named": "sensors"}.get(kind.decode(), f"{kind.decode()}s")
        path = configs / subfolder / "fuzzed.yaml"
        path.write_bytes(content)
        try:
            _READ[kind.decode()](path)
        except ConfigError as error:
            base.check_message(str(error), folder, LONGEST_MESSAGE)

    for kind, paths in _FILES.items():
        for path in paths():
            check(kind.encode() + b"\n" + path.read_bytes())
    return check


def _check_airframe(path: Path) -> None:
    out = io.StringIO()
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(out):
            cli.check(path)
    except typer.Exit:
        base.check_message(out.getvalue(), path.parent, LONGEST_MESSAGE)
    else:
        assert CONTROL.search(out.getvalue()) is None, "a control character is printed"


def _read_sensor(path: Path) -> None:
    assert load_sensor_model(path).beam is not None
    load_model(path)


def _read_campaign(path: Path) -> None:
    if is_of_flights(path):
        load_flights(path)
    else:
        make_plan(load_campaign(path))


_READ: dict[str, Callable[[Path], Any]] = {
    "airframe": _check_airframe,
    "sensor": _read_sensor,
    "named": lambda path: _check_airframe(path.parent.parent / "naming.yaml"),
    "scenario": load_scenario,
    "campaign": _read_campaign,
    "map": lambda path: load(path, ColumnMap),
}


def _case(files: dict[str, list[str]], rng: Random) -> bytes:
    kind = rng.choice(list(files))
    text = rng.choice(files[kind])
    how = rng.randrange(10)
    if how < 2:
        content = mutate.of_bytes(text.encode(), rng)
    elif how < 5:
        content = mutate.encoded(_in_words(text, rng), rng)
    elif how < 9:
        content = mutate.encoded(_in_structure(text, rng), rng)
    else:
        content = mutate.encoded(_crafted(text, rng), rng)
    return kind.encode() + b"\n" + content


def _in_words(text: str, rng: Random) -> str:
    """Some values replaced in the text, so that they are not quoted."""
    lines = text.split("\n")
    for _ in range(rng.choice((1, 1, 2, 5))):
        at = rng.randrange(len(lines))
        key, colon, _ = lines[at].partition(": ")
        value = mutate.pick(rng, mutate.NUMBERS, mutate.WORDS, _SNIPPETS)
        lines[at] = f"{key}{colon}{value}" if colon and rng.random() < 0.8 else value + lines[at]
    return "\n".join(lines)


_SNIPPETS = (
    *("[1, [2", "{a: }", "{? [1]: 2}", "{[a]: b}", "*a", "&a [*a]", "&a {b: *a}", "<<: *a", "{<<: 5}", "&x 5", "- - -"),
    *("!!python/object:os.system x", "!!int x", "!!binary '='", "!!set {a, b}", "!!timestamp x", "!<tag:a,b:int> 7"),
    *("? a", "|\n  x", ">-\n  x", "'\\", '"\\u0000"', '"\\e[31m"', '"\\ud800"', '"\\U0010ffff"', "%YAML 9.9", "..."),
    *("--- a\n--- b", "@", "`", "\t- a", "a: b: c", "[[0,0],[0,0]]", "{first: 0, last: 1e9, step: 1e-9}", "[.nan]"),
    *("{first: 1, last: 2, step: 0}", "{first: 0, last: 1e-300, step: 1e-308}", "{value: .inf}"),
)


def _in_structure(text: str, rng: Random) -> str:
    """Values of the parsed file replaced, moved, multiplied, keys renamed; written again."""
    content = yaml.safe_load(text)
    for _ in range(rng.choice((1, 1, 2, 4))):
        holder, key = _somewhere(content, rng)
        if not holder:
            break
        how = rng.randrange(6)
        if how == 0 and isinstance(holder, list) and holder:
            holder[:] = holder * rng.choice((2, 5, 300))
        elif how == 1 and isinstance(holder, dict):
            name = mutate.pick(rng, mutate.WORDS, list(map(str, holder)))
            holder[name] = holder.pop(key)
        elif how == 2:
            holder[key] = [holder[key]] * rng.choice((1, 3, 1000))
        elif how == 3:
            holder[key] = {mutate.pick(rng, mutate.WORDS, ["value"]): holder[key]}
        else:
            holder[key] = _value(rng)
    is_unicode = rng.random() < 0.5
    text = yaml.dump(
        content, Dumper=yaml.CSafeDumper, allow_unicode=is_unicode, sort_keys=False, default_flow_style=None
    )
    assert isinstance(text, str)
    return text


def _somewhere(content: Any, rng: Random) -> tuple[Any, Any]:
    """A mapping or list in the content, and one of its keys or indices."""
    holder: Any = None
    key: Any = None
    while isinstance(content, dict | list) and content:
        holder = content
        key = rng.choice(list(holder)) if isinstance(holder, dict) else rng.randrange(len(holder))
        content = holder[key]
        if rng.random() < 0.25:
            break
    return holder, key


def _value(rng: Random) -> Any:
    numbers = (
        0,
        -1,
        1,
        2,
        0.5,
        1e-9,
        1e9,
        1e30,
        1e308,
        -1e308,
        2**31,
        2**63,
        2**64,
        10**25,
        float("nan"),
        float("inf"),
    )
    others: tuple[Any, ...] = (None, True, [], {}, [[]], "", [1, "a", None], {"a": 1}, list(range(50)))
    return rng.choice((rng.choice(numbers), rng.choice(others), mutate.pick(rng, mutate.NUMBERS, mutate.WORDS)))


def _crafted(text: str, rng: Random) -> str:
    """What is made to cost much: nesting, aliases, size."""
    count = rng.choice((10, 33, 1000, 100_000))
    opening = rng.choice(("[", "{a: ", "- ", "? ", "[a, ", "&a ", "!x ", "a:\n  ", '"'))
    laughs = ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
    laughs += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, rng.choice((3, 6, 12, 60)))]
    merges = ["m0: &m0 {a: 1, b: 2, c: 3}"]
    merges += [f"m{i}: &m{i} {{<<: [{', '.join([f'*m{i - 1}'] * 9)}]}}" for i in range(1, rng.choice((3, 6, 12)))]
    return rng.choice(
        (
            opening * count,
            f"{text}\nmore: {opening * count}",
            "\n".join(laughs) + "\n" + text,
            text + "\nsensors: &s [*s, *s]\n",
            "\n".join(merges) + "\n" + text,
            "\n".join(f"k{i}: {i}" for i in range(count)),
            "sensors: [" + "{name: a}, " * min(count, 5000) + "]",
            "vehicle: " + "x" * count * 12,
            "# " + "x" * count * 12 + "\n" + text,
            "vehicle: |\n" + "  line\n" * count,
            f"vehicle: {'9' * count}",
            f"vehicle: 0x{'f' * count}",
            f"vehicle: 1.{'0' * count}e+9",
            "{" + ", ".join(f"&a{i} k{i}: *a{i}" for i in range(min(count, 5000))) + "}",
            "<<: {a: 1}\n" + text,
            "",
            "\n" * count,
            rng.randbytes(count).decode("latin-1"),
        )
    )
