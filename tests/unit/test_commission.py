"""What commissioning measures, on numbers made here from the geometry alone; and the person at the terminal."""

import errno
import io
import json
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from msp_range.acoustics.air import FIXED
from msp_range.acoustics.beam import BreakawayTable
from msp_range.clock import VirtualClock
from msp_range.commission.edit import Edit
from msp_range.commission.motion import Measured, NotMeasured, Places, common_shift, places
from msp_range.commission.noise import compare_noise
from msp_range.commission.operator import PersonAtTerminal
from msp_range.commission.outcome import Proposal, StepOutcome
from msp_range.commission.samples import Samples, samples_of
from msp_range.commission.state import PassedSteps, hash_of
from msp_range.commission.steps import bench, lift
from msp_range.commission.steps.addresses import blocked, covered
from msp_range.commission.steps.addresses import compare as compare_addresses
from msp_range.commission.steps.bench import Stand, levels, noise_m
from msp_range.commission.steps.directions import axis_of, compare_directions
from msp_range.commission.steps.flight import compare as compare_flight
from msp_range.commission.steps.flight import gaps, hovering
from msp_range.commission.steps.places import compare_lag, compare_places
from msp_range.commission.steps.table import STEPS
from msp_range.config import load_airframe
from msp_range.doctor.finding import Verdict, right, wrong
from msp_range.recording.topics import Message
from msp_range.yaml_file import ConfigError
from tests.support.programs import run

AIRFRAME = load_airframe("configs/quad_pallet.yaml")
PLACES = {sensor.name: sensor.position_m for sensor in AIRFRAME.sensors}
NAMES = list(PLACES)
BEAM = AIRFRAME.sensors[0].sensor_model.beam


def reading(name: str, time_s: float, range_m: float | None, status: str = "ok") -> Message:
    message = {"time_s": time_s, "read_s": time_s + 0.03, "status": status}
    if range_m is not None:
        message |= {"range_m": range_m, "corrected_m": range_m}
    return Message(f"/range/{name}", time_s, message)


def rocked(
    mounted: Mapping[str, Sequence[float]],
    seed: int,
    *,
    tilt_deg: float = 16.0,
    late_s: float = 0.0,
    wall: str | None = None,
    axis: Mapping[str, tuple[float, float]] | None = None,
    heave_m: float = 0.02,
) -> Samples:
    """A vehicle held 0.9 m high and rocked for 45 s; four sensors in turn, 1.5 cm of noise, one outlier in fifty.

    ``wall`` looks at a wall 1.3 m away; ``axis`` is where sensors look, forward and right of straight down [deg].
    """
    draw = np.random.default_rng(seed)

    def held(time_s: float) -> tuple[float, float, float]:
        tilt = math.radians(tilt_deg) * min(time_s / 5, 1)
        height_m = 0.25 + 0.65 * min(time_s / 4, 1) + heave_m * math.sin(1.1 * time_s)
        return height_m, tilt * math.sin(1.7 * time_s), tilt * math.sin(1.3 * time_s + 0.5)

    records = []
    for number in range(450):
        time_s = 0.1 * number
        _, roll, pitch = held(time_s)
        angles = {"time_s": time_s + late_s, "roll_rad": roll, "pitch_rad": pitch, "yaw_rad": 0.0}
        records.append(Message("/attitude", time_s, angles))
        name = list(mounted)[number % len(mounted)]
        at_s = time_s + 0.013
        height_m, roll, pitch = held(at_s)
        down = np.array([-math.sin(pitch), math.cos(pitch) * math.sin(roll), math.cos(pitch) * math.cos(roll)])
        range_m = height_m - float(down @ np.array(mounted[name])) + draw.normal(0, 0.015)
        if draw.random() < 0.02:
            range_m = draw.uniform(0.2, 7.0)
        if name == wall:
            range_m = 1.3 + draw.normal(0, 0.015)
        elif axis is not None:
            forward, right = (math.radians(each) for each in axis.get(name, (0.0, 0.0)))
            looks = np.array([math.sin(forward), math.sin(right), math.cos(math.hypot(forward, right))])
            if math.acos(min(looks @ down / np.linalg.norm(looks), 1.0)) > BEAM.half_angle_rad(range_m):
                records.append(reading(name, at_s, None, "no_echo"))
                continue
        records.append(reading(name, at_s, range_m))
    return samples_of(records)


