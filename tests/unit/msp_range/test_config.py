"""Airframe files: the shipped ones, and what is reported of a user error: file, place, found, expected, nearest."""

import copy
import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from msp_range import yaml_file
from msp_range.config import Airframe, RotationDeg, load_airframe
from msp_range.filters.table import BUILT_IN
from msp_range.mavlink.orientation import CUSTOM, DOWN
from msp_range.reading_model.sensor_model import SensorModel, load_sensor_model
from msp_range.yaml_file import ConfigError, Section
from msp_sim.flight.scenario import load_scenario
from tests.support.shipped import CONFIGS

AIRFRAMES = sorted(CONFIGS.glob("*.yaml"))
SENSORS = sorted(CONFIGS.glob("sensors/*.yaml"))
SCENARIOS = sorted(CONFIGS.glob("scenarios/*.yaml"))
MODEL = str(CONFIGS / "sensors" / "mb1242.yaml")
QUAD: dict[str, Any] = yaml.safe_load((CONFIGS / "quad_pallet.yaml").read_text(encoding="utf-8"))
for _sensor in QUAD["sensors"]:
    _sensor["model"] = MODEL

Change = Callable[[dict[str, Any]], object]


def named(paths: list[Path]) -> pytest.MarkDecorator:
    return pytest.mark.parametrize("path", paths, ids=lambda path: path.stem)


def write(folder: Path, change: Change) -> Path:
    """The quad pallet's file with a change made to its content."""
    content = copy.deepcopy(QUAD)
    change(content)
    path = folder / "airframe.yaml"
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    return path


def errors_of(folder: Path, change: Change) -> list[str]:
    """The lines of the error, without the file's name in front."""
    path = write(folder, change)
    with pytest.raises(ConfigError) as error:
        load_airframe(path)
    lines = str(error.value).split("\n")
    assert all(str(path) in line for line in lines)
    return [line.removeprefix(f"{path}: ") for line in lines]


@named(AIRFRAMES)
def test_every_airframe_loads(path: Path) -> None:
    vehicle = load_airframe(path)
    assert vehicle.sensors


@named(SENSORS)
def test_every_sensor_model_loads(path: Path) -> None:
    load_sensor_model(path)


@named(SCENARIOS)
def test_every_scenario_loads(path: Path) -> None:
    load_scenario(path)


def test_there_is_an_airframe_of_each_kind() -> None:
    sets = {path.stem: sorted(sensor.orientation.name for sensor in load_airframe(path).sensors) for path in AIRFRAMES}
    assert {"quad_pallet", "canted_pallet", "forward_and_down", "loopback", "proximity"} <= set(sets)
    assert sets["quad_pallet"] == ["down"] * 4
    assert sets["forward_and_down"] == ["down"] * 3 + ["forward"]
    assert sets["proximity"] == ["forward", "left", "rear", "right"]
    canted = load_airframe(CONFIGS / "canted_pallet.yaml")
    assert [math.degrees(sensor.tilt_from_down_rad) for sensor in canted.sensors] == pytest.approx([10] * 4)


def test_a_command_line_may_name_another_link_and_autopilot() -> None:
    airframe = load_airframe(CONFIGS / "loopback.yaml")
    changed = airframe.changed(link="udpin:127.0.0.1:14540", autopilot="px4")
    assert (changed.link.url, changed.link.autopilot) == ("udpin:127.0.0.1:14540", "px4")
    assert changed.link.component_id == airframe.link.component_id
    assert airframe.changed(autopilot="px4").link.url == airframe.link.url


