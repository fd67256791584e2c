"""The commands as a person uses them: help that teaches, user errors reported in a line, exit codes."""

import errno
import json
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import typer
from jsonschema import Draft202012Validator

from msp_range import __version__
from msp_range.cli import FILE_KINDS
from msp_range.clock import SystemClock
from msp_range.config import Airframe, load_airframe
from msp_range.extras import EXTRAS
from msp_range.state_folder import SERVICE_AIRFRAME
from msp_range.user_errors import report_user_errors
from msp_range.yaml_loader import load_yaml
from msp_sim.device.bus import EmulatedBus
from msp_sim.device.mb1242 import EmulatedMB1242
from tests.support.programs import PROGRAMS, commands_of, run
from tests.support.shipped import CONFIGS, ROOT

COMMANDS = [f"{program} {name}" for program in PROGRAMS for name in commands_of(program)]


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_explains_itself(command: str) -> None:
    program, name = command.split()
    assert name in run(program, "--help").output
    assert len(run(command, "--help").output.splitlines()) > 6


@pytest.mark.parametrize("program", PROGRAMS)
def test_every_program_says_its_version(program: str) -> None:
    assert run(program, "--version").output.startswith(f"{program} {__version__} (Python 3")


@pytest.mark.parametrize("path", sorted(CONFIGS.glob("*.yaml")), ids=lambda path: path.stem)
def test_check_shows_what_would_fly(path: Path) -> None:
    result = run("msp-range check", path)
    airframe = load_airframe(path)
    for sensor in airframe.sensors:
        number = sensor.address if isinstance(sensor.address, int) else None
        # A port's long name is on several lines.
        assert ("serial:/dev/" if number is None else f"0x{number:02x}") in result.output
    # Air of -4 C where 20 C was taken.
    maximum_m = airframe.maximum_by_sound_m or 0.0
    off_cm = 100 * maximum_m * ((293.15 / 269.63) ** 0.5 - 1)
    of_sound = rf"fixed_c 20 C \+-12 C: up to {off_cm:.0f} cm off at {maximum_m:.2f} m; right for air of -4 to 44 C"
    of_light = "air temperature: no sensor depends on it"
    assert re.search(of_sound if airframe.maximum_by_sound_m else of_light, result.output)