def test_places_are_found_whatever_the_file_says() -> None:
    in_file = dict(PLACES) | {"front_left": (0.25, 0.20, 0.05), "rear_left": (-0.25, -0.20, 0.14)}
    found = places(rocked(PLACES, 1), in_file)
    assert found.elsewhere == ()
    for name, measured in found.position_m.items():
        assert [each.value for each in measured] == pytest.approx(PLACES[name], abs=0.04)
        for each, true in zip(measured, PLACES[name], strict=True):
            assert each.half_width < 0.05
            assert abs(each.value - true) < 2 * each.half_width
    assert found.height_at(np.array([20.0])) == pytest.approx(0.90 + 0.02 * math.sin(22), abs=0.02)


def test_intervals_contain_the_truth() -> None:
    inside = []
    for seed in range(12):
        found = places(rocked(PLACES, 100 + seed), PLACES)
        inside += [
            each.contains(true)
            for name, measured in found.position_m.items()
            for each, true in zip(measured, PLACES[name], strict=True)
        ]
    assert np.mean(inside) > 0.93


@pytest.mark.parametrize("late_s", [-0.09, 0.0, 0.05, 0.71])
def test_the_delay_of_the_attitude_is_found(late_s: float) -> None:
    """Between the steps of 0.02 s that are tried, too; one beyond the first range was called none."""
    found = places(rocked(PLACES, 7, late_s=late_s), PLACES)
    assert found.lag.value == pytest.approx(late_s, abs=0.007)
    assert abs(found.lag.value - late_s) < 2 * found.lag.half_width


def test_a_sensor_that_sees_a_wall_is_named_and_does_not_bend_the_others() -> None:
    found = places(rocked(PLACES, 4, wall="rear_left", heave_m=0.25), PLACES)
    assert found.elsewhere == ("rear_left",)
    for name, measured in found.position_m.items():
        assert [each.value for each in measured] == pytest.approx(PLACES[name], abs=0.04)


def test_what_is_too_little_says_so() -> None:
    one = {"front_left": PLACES["front_left"]}
    with pytest.raises(NotMeasured, match="comparing sensors"):
        places(rocked(one, 5), one)
    two = {name: PLACES[name] for name in NAMES[:2]}
    with pytest.raises(NotMeasured, match="no third one"):
        places(rocked(two, 5, wall=NAMES[0], heave_m=0.5), two)
    samples = rocked(PLACES, 5)
    with pytest.raises(NotMeasured, match="no attitude"):
        places(Samples(samples.readings, samples.attitude[:0], samples.fused), PLACES)
    narrow = places(rocked(PLACES, 5, tilt_deg=1.0), PLACES)
    assert min(each.half_width for measured in narrow.position_m.values() for each in measured[:2]) > 0.10


@pytest.mark.parametrize(
    ("from_file", "moved", "expected"),
    [
        ([0.2, 0.2, -0.2, -0.2], [0, 0, 0, 0], 0),
        ([0.2, 0.2, -0.2, -0.2], [-0.3, 0.1, 0.1, 0.1], 0.1),
        ([0.2, -0.2, 0.2, -0.2], [-0.4, 0.4, -0.4, 0.4], 0),
        ([0.3, -0.1, 0.3, -0.1], [-0.6, 0.2, -0.6, 0.2], 0),
        ([0.2, 0.2, 0.2, 0.2], [-0.2, 0.2, -0.2, 0.2], 0.2),
    ],
)
def test_the_shift_of_all_is_the_one_with_the_fewest_mistakes(
    from_file: list[float], moved: list[float], expected: float
) -> None:
    """None wrong; one; every sign, also of places that are not about the middle; and two of four on the wrong side,
    which puts the sensors around the middle."""
    found = common_shift(np.array(from_file), np.array(moved), np.full(4, 0.02))
    assert found == pytest.approx(expected, abs=1e-9)


