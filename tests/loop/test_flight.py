"""Whole flights of the real bridge: the same for the same seed, and right against the truth."""

import gc
import json
import math
from pathlib import Path

import numpy as np
import pytest
import yaml
from matplotlib.image import imread
from mcap.reader import make_reader
from pymavlink.dialects.v20 import common
from scipy.stats import kstest

from msp_range.clock import VirtualClock
from msp_range.reading_model.sensor_model import load_sensor_model
from msp_range.recording.export import measured_data
from msp_range.recording.reader import Recording
from msp_range.recording.writer import Recorder
from msp_sim.flight.flight import Simulation
from msp_sim.flight.flight_log import FlightResult
from msp_sim.flight.recorded import recorded_flight
from msp_sim.flight.scenario import Scenario, load_scenario
from msp_sim.flight.summary import summarise
from msp_sim.model.model import load_model
from tests.support.programs import run
from tests.support.shipped import CONFIGS

SCENARIOS = CONFIGS / "scenarios"


def fly(name: str, seed: int = 1) -> tuple[FlightResult, Simulation]:
    simulation = Simulation(load_scenario(SCENARIOS / name), VirtualClock(), seed)
    for _ in simulation.fly():
        pass
    return simulation.flight, simulation


@pytest.fixture(scope="module")
def demo() -> tuple[FlightResult, Simulation]:
    return fly("demo.yaml")


def test_no_echo_of_another_kind_of_sensor_is_no_echo_on_the_bus() -> None:
    """An MB1433 without an echo reads 500 after 100 ms; the emulated MB1242 answers 765, and within its deadline."""
    content = {
        "name": "another_kind",
        "airframe": "quad_pallet.yaml",
        "duration_s": 17.5,
        "flight": {
            "altitude": [
                {"kind": "climb", "to_m": 6.0, "speed_m_s": 1.0},
                {"kind": "hold", "duration_s": 10.0},
            ]
        },
    }
    scenario = Scenario.model_validate(content, context={"folder": CONFIGS})
    mb1433 = load_sensor_model(CONFIGS / "sensors" / "mb1433.yaml")
    simulation = Simulation(scenario, VirtualClock(), 1, model=mb1433)
    for _ in simulation.fly():
        pass
    # A few readings are short or random, and ranges therefore.
    high = [
        why
        for track in simulation.flight.tracks.values()
        for time_s, why in zip(track.time_s, track.why, strict=True)
        if time_s > 8.0
    ]
    assert high.count("no_echo") > 0.9 * len(high) > 60
    assert not any("no answer" in text for _, _, text in simulation.flight.texts)
    sent = [(time_s, each) for time_s, each in simulation.received if each.get_type() == "DISTANCE_SENSOR"]
    valid_s = [time_s for time_s, each in sent if each.current_distance <= each.max_distance]
    assert len(valid_s) > 30
    assert max(valid_s) < 8.0


FLOWN = (
    "boxes",
    "demo",
    "faults",
    "flat",
    "hover",
    "rough_grass",
    "sinusoid",
    "slope",
    "steps",
    "terrain",
)
"""Scenarios that other tests of this folder fly to their end."""


@pytest.mark.slow
def test_every_scenario_flies_to_its_end() -> None:
    for path in sorted(path for path in SCENARIOS.glob("*.yaml") if path.stem not in FLOWN):
        flight, _ = fly(path.name)
        assert flight.duration_s >= load_scenario(path).duration_s
        assert all(track.time_s for track in flight.tracks.values()), path.name


@pytest.mark.slow
def test_a_flight_leaves_nothing_to_the_garbage_collector() -> None:
    """A collection stops the loop, for 10 ms and more where it is a full one; faults and failed transfers included."""
    simulation = Simulation(load_scenario(SCENARIOS / "faults.yaml"), VirtualClock(), 1)
    gc.collect()
    gc.disable()
    try:
        for _ in simulation.fly():
            pass
        assert gc.collect() == 0
    finally:
        gc.enable()