def test_what_is_left_out() -> None:
    content = {key: QUAD[key] for key in ("vehicle", "sensors", "link", "send")}
    vehicle = Airframe.model_validate(content)
    assert (vehicle.bus, vehicle.temperature.fixed_c, vehicle.recording) == (1, 20.0, None)
    assert (vehicle.polling.groups, vehicle.polling.near, vehicle.polling.adaptive) == (None, None, True)
    assert [each.filter for each in vehicle.filters] == ["changepoint"]
    assert [sensor.name for sensor in vehicle.downward] == [sensor["name"] for sensor in QUAD["sensors"]]
    assert vehicle.sent_names == []
    assert RotationDeg().radians == (0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        # An unknown key, wherever it is.
        (lambda c: c.update(sensor=[]), "sensor: unknown key. Did you mean 'sensors'? Known keys here: bus, filters, "),
        (lambda c: c["sensors"][2].update(adress=1), "sensors[2].adress: unknown key. Did you mean 'address'?"),
        (lambda c: c["sensors"][0]["rotation_deg"].update(pich=1), "sensors[0].rotation_deg.pich: unknown key. Did"),
        (lambda c: c["filters"][0].update(modle=1), "filters[0].modle: unknown key. Did you mean 'model'? Known keys"),
        (lambda c: c["temperature"]["sources"][0].update(paht=1), "temperature.sources[0].paht: unknown key. Did you"),
        (lambda c: c.update(qqq=1), "qqq: unknown key. Known keys here: "),
        # A missing one.
        (lambda c: c.pop("link"), "link: this key is missing; expected the connection to the autopilot"),
        (lambda c: c["sensors"][1].pop("address"), "sensors[1].address: this key is missing; expected 7-bit I2C"),
        (
            lambda c: c["filters"][0].pop("filter"),
            f"filters[0].filter: this key is missing; expected one of {', '.join(BUILT_IN)}",
        ),
        (lambda c: c["sensors"][0].update(position_m=[0, 0]), "sensors[0].position_m[2]: this value is missing"),
        # A wrong type.
        (lambda c: c.update(vehicle=7), "vehicle: found 7; expected a valid string"),
        (lambda c: c.update(bus=1.5), "bus: found 1.5; expected a valid integer, got a number with a fractional part"),
        (lambda c: c.update(bus=None), "bus: found nothing; expected a valid integer or a valid string"),
        (lambda c: c.update(bus=-1), "bus: found -1; expected greater than or equal to 0"),
        (lambda c: c.update(bus="190:20:30"), "bus: found '190:20:30'; expected a valid integer"),
        (lambda c: c.update(bus=True), "bus: found a truth value (true, yes, on, or their opposites); expected a numb"),
        (lambda c: c["sensors"][1].update(position_m=[0, False, 0]), "sensors[1].position_m[1]: found a truth value"),
        (lambda c: c["filters"][0].update(acceleration_std_m_s2=True), "filters[0].acceleration_std_m_s2: found a tru"),
        (lambda c: c["link"].update(system_id=True), "link.system_id: found a truth value"),
        (lambda c: c.update(sensors="four"), "sensors: found 'four'; expected a list"),
        (lambda c: c.update(polling=[]), "polling: found []; expected a mapping with the keys adaptive, groups, near"),
        (lambda c: c.update(filters=["kalman"]), "filters[0]: found 'kalman'; expected a mapping with the keys"),
        (
            lambda c: c["sensors"][1].update(position_m=[0, 60, 0]),
            "sensors[1].position_m[1]: found 60; expected metres, at most 50: is it written in centimetres or milli",
        ),
        (
            lambda c: c["send"]["fused"].update(reference_down_m=-120),
            "send.fused.reference_down_m: found -120; expected m",
        ),
        (lambda c: c["sensors"][3].update(position_m=[0, 0, "x"]), "sensors[3].position_m[2]: found 'x'; expected a v"),
        (lambda c: c["send"].update(sensors="none"), "send.sensors: found 'none'; expected a list or 'all'"),
        (lambda c: c["send"].update(sensors=["Front"]), "send.sensors[0]: found 'Front'; expected text that matches"),
        # An impossible value.
        (lambda c: c["sensors"][0].update(address=0x78), "sensors[0].address: found 120; expected less than or equal"),
        (
            lambda c: c["sensors"][0].update(address=0x28),
            "sensors[0]: an MB1242 cannot have the address 0x28; choose another one",
        ),
        (lambda c: c["sensors"][0].update(id=0), "sensors[0].id: found 0; expected greater than or equal to 1"),
        (
            lambda c: c["polling"].update(ping_interval_s=math.nan),
            "polling.ping_interval_s: found nan; expected a finite",
        ),
        (
            lambda c: c["filters"][0].update(model="const"),
            "filters[0].model: found 'const'; expected 'constant' or 'con",
        ),
        (
            lambda c: c["link"].update(autopilot="ardupilto"),
            "link.autopilot: found 'ardupilto'; expected 'ardupilot' or 'px4'. Did you mean 'ardupilot'?",
        ),
        (lambda c: c["link"].update(component_id=1), "link.component_id: found 1; expected greater than or equal to 2"),
        (
            lambda c: c["link"].update(url="udp:1.2.3.4:5"),
            "link.url: link 'udp:1.2.3.4:5': found",
        ),
        (
            lambda c: c["filters"][0].update(filter="kalmn"),
            f"filters[0].filter: found 'kalmn'; expected one of {', '.join(BUILT_IN)}. Did you mean 'kalman'?",
        ),
        (
            lambda c: c["temperature"]["sources"][0].update(source="files"),
            "temperature.sources[0].source: found 'files'; expected one of file, mavlink. Did you mean 'file'?",
        ),
        (
            lambda c: c["temperature"].update(sources=[{"source": "mavlink", "message": "RAW_IMU"}]),
            "temperature.sources[0]: no air temperature in RAW_IMU.temperature; known: SCALED_PRESSURE.temperature, ",
        ),
        # What only several keys together show.
        (lambda c: c["sensors"][1].update(address=0x70), "sensors: address 0x70 is given more than once; each needs"),
        (lambda c: c["sensors"][1].update(id=1), "sensors and send.fused: id 1 is given more than once"),
        (lambda c: c["send"]["fused"].update(id=3), "sensors and send.fused: id 3 is given more than once"),
        (lambda c: c["sensors"][1].update(name="front_left"), "sensors: name front_left is given more than once"),
        (
            lambda c: c["send"].update(sensors=["nose"]),
            "send.sensors: no sensor is named 'nose'; the sensors are front",
        ),
        (lambda c: c["send"]["fused"].update(sensors=["nose"]), "send.fused.sensors: no sensor is named 'nose'"),
        (lambda c: c.update(send={}), "send: no stream is given; give fused, sensors or both. To send none of t"),
        (lambda c: c.update(send={"nothing": True}), "send: no stream is given; give fused, sensors or both"),
        (
            lambda c: c.update(send="none"),
            "send: found 'none'; expected a mapping with fused, sensors or both, or the w",
        ),
        (lambda c: c.update(send=False), "send: found False; expected a mapping with the keys fused, nothing, sensors"),
        (lambda c: c["send"].update(nothing="maybe"), "send.nothing: found 'maybe'; expected a valid boolean"),
        (lambda c: c["polling"].update(groups=[["front_left"]]), "polling.groups: every sensor in one group, no group"),
        (lambda c: c["polling"].update(groups=[["nose"]]), "polling.groups: no sensor is named 'nose'"),
        (
            lambda c: c["polling"].update(groups=[[each["name"] for each in c["sensors"]], ["front_left"]]),
            "polling.groups: sensor front_left is given more than once",
        ),
        (
            lambda c: c["polling"].update(groups=[[each["name"] for each in c["sensors"]], []]),
            "polling.groups: every sensor in one group, no group empty",
        ),
        (
            lambda c: [each["rotation_deg"].update(pitch=0) for each in c["sensors"]],
            "send.fused: no sensor looks down (pitch -90 does)",
        ),
        (
            lambda c: (
                c["sensors"][0]["rotation_deg"].update(pitch=-40),
                c["send"]["fused"].update(sensors=["front_left"]),
            ),
            "send.fused.sensors: front_left looks 50 deg away from straight down; at most 45",
        ),
    ],
)
def test_a_user_error_is_explained(tmp_path: Path, change: Change, expected: str) -> None:
    (line,) = errors_of(tmp_path, change)
    assert line.startswith(expected)