NARROW = replace(
    BEAM, half_angles_deg=tuple(0.7 * each for each in BEAM.half_angles_deg), narrowest_deg=0.7 * BEAM.narrowest_deg
)
"""A model that says 0.7 times the angles at which there are echoes."""


@pytest.mark.parametrize("beam", [BEAM, NARROW], ids=["right", "narrow"])
@pytest.mark.parametrize("looks", [(0.0, 0.0), (25.0, 0.0), (-18.0, 18.0)])
def test_the_axis_follows_from_the_echoes(looks: tuple[float, float], beam: BreakawayTable) -> None:
    samples = rocked(PLACES, 6, tilt_deg=18.0, axis={"rear_right": looks})
    found = places(samples, PLACES)
    axis = axis_of(samples, "rear_right", found, np.array(PLACES["rear_right"]), np.array([0.0, 0.0, 1.0]), beam)
    assert axis.boresight is not None
    angles = np.degrees(np.arcsin(axis.boresight[:2]))
    assert np.hypot(*(angles - looks)) < max(4.0, axis.half_width_deg)
    assert axis.excluded == (looks != (0.0, 0.0))


def test_a_sensor_that_looks_aside_is_turned_and_its_place_is_not_compared() -> None:
    samples = rocked(PLACES, 6, tilt_deg=18.0, axis={"rear_right": (28.0, 0.0)})
    found, outcome = places(samples, PLACES), StepOutcome()
    dim = compare_directions(AIRFRAME, samples, {}, found, outcome)
    assert dim == ["rear_right"]
    assert [each.text.split(" looks to")[0] for each in outcome.proposals] == ["rear_right"]
    elsewhere = (Measured(0.5, 0.02), Measured(0.5, 0.02), Measured(0.05, 0.01))
    for wide_m, names, expected in ((0.02, ["rear_right"], 0), (0.2, [], 0), (0.02, [], 1)):
        measured = (replace(elsewhere[0], half_width=wide_m), replace(elsewhere[1], half_width=wide_m), elsewhere[2])
        outcome = StepOutcome()
        compare_places(AIRFRAME, replace(found, position_m={"rear_right": measured}), outcome, names)
        assert len(outcome.proposals) == expected


def covering(shares: Mapping[str, float]) -> Samples:
    records = []
    for name, share in shares.items():
        for number in range(10):
            near = number < 10 * share
            records.append(reading(name, number, 0.2 if near else 1.8, "at_minimum" if near else "ok"))
    return samples_of(records)


@pytest.mark.parametrize(
    ("shares", "expected"),
    [
        ({"a": 1.0, "b": 0.0}, "a"),
        ({"a": 0.2, "b": 0.7}, "b"),
        ({"a": 0.5, "b": 0.0}, None),
        ({"a": 0.9, "b": 0.6}, None),
        ({}, None),
    ],
)
def test_the_covered_sensor_is_named_where_that_is_clear(shares: Mapping[str, float], expected: str | None) -> None:
    assert covered(covering(shares)) == expected


def test_something_in_front_of_a_sensor_is_noticed_without_a_hand() -> None:
    assert blocked(covering({"a": 0.0, "b": 0.8})) == ["b"]
    dead = samples_of([reading("c", number, None, "no_answer") for number in range(5)])
    assert blocked(dead) == ["c"]