@pytest.mark.slow
def test_the_same_seed_gives_the_same_files_and_another_seed_others(tmp_path: Path) -> None:
    scenario = tmp_path / "short.yaml"
    scenario.write_text(
        f"name: short\nairframe: {CONFIGS}/quad_pallet.yaml\nduration_s: 15\nflight:\n"
        "  altitude: [{kind: climb, to_m: 2.0}, {kind: sinusoid, swing_m: 1.0, period_s: 4, cycles: 2}]\n"
        "  attitude: {sway: {roll_rms_deg: 0.7, pitch_rms_deg: 0.7, period_s: 2.0}}\n"
    )
    folders = [tmp_path / name for name in ("one", "two", "other")]
    for folder, seed in zip(folders, (5, 5, 6), strict=True):
        run("msp-sim fly", scenario, "--seed", seed, "--out", folder)
    summaries = [json.loads((folder / "summary.json").read_text()) for folder in folders]
    for summary in summaries:
        assert summary.pop("wall")["seconds"] > 0
    assert summaries[0] == summaries[1]
    assert summaries[0]["link"]["sha256"] != summaries[2]["link"]["sha256"]
    for name in ("flight.mcap", "link.tlog"):
        one, two, other = ((folder / name).read_bytes() for folder in folders)
        assert one == two
        assert one != other