def test_check_says_what_each_thermometer_is_worth() -> None:
    output = run("msp-range check", CONFIGS / "forward_and_down.yaml").output
    assert "SCALED_PRESSURE.temperature +-4.16 C: up to 11 cm off at 7.65 m" in output
    assert "humidity, unless the autopilot sends HYGROMETER_SENSOR: also +-" in output
    assert "no thermometer" not in output
    assert "air: no thermometer" in run("msp-range check", CONFIGS / "loopback.yaml").output


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (["check", "configs/quad_palet.yaml"], "next to it there is quad_pallet.yaml"),
        (["run", "configs/quad_pallet.yaml", "--link", "udp:1"], "--link:"),
        (["scan", "--bus", "/nonexistent/i2c-9"], "no such I2C bus; enable I2C"),
        (["scan", "--bus", "/nonexistent/i2c-9", "--driver", "mb1424"], "--driver"),
        (["address", "0x70", "0x28"], "ignores the address 0x28"),
        (["address", "0x70", "seventy"], "expected a 7-bit address"),
        (["export", "README.md", "out.csv"], "not an MCAP recording"),
        (["layout", "README.md", "out.json"], "not an MCAP recording"),
        (["layout", "README.md", "out.yaml"], "expected .json (Foxglove) or .xml (PlotJuggler)"),
        (["recover", "missing.mcap", "out.mcap"], "cannot be read"),
        (["run", "configs/loopback.yaml", "--record", "x", "--no-record"], "--record and --no-record: give one"),
        (["params", "configs/quad_pallet.yaml", "--out", "no/range.parm"], "no/range.parm: cannot be written: No such"),
        (["params", "configs/quad_pallet.yaml", "--write", "--compare"], "--compare, --write and --restore: give one"),
        (["doctor", "configs/quad_pallet.yaml", "--preflight", "--bench"], "--bench and --preflight: give one"),
        (["params", "configs/quad_pallet.yaml", "--restore", "no.parm"], "no.parm: no such file"),
    ],
)
def test_a_user_error_is_one_line_and_exit_code_3(
    args: list[str], message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(CONFIGS.parent)
    result = run("msp-range", *args, code=3)
    assert message in result.output
    assert "Traceback" not in result.output
    assert len(result.output.strip().splitlines()) == 1


def test_doctor_without_an_airframe_file_says_that_one_has_to_be_named(tmp_path: Path) -> None:
    result = run("msp-range doctor", tmp_path / "airframe.yaml", code=1)
    assert "no such file" in result.output
    assert "-> name your airframe file: msp-range doctor AIRFRAME.yaml" in result.output


@pytest.mark.skipif(SERVICE_AIRFRAME.exists(), reason="this computer has the service's airframe file")
@pytest.mark.parametrize("command", ["run", "check", "params", "sign", "commission", "doctor"])
def test_without_an_airframe_file_the_services_is_meant(command: str) -> None:
    result = run("msp-range", command, code=1 if command == "doctor" else 3)
    expected = f"{SERVICE_AIRFRAME}: no such file; name the airframe file of your vehicle, or choose one: "
    assert expected in " ".join(result.output.split())


def test_a_wrong_command_line_is_exit_code_2() -> None:
    run("msp-range params", CONFIGS / "quad_pallet.yaml", "--port", "10", code=2)
    run("msp-range rnu x.yaml", code=2)


def test_the_schema_describes_every_key() -> None:
    schema = json.loads(run("msp-range schema").output)
    assert set(schema["properties"]) == set(Airframe.model_fields)
    assert all("description" in each for each in schema["properties"].values())
    assert schema["$defs"]["SensorSettings"]["additionalProperties"] is False
    assert "breakaway" in json.loads(run("msp-range schema sensor").output)["properties"]


@pytest.fixture
def kinds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, str]:
    """Kinds of files as pyproject.toml has them, installed: those of this environment may be older."""
    with (ROOT / "pyproject.toml").open("rb") as file:
        entries: dict[str, str] = tomllib.load(file)["project"]["entry-points"][FILE_KINDS]
    metadata = tmp_path / f"msp_range-{__version__}.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text(f"Metadata-Version: 2.1\nName: msp-range\nVersion: {__version__}\n")
    lines = [f"[{FILE_KINDS}]", *(f"{name} = {place}" for name, place in entries.items())]
    (metadata / "entry_points.txt").write_text("\n".join(lines))
    monkeypatch.syspath_prepend(tmp_path)
    return entries


SHIPPED_OF = {
    "airframe": "*.yaml",
    "sensor": "sensors/*.yaml",
    "scenario": "scenarios/*.yaml",
    "campaign": "campaigns/*[!t].yaml",
    "flights": "campaigns/flight.yaml",
}


@pytest.mark.parametrize("kind", SHIPPED_OF)
def test_an_editor_accepts_what_is_shipped_and_marks_a_misspelled_key(kind: str, kinds: dict[str, str]) -> None:
    assert SHIPPED_OF.keys() == kinds.keys()
    validator = Draft202012Validator(json.loads(run("msp-range schema", kind).output))
    files = sorted(CONFIGS.glob(SHIPPED_OF[kind]))
    assert files
    for path in files:
        content = load_yaml(path.read_text())
        assert not [error.message for error in validator.iter_errors(content)], path
        assert "'snesors' was unexpected" in next(validator.iter_errors(content | {"snesors": 1})).message


def test_a_kind_of_file_whose_package_is_missing_is_a_line(
    kinds: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "msp_sim.flight.scenario", None)
    output = run("msp-range schema scenario", code=3).output
    assert output.startswith("the kind of file 'scenario' (msp_sim.flight.scenario:Scenario) cannot be loaded: ")
    assert output.endswith("; install the package that contains it\n")
    assert "expected one of airframe, campaign, flights, scenario, sensor" in run("msp-range schema x", code=2).output


def test_sample_draws_from_the_model(tmp_path: Path) -> None:
    (tmp_path / "where.csv").write_text("true_range_cm,target\n" + "300,grass\n" * 500 + ",grass\n" * 5)
    args = [CONFIGS / "sensors/mb1242.yaml", "--contexts", tmp_path / "where.csv", "--seed", "3"]
    outcomes = []
    for name in ("one.csv", "two.csv"):
        run("msp-sim sample", *args, "--out", tmp_path / name)
        outcomes.append((tmp_path / name).read_text())
    assert outcomes[0] == outcomes[1]
    rows = [line.split(",") for line in outcomes[0].splitlines()]
    readings = [float(row[rows[0].index("reading_cm")]) for row in rows[1:]]
    assert sum(abs(reading - 300) <= 8 for reading in readings[:500]) > 450
    assert sum(reading in (765, 255) for reading in readings[500:]) >= 4