def test_addresses_go_round_and_doubtful_answers_change_nothing() -> None:
    round_ = dict(zip(NAMES, [NAMES[1], NAMES[2], NAMES[0], NAMES[3]], strict=True))
    (proposal,) = compare_addresses(AIRFRAME, dict(round_)).proposals
    assert {each.path[1]: each.value for each in proposal.edits} == {0: 0x71, 1: 0x72, 2: 0x70}
    for doubtful in ({**round_, NAMES[0]: None}, dict.fromkeys(NAMES, NAMES[0])):
        outcome = compare_addresses(AIRFRAME, dict(doubtful))
        assert outcome.proposals == []
        assert not outcome.passed


def stand(height_m: float, scale: float, seed: int) -> Stand:
    draw = np.random.default_rng(seed)
    records = [
        reading(name, number, round((height_m - place[2]) / scale + draw.normal(0, 0.01), 2))
        for number in range(40)
        for name, place in PLACES.items()
    ]
    return Stand(samples_of(records), height_m)


def test_one_height_gives_the_places_and_two_the_air() -> None:
    vertical = dict.fromkeys(PLACES, 1.0)
    one = levels([stand(0.8, 1.0, 1)], vertical, 2.0)
    assert one.scale is None
    assert one.air_c(20.0) is None
    two = levels([stand(0.5, 1.03, 1), stand(2.5, 1.03, 2)], vertical, 12.0)
    air = two.air_c(20.0)
    assert air is not None
    # c grows with the root of the temperature: (273.15 + 20) 1.03^2 - 273.15
    assert air.value == pytest.approx(37.9, abs=2.0)
    assert abs(air.value - 37.9) < air.half_width < 6
    for found in (one, two):
        for measured in found.down_m.values():
            assert abs(measured.value - 0.05) < measured.half_width < 0.03


def test_noise_is_that_of_the_steps_between_readings() -> None:
    """Of a drifting distance in whole centimetres, with outliers."""
    draw = np.random.default_rng(7)
    for std_m in (0.02, 0.005):
        records = [
            reading("a", number, round(1.0 + 0.001 * number + draw.normal(0, std_m), 2) if number % 20 else 4.0)
            for number in range(400)
        ]
        found = noise_m(samples_of(records))["a"]
        assert found.value == pytest.approx(std_m, rel=0.12)
        assert found.half_width < 0.004


def test_one_noisy_sensor_is_a_fault_of_its_own_and_all_of_them_are_the_model_s() -> None:
    quiet, loud = Measured(0.019, 0.003), Measured(0.05, 0.006)
    one, all_of_them = StepOutcome(), StepOutcome()
    compare_noise(AIRFRAME, {name: loud if name == NAMES[2] else quiet for name in NAMES}, "in flight", one)
    compare_noise(AIRFRAME, dict.fromkeys(NAMES, loud), "in flight", all_of_them)
    assert [each.step for each in one.findings if each.verdict is Verdict.WRONG] == ["noise of rear_left"]
    assert one.proposals == []
    # A little louder is no fault, and a bench that is quieter than the model no reason to change it.
    usual = StepOutcome()
    compare_noise(AIRFRAME, dict.fromkeys(NAMES, quiet) | {NAMES[2]: Measured(0.027, 0.003)}, "while still", usual)
    compare_noise(AIRFRAME, dict.fromkeys(NAMES, Measured(0.008, 0.001)), "while still", usual)
    assert [each.verdict for each in usual.findings] == [Verdict.RIGHT] * 2
    assert usual.proposals == []
    (proposal,) = all_of_them.proposals
    assert "sigma_cm: 5" in proposal.files[0][1]
    assert len(proposal.edits) == 4