def test_the_sensors_count_in_the_air_that_there_is(tmp_path: Path) -> None:
    """Sound is slower by 4 % at 0 C than a sensor assumes, and the bridge knows the air: without it 8 cm at 2 m."""
    text = (SCENARIOS / "hover.yaml").read_text().replace("ground_c: 20.0", "ground_c: 0.0")
    text = text.replace("airframe: ..", f"airframe: {SCENARIOS.parent}")
    (tmp_path / "cold.yaml").write_text(text)
    simulation = Simulation(load_scenario(tmp_path / "cold.yaml"), VirtualClock(), 1)
    for _ in simulation.fly():
        pass
    track = simulation.flight.tracks["front_left"]
    read = [
        (raw_m, truth_m)
        for time_s, raw_m, truth_m in zip(track.time_s, track.raw_m, track.truth_m, strict=True)
        if 10 < time_s < 50 and raw_m is not None and truth_m is not None
    ]
    ratios = sorted(raw_m / truth_m for raw_m, truth_m in read)
    assert ratios[len(ratios) // 2] == pytest.approx(math.sqrt((273.15 + 22.5) / 273.15), abs=0.005)


def test_the_fused_stream_follows_the_ground(demo: tuple[FlightResult, Simulation]) -> None:
    """Over level ground within what noise of 2 cm and a line through half a second leave; at 10 Hz."""
    flight, _ = demo
    summary = summarise(flight, "demo", 1)["fused"]
    # Where two sensors agree on another height than the ground's, nothing is sent: ten steps and edges of boxes.
    assert summary["rate_hz"] == pytest.approx(10.0, rel=0.035)
    assert summary["error"]["p95_cm"] < 3.5
    assert summary["error"]["rms_cm"] < 2.0
    assert abs(summary["error"]["bias_cm"]) < 1.0
    assert summary["over_edges"] < 0.4 * summary["estimates"]


def test_filters_take_away_the_outliers() -> None:
    """Of sensors that have a stream of their own: only those have filters."""
    scenario = load_scenario(SCENARIOS / "demo.yaml")
    link = scenario.airframe.link.model_copy(update={"autopilot": "px4"})
    send = scenario.airframe.send.model_copy(update={"sensors": "all"})
    scenario = scenario.model_copy(
        update={"airframe": scenario.airframe.model_copy(update={"send": send, "link": link})}
    )
    simulation = Simulation(scenario, VirtualClock(), 1)
    for _ in simulation.fly():
        pass
    for sensor in summarise(simulation.flight, "demo", 1)["sensors"].values():
        assert sensor["error_before"]["rms_cm"] > 20, "one reading in fifty is an outlier"
        assert sensor["error_after"]["rms_cm"] < 0.5 * sensor["error_before"]["rms_cm"]
        assert sensor["error_after"]["p95_cm"] < 6
        assert sensor["rejected"]["unexpected"] > 0


def test_what_the_autopilot_receives(demo: tuple[FlightResult, Simulation]) -> None:
    """Every field of the fused stream, as an autopilot reads it; its time is the autopilot's clock and the echo's."""
    flight, simulation = demo
    received = [(time_s, message) for time_s, message in simulation.received if message.get_type() == "DISTANCE_SENSOR"]
    below = [each for each in received if each[1].id != 10]
    assert {message.orientation for _, message in below} == {common.MAV_SENSOR_ROTATION_CUSTOM}
    received = [each for each in received if each[1].id == 10]
    assert len(received) == len(flight.fused.time_s)
    messages = [message for _, message in received]
    assert {message.orientation for message in messages} == {common.MAV_SENSOR_ROTATION_PITCH_270}
    assert {message.type for message in messages} == {common.MAV_DISTANCE_SENSOR_ULTRASOUND}
    assert {(message.min_distance, message.id) for message in messages} == {(19, 10)}
    # On the ground the thermometer is in the warm layer, 3 K warmer than the air above.
    assert {message.max_distance for message in messages} == {767, 771}
    assert all(message.get_srcSystem() == 1 and message.get_srcComponent() == 191 for message in messages)
    assert all(2 <= message.signal_quality <= 100 for message in messages)
    assert all(1 <= message.covariance <= 254 for message in messages)
    # 11.3 deg of half angle from 3 m on, which the sonar equation predicts; 23.4 below 50 cm.
    fields_deg = {round(math.degrees(message.horizontal_fov), 1) for message in messages}
    assert (min(fields_deg), max(fields_deg)) == (22.6, 46.8)
    # The autopilot had been on for 42.5 s; a reading is at most 45 ms of ranging and polling old when it is sent.
    late_ms = [1e3 * (time_s + 42.5) - message.time_boot_ms for time_s, message in received[20:]]
    assert min(late_ms) > 15
    assert max(late_ms) < 75


def test_a_late_and_rebooting_autopilot(tmp_path: Path) -> None:
    """The bridge speaks before it receives one, and its times follow the autopilot's new clock."""
    text = (SCENARIOS / "hover.yaml").read_text().replace("../", f"{SCENARIOS.parent}/")
    path = tmp_path / "reboot.yaml"
    path.write_text(text + "\nautopilot: {first_heartbeat_s: 5, reboots_at_s: [15]}\n")
    simulation = Simulation(load_scenario(path), VirtualClock(), 1)
    for _ in simulation.fly():
        pass
    times = [(t, m.time_boot_ms) for t, m in simulation.received if m.get_type() == "DISTANCE_SENSOR"]
    before = [1e3 * (t + 42.5) - boot_ms for t, boot_ms in times if 7 < t < 15]
    after = [1e3 * (t - 15) - boot_ms for t, boot_ms in times if t > 20]
    assert before
    assert after
    assert max(before + after) < 75
    assert min(before + after) > 0


@pytest.mark.slow
def test_fly_prints_what_compares_with_the_true_height(tmp_path: Path) -> None:
    output = run("msp-sim fly", SCENARIOS / "demo.yaml", "--out", tmp_path / "f").output
    lines = [line for line in output.splitlines() if "true height" in line and "no estimate" not in line]
    off_cm = []
    for line in lines:
        true_m, fused_m = (float(part.split(" m")[0]) for part in line.split("true height ")[1].split(", fused ")[:2])
        if "over an edge of the ground" not in line:
            off_cm.append(100.0 * (fused_m - true_m))
    assert len(lines) > len(off_cm) >= 5
    assert max(map(abs, off_cm)) < 4.0


def test_fly_leaves_what_other_tools_open(tmp_path: Path) -> None:
    output = run("msp-sim fly", SCENARIOS / "hover.yaml", "--out", tmp_path / "f").output
    assert "times real time" in output
    assert (tmp_path / "f" / "flight.png").read_bytes().startswith(b"\x89PNG")
    with (tmp_path / "f" / "flight.mcap").open("rb") as file:
        topics = {channel.topic for _, channel, _ in make_reader(file).iter_messages()}
    assert {"/range/front_left", "/truth/front_left", "/fused", "/mavlink/sent"} <= topics
    frames = (tmp_path / "f" / "link.tlog").read_bytes()
    parser = common.MAVLink(None)
    names = []
    while frames:
        length = 12 + frames[9]
        names += [message.get_type() for message in parser.parse_buffer(frames[8 : 8 + length])]
        frames = frames[8 + length :]
    assert names.count("HEARTBEAT") >= 30


@pytest.mark.slow
def test_a_recorded_flight_is_drawn_with_its_truth_and_without(tmp_path: Path) -> None:
    """As a simulator recorded it, and as a vehicle would have: replayed, there is no truth."""
    run("msp-sim fly", SCENARIOS / "hover.yaml", "--out", tmp_path / "f")
    recording, replayed = tmp_path / "f" / "flight.mcap", tmp_path / "replayed.mcap"
    run("msp-range replay", recording, "--record", replayed)
    run("msp-sim show", recording, "--out", tmp_path / "pictures" / "simulated.png")
    printed = run("msp-sim show", replayed, "--out", tmp_path / "pictures" / "real.png").output
    assert "replayed.mcap, 60 s flown" in printed
    assert "all 4 sensors good" in printed
    sizes = [imread(tmp_path / "pictures" / f"{name}.png").shape for name in ("simulated", "real")]
    assert sizes[0][0] > sizes[1][0], "there are no errors to show below"
    flight, simulation = recorded_flight(recording), fly("hover.yaml")[0]
    assert flight.tracks.keys() == simulation.tracks.keys()
    for name, track in flight.tracks.items():
        assert track.raw_m == simulation.tracks[name].raw_m
        assert track.why == simulation.tracks[name].why
        pairs = [(a, b) for a, b in zip(track.truth_m, simulation.tracks[name].truth_m, strict=True) if b is not None]
        assert [a for a, _ in pairs] == pytest.approx([b for _, b in pairs], abs=1e-6)
    assert flight.fused.filtered_m == simulation.fused.filtered_m
    assert {name: counts for name, counts in flight.rejected.items() if counts} == simulation.rejected
    assert [text for _, _, text in flight.texts] == [text for _, _, text in simulation.texts]
    assert flight.sent == {"DISTANCE_SENSOR": simulation.sent["DISTANCE_SENSOR"]}
    assert all(truth is None for track in recorded_flight(replayed).tracks.values() for truth in track.truth_m)


@pytest.mark.parametrize("resolution_cm", [1, 0.1])
@pytest.mark.slow
def test_another_model_flies(tmp_path: Path, resolution_cm: float) -> None:
    """A sensor model without outliers, with little noise: nothing is rejected but each sensor's first.

    In millimetres it flies too: the devices answer whole centimetres.
    """
    model = (SCENARIOS.parent / "sensors" / "mb1242.yaml").read_text()
    model = model.replace(
        "{hit: 0.96, short: 0.01, missed: 0.02, random: 0.01}", "{hit: 1.0, short: 0.0, missed: 0.0, random: 0.0}"
    ).replace("sigma_cm: 1.9445", "sigma_cm: 0.3")
    model = model.replace("resolution_cm: 1\n", f"resolution_cm: {resolution_cm}\n")
    assert f"resolution_cm: {resolution_cm}\n" in model
    (tmp_path / "quiet.yaml").write_text(model)
    run("msp-sim fly", SCENARIOS / "hover.yaml", "--model", tmp_path / "quiet.yaml", "--out", tmp_path / "f")
    summary = json.loads((tmp_path / "f" / "summary.json").read_text())
    for sensor in summary["sensors"].values():
        assert sensor["rejected"].keys() <= {"unconfirmed"}
        assert sensor["error_before"]["rms_cm"] < 1.5


@pytest.mark.slow
@pytest.mark.parametrize("effect", ["lost_high_byte", "clock_fault"])
def test_words_that_are_no_range_of_the_sensor_arrive_on_the_bus(tmp_path: Path, effect: str) -> None:
    """300 cm without its high byte is 44, and 268 is 12: a word that an MB1242 never ranges."""
    model = yaml.safe_load((SCENARIOS.parent / "sensors" / "mb1242.yaml").read_text())
    model["effects"].append({"name": effect, "parameters": {"share": 0.3}})
    (tmp_path / "faulty.yaml").write_text(yaml.safe_dump(model))
    run("msp-sim fly", SCENARIOS / "demo.yaml", "--model", tmp_path / "faulty.yaml", "--out", tmp_path / "f")
    with (tmp_path / "f" / "flight.mcap").open("rb") as file:
        rangings = [
            json.loads(message.data)
            for _, channel, message in make_reader(file).iter_messages()
            if channel.topic.startswith("/range/")
        ]
    raw = [each["raw"] for each in rangings if each["raw"] is not None]
    assert sum(word < 20 or word > 765 for word in raw) >= 2


@pytest.mark.slow
def test_effects_fly_as_they_are_scored(tmp_path: Path) -> None:
    """Readings of a flight with effects, as the bridge recorded them, follow their model given the recorded context."""
    path = SCENARIOS.parent / "sensors" / "mb1242_in_flight.yaml"
    run("msp-sim fly", SCENARIOS / "demo.yaml", "--model", path, "--out", tmp_path / "f")
    data = measured_data(Recording(tmp_path / "f" / "flight.mcap"))
    # A reading of a ping that the sensor did not take is the one before.
    data = data.select(~np.isnan(data["true_range_cm"]) & ~np.isnan(data["reading_cm"]))
    model = load_model(path)
    rows = model.rows(data.columns)
    p = np.exp(rows.log_prob(data["reading_cm"]))
    transformed = np.exp(rows.log_below(data["reading_cm"])) + p * np.random.default_rng(1).random(p.size)
    assert kstest(transformed, "uniform").pvalue > 1e-3
    plain = load_model(SCENARIOS.parent / "sensors" / "mb1242.yaml").log_prob(data["reading_cm"], data.columns)
    assert np.log(p).mean() > plain.mean() + 0.02


@pytest.mark.slow
def test_an_autopilot_without_motion_is_flown_without_it(tmp_path: Path) -> None:
    """No acceleration and no pressure arrives, the requests for them are denied, and distances go out all the same."""
    scenario = load_scenario(SCENARIOS / "demo.yaml")
    assert scenario.autopilot is not None
    autopilot = scenario.autopilot.model_copy(update={"sends_motion": False})
    clock = VirtualClock()
    recorder = Recorder(tmp_path / "flight.mcap", clock)
    scenario = scenario.model_copy(update={"autopilot": autopilot})
    simulation = Simulation(scenario, clock, 1, recorder=recorder)
    for _ in simulation.fly():
        pass
    recorder.close()
    topics = {topic for topic, _, _ in Recording(tmp_path / "flight.mcap")}
    assert "/motion" not in topics
    assert "/attitude" in topics
    requested = [message for _, message in simulation.received if message.get_type() == "COMMAND_LONG"]
    assert {int(message.param1) for message in requested} >= {common.MAVLINK_MSG_ID_RAW_IMU}
    distances = [message for _, message in simulation.received if message.get_type() == "DISTANCE_SENSOR"]
    assert len(distances) > 9 * simulation.flight.duration_s