def test_sample_refuses_contexts_in_another_unit(tmp_path: Path) -> None:
    (tmp_path / "where.csv").write_text("true_range_cm,air_temperature_c\n300,293\n")
    args = [CONFIGS / "sensors/mb1242.yaml", "--contexts", tmp_path / "where.csv"]
    result = run("msp-sim sample", *args, "--out", tmp_path / "out.csv", code=3)
    assert "found air_temperature_c of 293 to 293, expected deg C from -50 to 65" in result.output
    assert not (tmp_path / "out.csv").exists()


@pytest.fixture
def sonar(monkeypatch: pytest.MonkeyPatch) -> EmulatedMB1242:
    """One emulated MB1242 at 0x70 on every bus that a command opens."""
    device = EmulatedMB1242(0x70, SystemClock().now, lambda ping_s: 258)

    class Bus(EmulatedBus):
        path = Path("/dev/i2c-1")

        def __init__(self, bus: int | str) -> None:
            super().__init__([device], SystemClock().now)

    monkeypatch.setattr("msp_range.bus.smbus.KernelBus", Bus)
    return device


def test_scan_pings_only_with_its_option(sonar: EmulatedMB1242) -> None:
    assert "0x70" in run("msp-range scan").output
    assert sonar.pings == 0
    assert "258 cm" in run("msp-range scan --ping").output
    # On a busy computer the first answer may be read too late, and it is asked again.
    assert 1 <= sonar.pings <= 2


def test_address_asks_before_it_moves_a_sensor(sonar: EmulatedMB1242) -> None:
    run("msp-range address 0x70 0x72", code=1, input="n\n")
    assert sonar.address == 0x70
    run("msp-range address 0x70 0x72", input="y\n")
    assert sonar.address == 0x72
    run("msp-range address 0x72 0x74 --yes")
    assert sonar.address == 0x74


@pytest.fixture
def short(tmp_path: Path) -> Path:
    """A scenario of four seconds."""
    path = tmp_path / "scenarios" / "short.yaml"
    path.parent.mkdir()
    path.write_text(
        f"name: short\nairframe: {CONFIGS}/quad_pallet.yaml\nduration_s: 4\n"
        "flight: {altitude: [{kind: climb, to_m: 1.0}]}\n"
    )
    return path


def test_export_never_overwrites(short: Path, tmp_path: Path) -> None:
    """Not even the recording itself, by a slip of the keyboard."""
    out = tmp_path / "flight"
    run("msp-sim fly", short, "--out", out)
    before = (out / "flight.mcap").read_bytes()
    result = run("msp-range export", out / "flight.mcap", out / "flight.mcap", code=3)
    assert "there is a file already" in result.output
    assert (out / "flight.mcap").read_bytes() == before