@pytest.mark.parametrize(
    ("step", "kept"),
    [
        ("noise of rear_left", ["front_left", "air"]),
        ("cover front_left", ["rear_left", "air"]),
        ("delay of the attitude", []),
        (None, ["front_left", "rear_left", "air"]),
    ],
)
def test_nothing_is_proposed_from_what_is_called_wrong(step: str | None, kept: list[str]) -> None:
    outcome = StepOutcome([right("noise", "as usual")])
    for i, name in enumerate(NAMES):
        if name in ("front_left", "rear_left"):
            outcome.proposals.append(Proposal(name, (Edit(("sensors", i, "position_m", 2), 0.1),)))
    outcome.proposals.append(Proposal("air", (Edit(("temperature", "fixed_c"), 10),)))
    if step is not None:
        outcome.findings.append(wrong(step, "it is wrong", "repair it"))
    outcome.keep_founded(AIRFRAME)
    assert [each.text for each in outcome.proposals] == kept
    said = [each.text for each in outcome.findings if each.step == "changes"]
    assert said == ([f"{3 - len(kept)} not proposed, as they come from what is wrong: {step}"] if step else [])
    assert not outcome.passed


def test_the_hover_of_a_flight_is_its_longest_level_part() -> None:
    def height_m(time_s: float) -> float:
        return float(np.interp(time_s, [0, 10, 15, 60, 65, 90], [0.2, 0.2, 2.6, 3.4, 0.2, 0.2]))

    fused = [
        Message("/fused", 0.1 * i, {"time_s": 0.1 * i, "range_m": height_m(0.1 * i), "height_m": height_m(0.1 * i)})
        for i in range(900)
    ]
    part = hovering(fused)
    assert part is not None
    assert part.fused[[0, -1], 0] == pytest.approx([13, 62], abs=1.5)
    assert hovering(fused[:300]) is None
    on_the_ground = [each for each in fused if each.message["height_m"] == 0.2]
    assert hovering(on_the_ground) is None


def test_a_flight_with_silence_or_missed_echoes_is_not_right() -> None:
    times_s = np.arange(0.0, 30.0, 0.1)
    assert gaps(times_s).verdict is Verdict.RIGHT
    assert gaps(np.delete(times_s, slice(100, 108))).verdict is Verdict.WRONG
    for share, expected in ((0.1, Verdict.RIGHT), (0.3, Verdict.WRONG)):
        records = [
            reading(name, 0.4 * number, *((None, "no_echo") if number % 10 < 10 * share else (2.0,)))
            for name in NAMES
            for number in range(50)
        ]
        rates = compare_flight(AIRFRAME, samples_of(records)).findings[: len(NAMES)]
        assert {each.verdict for each in rates} == {expected}


def test_what_a_lift_shows_of_the_autopilot() -> None:
    # Of a hover that ArduCopter flew without tilting: 0.77 s, 0.40 to 1.15, which is nothing.
    late = (0.05, 0.03, Verdict.RIGHT), (0.2, 0.03, Verdict.WRONG), (0.772, 0.372, Verdict.UNKNOWN)
    for late_s, half_s, expected in late:
        outcome = StepOutcome()
        compare_lag(Places({}, (), Measured(late_s, half_s), {}, np.zeros((0, 2))), outcome)
        assert [each.verdict for each in outcome.findings] == [expected]
    time_s = np.arange(0.0, 10.0, 0.1)
    nothing = samples_of([])
    lifted = Samples({}, nothing.attitude, np.stack([time_s, 0.2 + 0.15 * time_s, time_s], axis=1))
    for off_m, count, verdict in ((0.0, 40, Verdict.RIGHT), (0.3, 40, Verdict.WRONG), (0.0, 2, Verdict.UNKNOWN)):
        # Its last value is as old as half a second.
        back = tuple((0.2 * i, 0.2 + 0.15 * (0.2 * i - 0.2) + off_m) for i in range(1, 1 + count))
        outcome = StepOutcome()
        lift._came_back(AIRFRAME, lift.Recorded(lifted, nothing, nothing, nothing, nothing, back, {}), outcome)
        assert [each.verdict for each in outcome.findings] == [verdict]


