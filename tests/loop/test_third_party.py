"""A package of somebody else's with an effect, a filter, a sensor and a log format: installed, flown, and used by the
laboratory."""

import json
import os
import subprocess
import sys
from pathlib import Path
from shutil import copytree

import numpy as np
import pytest

from msp_range.recording.csv_form import read_csv, write_csv

HERE = Path(__file__).parents[1] / "third_party"
EFFECT = HERE / "package" / "sonar_extras" / "supply_sag.py"
MODEL = HERE.parents[1] / "configs" / "sensors" / "mb1242.yaml"


class Installed:
    """A folder with the package and its configuration files, and the commands with it on their path."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        copytree(HERE, folder / "source")
        pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-index", "--no-deps", "--no-build-isolation"]
        subprocess.run([*pip, "--target", folder / "site", folder / "source" / "package"], check=True, timeout=120.0)
        self.configs = folder / "source"

    def run(self, *arguments: object, code: int = 0, without: bool = False) -> str:
        """Run a command, with the package or without, and return all that it printed."""
        command, *rest = [str(each) for each in arguments]
        path = [] if without else [str(self.folder / "site")]
        path += filter(None, [os.environ.get("PYTHONPATH")])
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(path)}
        done = subprocess.run(
            [Path(sys.executable).parent / command, *rest],
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            timeout=120.0,
        )
        assert done.returncode == code, done.stdout
        return done.stdout


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Installed:
    return Installed(tmp_path_factory.mktemp("third_party"))


@pytest.mark.slow
def test_its_sensor_flies_with_its_filter_and_its_effect(installed: Installed) -> None:
    out = installed.folder / "flight"
    installed.run("msp-sim", "fly", installed.configs / "flight.yaml", "--out", out)
    errors = json.loads((out / "summary.json").read_text())["sensors"]["down"]
    # At 3 m and half throttle a clock that is 10 % slow at full throttle reads 15 cm short; 1 cm of noise is smoothed.
    assert errors["error_before"]["bias_cm"] == pytest.approx(-14.0, abs=2.0)
    assert errors["error_after"]["rms_cm"] < 0.95 * errors["error_before"]["rms_cm"]
    replayed = installed.run("msp-range", "replay", out / "flight.mcap")
    assert f"{errors['error_after']['count']}" in replayed
    table = out / "readings.csv"
    installed.run("msp-range", "export", out / "flight.mcap", table)
    off_cm = read_csv(table)["reading_cm"] - read_csv(table)["true_range_cm"]
    assert np.nanmedian(off_cm) == pytest.approx(-14.0, abs=2.0)


def test_its_logs_are_imported(installed: Installed) -> None:
    time_s = 0.1 * np.arange(300.0)
    height_m = 2.0 + np.sin(time_s)
    path = installed.folder / "flight.log"
    lines = (f"{t} {round(h, 2)} {h}" for t, h in zip(time_s, height_m, strict=True))
    path.write_text("\n".join(["PILOT 1", *lines]))
    shown = installed.run("msp-lab", "import", path, "--out", installed.folder / "logs")
    assert "flight.log: log of the pilot's box" in shown
    assert "true range: mocap (box.height)" in shown
    unknown = installed.run("msp-lab", "import", path, "--out", installed.folder / "logs", code=3, without=True)
    assert "no log that is known" in unknown


def test_without_the_package_its_names_are_not_known(installed: Installed) -> None:
    shown = installed.run("msp-sim", "fly", installed.configs / "flight.yaml", code=3, without=True)
    assert "driver: found 'acme'; expected 'mb1242', " in shown
    assert "filters[0].filter: found 'low_pass'; expected one of moving_average" in shown


@pytest.mark.slow
def test_user_errors_in_the_parameters_of_its_filter_are_named(installed: Installed) -> None:
    airframe = installed.configs / "airframe.yaml"
    wrong = airframe.with_name("wrong.yaml")
    wrong.write_text(airframe.read_text().replace("time_constant_s", "time_constant"))
    shown = installed.run("msp-range", "check", wrong, code=3)
    assert "filter 'low_pass': time_constant: unknown key. Did you mean 'time_constant_s'?" in shown
    assert "wrong.yaml: filters[0])" in shown
    wrong.write_text(airframe.read_text().replace("low_pass", "low_pas"))
    assert "filters[0]: filter: found 'low_pas'; expected one of " in installed.run("msp-range", "check", wrong, code=3)


@pytest.mark.slow
def test_the_schema_and_the_catalogue_list_what_it_brings(installed: Installed) -> None:
    schema = json.loads(installed.run("msp-range", "schema", "airframe"))
    filters = schema["properties"]["filters"]["items"]["oneOf"]
    assert [each["properties"]["filter"]["const"] for each in filters if "properties" in each] == ["low_pass"]
    assert "acme" in installed.run("msp-range", "schema", "sensor")
    assert "supply_sag (bias)" in installed.run("msp-lab", "effects")
    assert "supply_sag" not in installed.run("msp-lab", "effects", without=True)


@pytest.mark.slow
def test_an_effect_of_a_file_is_sampled_and_found_again(installed: Installed) -> None:
    """The package is not installed here: the effect comes from its file alone."""
    folder = installed.folder
    rng = np.random.default_rng(1)
    n = 2400
    columns = {"time_s": 0.1 * np.arange(n), "sensor": np.full(n, "down"), "run": (np.arange(n) // 300).astype(str)}
    ranges = {"true_range_cm": rng.uniform(40.0, 500.0, n).round(1), "throttle": rng.uniform(0.0, 1.0, n).round(3)}
    write_csv(folder / "contexts.csv", {**columns, **ranges})
    model = folder / "sag.yaml"
    text = MODEL.read_text()
    start = text.index("effects:")
    model.write_text(text[:start] + "effects: [{name: supply_sag, parameters: {sag_pct: 2}}]\n")
    own, contexts, readings = ("--effects", EFFECT), folder / "contexts.csv", folder / "readings.csv"
    sample = ("msp-sim", "sample", model, "--contexts", contexts, "--out", readings)
    assert "or one of your own file: --effects FILE.py" in installed.run(*sample, code=3, without=True)
    installed.run(*sample, *own, without=True)
    out = folder / "gap"
    installed.run("msp-lab", "gap", readings, "--model", MODEL, "--out", out, "--until", "add", *own, without=True)
    named = json.loads((out / "gap.json").read_text())["effects"]
    assert [each["name"] for each in named if each["verdict"] == "named"] == ["supply_sag"]
    installed.run("msp-lab", "show", out, *own, without=True)
    fly = ("msp-sim", "fly", "hover", "--model", out / "model.yaml")
    installed.run(*fly, *own, without=True)
    assert "supply_sag" in installed.run(*fly, code=3, without=True)