def test_a_folder_that_cannot_be_made_is_a_line(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    out = tmp_path / "file" / "x"
    assert "cannot be created" in run("msp-sim fly sinusoid --out", out, code=3).output


def test_a_folder_that_cannot_be_written_to_is_refused_before_the_flight(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(os, "access", lambda path, mode, **how: not mode & os.W_OK)
    result = run("msp-sim fly hover --out", tmp_path, code=3)
    assert result.output == f"{tmp_path}: no permission to write into this folder; name another one\n"


@pytest.mark.parametrize(
    ("name", "message"), [("flight.doc", "expected .png, .svg, .pdf"), ("there.png", "overwritten")]
)
def test_show_refuses_a_picture_before_it_reads_the_flight(name: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "there.png").touch()
    assert message in run("msp-sim show no.mcap --out", tmp_path / name, code=3).output


def test_a_flight_is_not_replaced_unasked(short: Path, tmp_path: Path) -> None:
    """`make demo` asks for it: it flies into the same folder each time."""
    out = tmp_path / "flight"
    run("msp-sim fly", short, "--out", out)
    before = {path.name: path.read_bytes() for path in out.iterdir()}
    assert set(before) == {"flight.mcap", "link.tlog", "summary.json", "flight.png", "scenario.yaml"}

    result = run("msp-sim fly", short, "--out", out, "--seed", "2", code=3)
    assert f"{out}/flight.mcap: a flight is in this folder already" in result.output
    assert "--force" in result.output
    assert {path.name: path.read_bytes() for path in out.iterdir()} == before

    (out / "scenario.yaml").write_text(before["scenario.yaml"].decode() + "# once more\n")
    run("msp-sim fly", out / "scenario.yaml", "--out", out, "--seed", "2", "--force")
    after = {path.name: path.read_bytes() for path in out.iterdir()}
    assert set(after) == set(before)
    assert all(after[name] != before[name] for name in before)


def test_the_demo_flies_again() -> None:
    makefile = (CONFIGS.parent / "Makefile").read_text()
    (line,) = [each for each in makefile.splitlines() if "msp-sim fly" in each]
    assert "--force" in line


@pytest.mark.parametrize(
    ("missing", "command", "extra"),
    [
        ("scipy", "msp-sim fly scenarios/sinusoid.yaml --out {}", "sim"),
        ("scipy", "msp-sim sitl loopback.yaml --duration 0.5 --link udpout:127.0.0.1:9 --out {}", "sim"),
        ("scipy", "msp-sim sample sensors/mb1242.yaml --contexts none.csv --out {}", "sim"),
        ("matplotlib", "msp-sim show none.mcap --out {}", "sim"),
        ("scipy", "msp-lab collect campaigns/afternoon.yaml --simulate --out {}", "sim"),
        ("jinja2", "msp-lab characterise none.csv --out {}", "lab"),
        ("jinja2", "msp-lab gap none.csv --model sensors/mb1242.yaml --out {}", "lab"),
        ("matplotlib", "msp-lab filters --out {}", "lab"),
        ("filterpy", "msp-range tune none.mcap", "kalman"),
    ],
)
def test_what_draws_or_fits_asks_for_its_extra_before_the_work(
    missing: str, command: str, extra: str, tmp_path: Path
) -> None:
    program, *args = command.format(tmp_path / "out").split()
    code = f"import sys; sys.modules[{missing!r}] = None; from {program.replace('-', '_')}.cli import main; main()"
    done = subprocess.run([sys.executable, "-c", code, *args], capture_output=True, text=True, cwd=CONFIGS, timeout=60)
    assert done.returncode == 3, done.stderr
    install = re.escape(f"{sys.executable} -m pip install 'msp-range[{extra}]'")
    assert re.fullmatch(rf".* needs {missing}: {install}\n", done.stderr)
    assert done.stdout == ""
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "args",
    [
        ["fly", "scenarios/sinusoid.yaml"],
        ["sitl", "loopback.yaml", "--duration", "0.5", "--link", "udpout:127.0.0.1:9"],
    ],
    ids=["fly", "sitl"],
)
def test_without_matplotlib_there_are_numbers_and_no_picture(args: list[str], tmp_path: Path) -> None:
    code = "import sys; sys.modules['matplotlib'] = None; from msp_sim.cli import main; main()"
    command = [sys.executable, "-c", code, *args, "--out", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=CONFIGS, timeout=60)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    # Said before the flight, not after it.
    install = f"{sys.executable} -m pip install 'msp-range[sim]'"
    assert done.stdout.startswith(f"no picture will be drawn without matplotlib: {install}")
    assert json.loads((tmp_path / "summary.json").read_text())["duration_s"] > 0
    assert not (tmp_path / "flight.png").exists()


def test_the_extras_are_those_of_the_packaging() -> None:
    packaging = tomllib.loads((CONFIGS.parent / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    for extra, packages in EXTRAS.items():
        named = {re.split(r"[>\[=]", requirement)[0].replace("-", "_") for requirement in packaging[extra]}
        if "msp_range" in named:
            named |= set(EXTRAS["sim"])
        assert named - {"msp_range"} == set(packages), extra


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.ENAMETOOLONG])
def test_a_full_disk_and_a_name_that_is_too_long_are_a_line(number: int, capsys: pytest.CaptureFixture[str]) -> None:
    def write() -> None:
        raise OSError(number, os.strerror(number), "out/link.tlog")

    with pytest.raises(typer.Exit) as ended:
        report_user_errors(write)()
    assert ended.value.exit_code == 3
    assert capsys.readouterr().err == f"out/link.tlog: {os.strerror(number)}\n"