def test_what_is_not_sent_is_not_compared_in_the_autopilot_and_the_lift_is_due_when_it_is() -> None:
    trial = AIRFRAME.model_copy(update={"send": AIRFRAME.send.model_copy(update={"nothing": True})})
    nothing = samples_of([])
    lifted = Samples({}, nothing.attitude, np.array([[0.1 * i, 0.4, 0.4] for i in range(50)]))
    recorded = lift.Recorded(lifted, lifted, nothing, nothing, nothing, ((1.0, 3.0),) * 5, {})
    outcome = StepOutcome()
    lift._came_back(trial, recorded, outcome)
    lift._standing(trial, recorded.floor, outcome)
    assert [(each.verdict, each.text) for each in outcome.findings] == [
        (Verdict.UNKNOWN, "not compared: the airframe file sends nothing")
    ]
    assert outcome.proposals == []
    due = [step for step in STEPS if hash_of(step, trial) != hash_of(step, AIRFRAME)]
    assert due == ["parameters", "lift"]


def test_a_warmer_file_means_longer_distances() -> None:
    warmer = AIRFRAME.temperature.model_copy(update={"fixed_c": AIRFRAME.temperature.fixed_c + 5.0})
    assert bench._warmer_c(AIRFRAME.model_copy(update={"temperature": warmer}), AIRFRAME, FIXED) == 5.0
    (source, *others) = AIRFRAME.temperature.sources
    # A bias is what the thermometer shows too much.
    biased = source.model_copy(update={"bias_c": source.bias_c + 2.0})
    temperature = AIRFRAME.temperature.model_copy(update={"sources": (biased, *others)})
    assert bench._warmer_c(AIRFRAME.model_copy(update={"temperature": temperature}), AIRFRAME, source.name) == -2.0


def test_without_a_terminal_no_question_is_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO("y\n"))
    out = io.StringIO()
    person = PersonAtTerminal(False, (), out)
    for ask in (lambda: person.begin("a"), lambda: person.agrees("b"), lambda: person.height_m("c")):
        with pytest.raises(ConfigError, match="--yes"):
            ask()
    hurried = PersonAtTerminal(True, (0.8,), out)
    hurried.begin("a")
    assert hurried.agrees("b")
    assert [hurried.height_m("c"), hurried.height_m("c")] == [0.8, None]


def test_the_command_says_what_it_needs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "airframe.yaml"
    path.write_text(Path("configs/quad_pallet.yaml").read_text().replace("sensors/mb1242.yaml", "mb1242"))
    command = ["msp-range commission", path]
    assert f"<{'|'.join(STEPS)}>" in run(*command, "--help").stdout
    assert "--yes" in run(*command, "--step", "bench", code=3).stderr
    # One object on standard output, and what a person reads on standard error.
    done = run(*command, "--step", "hover", "--json", code=1)
    assert json.loads(done.stdout)["steps"]["hover"]["passed"] is False
    assert "hover: not passed" in done.stderr
    assert "hover: not passed" in run(*command, "--step", "hover", code=1).stdout
    assert "--height 72: expected metres" in run(*command, "--yes", "--height", "72", code=3).stderr
    (tmp_path / "airframe.commission.json").write_text("[]")
    assert "remove it to begin anew" in run(*command, code=3).stderr
    monkeypatch.setattr("os.access", lambda path, mode: mode != os.W_OK)
    assert "use sudo" in run(*command, code=3).stderr


def test_what_has_passed_is_kept_whole_or_as_it_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "airframe.yaml"
    kept = tmp_path / "airframe.commission.json"
    PassedSteps.of(path).save("wires", AIRFRAME, {"a": 1}, VirtualClock())
    before = kept.read_text()

    def full(path: Path, text: str, **options: object) -> int:
        with path.open("w") as file:
            file.write(text[:10])
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "write_text", full)
    with pytest.raises(ConfigError, match="No space left"):
        PassedSteps.of(path).save("bench", AIRFRAME, {"b": 2}, VirtualClock())
    assert kept.read_text() == before
    assert [*tmp_path.iterdir()] == [kept]
    monkeypatch.undo()
    # A step whose entry is damaged is due again.
    kept.write_text(before.replace('{\n        "a": 1\n      }', "null"))
    assert PassedSteps.of(path).next_step(AIRFRAME) == "wires"