def test_a_kalman_filter_asks_for_its_package_where_it_would_be_used(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Before the flight. The fused stream has a filter of its own."""
    single: dict[str, Any] = {"sensors": ["front_left"]}
    load_airframe(write(tmp_path, lambda content: content.update(send=single)))
    monkeypatch.setitem(sys.modules, "filterpy", None)
    load_airframe(write(tmp_path, lambda content: None))
    (line,) = errors_of(tmp_path, lambda content: content.update(send=single))
    assert f"filters: kalman requires filterpy: {sys.executable} -m pip install 'msp-range[kalman]'" in line


def test_nothing_is_short_for_the_usual_stream_that_is_not_sent(tmp_path: Path) -> None:
    short = load_airframe(write(tmp_path, lambda content: content.update(send="nothing")))
    long = load_airframe(write(tmp_path, lambda content: content.update(send={"nothing": True, "fused": {}})))
    assert short.model_dump() == long.model_dump()
    assert (short.send.nothing, len(short.downward)) == (True, 4)
    kept = load_airframe(write(tmp_path, lambda content: content["send"].update(nothing=True)))
    assert kept.reference_down_m == QUAD["send"]["fused"]["reference_down_m"] != 0.0
    whole = Airframe.model_json_schema()
    for value, is_accepted in (("nothing", True), ({"nothing": True, "fused": {}}, True), ("none", False)):
        assert (accepts(whole["properties"]["send"], value, whole, "send") == []) is is_accepted


def test_a_vehicle_that_looks_elsewhere_names_what_it_tries(tmp_path: Path) -> None:
    def forward(send: Any) -> Change:
        def change(content: dict[str, Any]) -> None:
            content.update(send=send, filters=[])
            for number, each in enumerate(content["sensors"]):
                each["rotation_deg"] = {"yaw": 90 * number}

        return change

    (line,) = errors_of(tmp_path, forward("nothing"))
    assert line.endswith("requires one; send: {nothing: true, sensors: all} tries those that look elsewhere")
    assert len(load_airframe(write(tmp_path, forward({"nothing": True, "sensors": "all"}))).sent) == 4


def test_known_keys_are_those_of_the_filter_that_is_named(tmp_path: Path) -> None:
    (line,) = errors_of(tmp_path, lambda c: c.update(filters=[{"filter": "median", "widnow": 3}]))
    assert line == "filters[0].widnow: unknown key. Did you mean 'window'? Known keys here: filter, window"


def test_all_user_errors_are_reported_at_once(tmp_path: Path) -> None:
    def change(content: dict[str, Any]) -> None:
        content["vehcile"] = content.pop("vehicle")
        content["sensors"][3]["address"] = 500

    lines = errors_of(tmp_path, change)
    assert [line.split(":")[0] for line in sorted(lines)] == ["sensors[3].address", "vehcile", "vehicle"]


def test_a_user_error_in_a_file_that_is_named_is_reported_with_both_places(tmp_path: Path) -> None:
    (line,) = errors_of(tmp_path, lambda c: c["sensors"][2].update(model="mb1242.yaml"))
    assert line.startswith(f"{tmp_path / 'mb1242.yaml'}: no such file (named in ")
    assert line.endswith("airframe.yaml: sensors[2])")


def test_a_file_that_is_named_four_times_is_one_error(tmp_path: Path) -> None:
    (line,) = errors_of(tmp_path, lambda c: [each.update(model="mb1424.yaml") for each in c["sensors"]])
    assert line.count("no such file") == 1
    assert line.endswith("airframe.yaml: sensors[0], sensors[1], sensors[2], sensors[3])")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("vehicle: a\nbus: 1\nvehicle: b\n", "airframe.yaml:3:1: not valid YAML: the key 'vehicle' is given twice"),
        ("send:\n  fused: {id: 1, id: 2}\n", "airframe.yaml:2:18: not valid YAML: the key 'id' is given twice"),
        ("vehicle: [a\n", "airframe.yaml:2:1: not valid YAML: "),
        ("- vehicle\n", "airframe.yaml: found ['vehicle'], expected a mapping with the keys vehicle, bus, sensors"),
        ("", "airframe.yaml: found nothing, expected a mapping with the keys vehicle, bus, sensors"),
        ("vehicle: \xff\n", "airframe.yaml: cannot be read: "),
    ],
)
def test_a_file_that_is_not_a_mapping_of_keys_given_once(tmp_path: Path, text: str, expected: str) -> None:
    path = tmp_path / "airframe.yaml"
    path.write_text(text, encoding="latin-1")
    with pytest.raises(ConfigError) as error:
        load_airframe(path)
    assert str(error.value).startswith(str(tmp_path / expected))


def test_a_model_that_several_sensors_name_is_read_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    read: list[Path] = []

    def read_yaml(path: Path) -> Any:
        read.append(path)
        return given(path)

    given = yaml_file.read_yaml
    monkeypatch.setattr(yaml_file, "read_yaml", read_yaml)
    load_airframe(CONFIGS / "quad_pallet.yaml")
    assert [path.name for path in read] == ["quad_pallet.yaml", "mb1242.yaml"]


def test_more_sensors_than_a_bus_has_addresses(tmp_path: Path) -> None:
    (line,) = errors_of(tmp_path, lambda c: c.update(sensors=c["sensors"] * 30))
    assert line.startswith("sensors: found ")
    assert "at most 117 items" in line


def test_a_file_that_is_not_there_and_the_one_that_was_meant(tmp_path: Path) -> None:
    write(tmp_path, lambda content: None)
    with pytest.raises(ConfigError, match=r"airfrane\.yaml: no such file \(next to it there is airframe\.yaml\)"):
        load_airframe(tmp_path / "airfrane.yaml")


def sends(autopilot: str, pitches_deg: list[float], **send: Any) -> Change:
    """Sensors that look down at these pitches, all to the front, and what they send to an autopilot."""

    def change(content: dict[str, Any]) -> None:
        content["sensors"] = content["sensors"][: len(pitches_deg)]
        for each, pitch_deg in zip(content["sensors"], pitches_deg, strict=True):
            each["rotation_deg"] = {"pitch": pitch_deg}
        content["link"]["autopilot"] = autopilot
        content["send"] = send

    return change


FUSED = {"id": 10}
# Within 12.6 deg of an orientation's axis a sensor has that orientation: -85 is 'down', -70 is CUSTOM.
POSSIBLE = [
    sends("ardupilot", [-90, -90], fused=FUSED),
    sends("ardupilot", [-90, 0], fused=FUSED, sensors=["front_right"]),
    sends("ardupilot", [-90, 0, -45, 90], sensors="all"),
    # Two CUSTOM ones: no autopilot takes them for one stream.
    sends("ardupilot", [-70, -20], fused=FUSED, sensors="all"),
    sends("px4", [-90, -90], sensors="all"),
    sends("px4", [-90, -70], sensors="all"),
    sends("px4", [-70], fused=FUSED),
    sends("px4", [0], sensors="all"),
]
IMPOSSIBLE = [
    (
        sends("ardupilot", [-90, -90], sensors="all"),
        "send: the streams front_left, front_right all have orientation 25",
    ),
    (
        sends("ardupilot", [-90, -85], sensors="all"),
        "send: the streams front_left, front_right all have orientation 25",
    ),
    (sends("ardupilot", [-90], fused=FUSED, sensors="all"), "send: the streams front_left, fused all have orientation"),
    (
        sends("ardupilot", [0, 5], sensors="all"),
        "send: the streams front_left, front_right all have orientation 0 (for",
    ),
    (
        sends("px4", [-70], sensors="all"),
        "send: front_left look down at an angle, and PX4 takes a height from orientat",
    ),
]


@pytest.mark.parametrize("change", POSSIBLE)
def test_streams_that_the_autopilot_can_distinguish(tmp_path: Path, change: Change) -> None:
    load_airframe(write(tmp_path, change))


@pytest.mark.parametrize(("change", "expected"), IMPOSSIBLE)
def test_streams_that_it_would_mix_up_or_not_take(tmp_path: Path, change: Change, expected: str) -> None:
    (line,) = errors_of(tmp_path, change)
    assert line.startswith(expected)


def test_the_narrowest_beam_decides_what_orientation_a_sensor_has(tmp_path: Path) -> None:
    for pitch_deg, value in [(-90 + 12.5, DOWN), (-90 + 12.7, CUSTOM)]:
        vehicle = load_airframe(write(tmp_path, sends("px4", [pitch_deg], fused=FUSED)))
        assert vehicle.sensors[0].orientation.value == value


def accepts(schema: dict[str, Any], value: Any, whole: dict[str, Any], at: str) -> list[str]:
    """What a JSON Schema has against a value; of the standard as much as pydantic writes for these files."""
    if "$ref" in schema:
        schema = whole["$defs"][schema["$ref"].removeprefix("#/$defs/")]
    options = schema.get("anyOf") or schema.get("oneOf")
    if options:
        answers = [accepts(option, value, whole, at) for option in options]
        return [] if [] in answers else min(answers, key=len)
    if "const" in schema or "enum" in schema:
        allowed = schema.get("enum", [schema.get("const")])
        return [] if value in allowed else [f"{at}: {value} not in {allowed}"]
    kinds: dict[str, Any] = {
        "object": dict, "array": list, "string": str, "integer": int, "number": int | float, "boolean": bool,
        "null": type(None),
    }  # fmt: skip
    if not isinstance(value, kinds[schema["type"]]):
        return [f"{at}: {value!r} is not {schema['type']}"]
    if isinstance(value, dict) and schema.get("additionalProperties") is not True:
        properties = schema["properties"]
        errors = [f"{at}.{key}: unknown" for key in value.keys() - properties.keys()]
        errors += [f"{at}.{key}: missing" for key in set(schema.get("required", ())) - value.keys()]
        for key in value.keys() & properties.keys():
            errors += accepts(properties[key], value[key], whole, f"{at}.{key}")
        return errors
    if isinstance(value, list):
        items = schema.get("prefixItems") or [schema.get("items", {})] * len(value)
        return [line for item, each in zip(items, value, strict=True) for line in accepts(item, each, whole, f"{at}[]")]
    if isinstance(value, int | float) and not schema.get("minimum", -math.inf) <= value <= schema.get(
        "maximum", math.inf
    ):
        return [f"{at}: {value} out of bounds"]
    return []


@pytest.mark.parametrize(
    ("section", "path"),
    [(Airframe, path) for path in AIRFRAMES] + [(SensorModel, path) for path in SENSORS],
    ids=lambda each: each.stem if isinstance(each, Path) else each.__name__,
)
def test_the_json_schema_accepts_the_shipped_files_and_describes_every_key(section: type[Section], path: Path) -> None:
    schema = section.model_json_schema()
    content = yaml.safe_load(path.read_text(encoding="utf-8"))
    assert accepts(schema, content, schema, path.stem) == []
    for each in [schema, *schema["$defs"].values()]:
        if each["type"] == "object":
            assert each["additionalProperties"] is False
            assert [key for key, about in each["properties"].items() if not about.get("description")] == []


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: c.update(vehicl="x"), "quad.vehicl: unknown"),
        (lambda c: c["sensors"][0].pop("id"), "quad.sensors[].id: missing"),
        (lambda c: c["sensors"][0].update(address=900), "quad.sensors[].address: 900 out of bounds"),
        (lambda c: c["filters"][0].update(filter="kalmn"), "quad.filters[].filter: kalmn not in"),
    ],
)
def test_the_json_schema_refuses_user_errors(change: Change, message: str) -> None:
    content = copy.deepcopy(QUAD)
    change(content)
    schema = Airframe.model_json_schema()
    (line,) = [line for line in accepts(schema, content, schema, "quad") if message.split(":")[0] in line]
    assert line.startswith(message)


@named(AIRFRAMES)
def test_the_shipped_airframes_are_polled_at_the_safe_spacing_and_measure_from_where_the_sensors_sit(
    path: Path,
) -> None:
    vehicle = load_airframe(path)
    # Light leaves no echo behind that would have to die away.
    assert vehicle.polling.ping_interval_s in (None, 0.1) or vehicle.maximum_by_sound_m == 0
    if vehicle.send.fused is not None:
        # So ArduPilot's RNGFND1_POS_Z and PX4's EKF2_RNG_POS_Z are the height at which the sensors are mounted.
        assert {sensor.position_m[2] for sensor in vehicle.downward} == {vehicle.send.fused.reference_down_m}


@pytest.mark.parametrize("name", ["canted_pallet", "proximity"])
def test_sensors_that_look_outwards_look_to_the_side_on_which_they_sit(name: str) -> None:
    for sensor in load_airframe(CONFIGS / f"{name}.yaml").sensors:
        outwards = math.hypot(*sensor.position_m[:2])
        looks = math.hypot(*sensor.boresight[:2])
        inner = sum(there * look for there, look in zip(sensor.position_m[:2], sensor.boresight[:2], strict=True))
        assert inner == pytest.approx(outwards * looks)


def test_a_file_that_comes_with_the_package_is_found_by_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert load_airframe("quad_pallet").vehicle == "quad pallet"
    text = (CONFIGS / "quad_pallet.yaml").read_text().replace("sensors/mb1242.yaml", "mb1242")
    (tmp_path / "own.yaml").write_text(text)
    own = load_airframe("own.yaml")
    assert own.sensors[0].sensor_model.frequency_hz == 42_000
    assert set(own.files) == {"airframe.yaml", "mb1242"}, "a recording keeps it under that name"
    # A file of that name next to it is the one that is meant.
    (tmp_path / "mb1242").write_text((CONFIGS / "sensors" / "hcsr04.yaml").read_text())
    with pytest.raises(ConfigError, match=r"address|driver|sensor"):
        load_airframe("own.yaml")


@pytest.mark.parametrize("name", ["m" * 300, f"{'m' * 300}.yaml", f"{'m' * 300}/mb1242.yaml"])
def test_a_name_that_is_too_long_for_a_file_is_a_user_error(tmp_path: Path, name: str) -> None:
    path = write(tmp_path, lambda c: c["sensors"][0].update(model=name))
    with pytest.raises(ConfigError, match=r"no such file|cannot be read: File name too long") as error:
        load_airframe(path)
    assert str(error.value).endswith("airframe.yaml: sensors[0])")


def test_a_name_that_nobody_knows_has_a_hint(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ConfigError, match=r"quad_palet: no such file.*Did you mean 'quad_pallet'\? Known names: "):
        load_airframe("quad_palet")
    with pytest.raises(ConfigError, match=r"own.yaml: no such file$"):
        load_airframe("own.yaml")
