"""What goes wrong in the flights of each group: faults of sensors, thermometer, attitude and autopilot.

`ADD` names for each group the function that adds its faults to a scenario.
"""

from collections.abc import Callable
from typing import Any

from evaluation.faults.dice import Dice

Content = dict[str, Any]

SENSOR_KINDS = [
    "clock_fault",
    "or_ed",
    "saturated",
    "lost_high_byte",
    "impossible",
    "missed_read",
    "stuck",
    "no_echo",
    "noisy",
    "offset",
    "silent",
    "power_cycle",
]
"""Faults of one sensor. A locked-up bus takes all of them away and is flown in the group 'three or four'. The other
kinds of the simulator are flown in the hostile families."""
COMMON_KINDS = ["or_ed", "lost_high_byte", "saturated", "stuck", "offset"]
"""Faults that give two sensors the same wrong height. The first three are alike: they leave eight bits, and 765 reads
255 or 253."""
ALIKE = dict.fromkeys(["or_ed", "lost_high_byte", "saturated"], "eight bits") | {"stuck": "stuck", "offset": "offset"}
ATTITUDE_KINDS = ["roll", "huge", "not_a_number"]


def window(dice: Dice, duration_s: float) -> Content:
    """When a fault lasts: mostly some seconds in the middle, now and then from the start or to the end."""
    from_s = 0.0 if dice.happens(0.15) else round(dice.between(0.1, 0.6) * duration_s, 2)
    to_s = duration_s if dice.happens(0.25) else min(round(from_s + dice.between(4.0, 25.0), 2), duration_s)
    return {"from_s": from_s, "to_s": to_s}


def sensor_fault(dice: Dice, sensor: str, kind: str, when: Content) -> Content:
    """One planned fault; what a kind needs besides its time is drawn."""
    fault = {"sensor": sensor, "kind": kind, **when}
    lasts_s = {"power_cycle": (0.0, 5.0), "locked_up": (1.0, 10.0)}.get(kind)
    if lasts_s is not None:
        return fault | {"to_s": round(when["from_s"] + dice.between(*lasts_s), 2)}
    if kind in _DRAW_VALUES:
        return fault | _DRAW_VALUES[kind](dice)
    fault["probability"] = dice.one_of([1.0, 0.5, 0.2])
    if kind == "impossible":
        fault["word"] = dice.one_of([0, 1, 10, 19, 766, 1000, 5000, 0x7FFF, 0xFFFF])
    elif kind == "noisy":
        fault["spread_cm"] = dice.magnitude(30.0, 500.0)
    elif kind == "offset":
        fault["offset_cm"] = dice.one_of([-1, 1]) * dice.between(30.0, 300.0)
    return fault


_DRAW_VALUES: dict[str, Callable[[Dice], Content]] = {
    "drift": lambda dice: {"rate_cm_s": dice.one_of([-1, 1]) * dice.between(1.5, 3.0)},
    "constant": lambda dice: {"constant_cm": round(dice.between(20.0, 700.0))},
    "previous_ping": lambda dice: {},
    "fixed_object": lambda dice: {"object_cm": dice.between(20.0, 60.0), "jitter_cm": dice.between(0.0, 1.5)},
    "dust": lambda dice: {"probability": dice.between(0.2, 0.9), "dust_cm": dice.between(50.0, 250.0)},
}
"""Values of the kinds of the hostile families."""


def thermometer_fault(dice: Dice, when: Content) -> Content:
    """A thermometer that jumps or freezes."""
    if dice.happens(0.75):
        return {"kind": "jump", **when, "by_c": dice.one_of([-1, 1]) * dice.between(10.0, 60.0)}
    return {"kind": "freeze", **when}


def attitude_fault(dice: Dice, kind: str, when: Content) -> Content:
    """Attitude messages that make no sense."""
    fault = {"kind": kind, **when}
    if kind == "roll":
        fault["roll_deg"] = dice.one_of([-1, 1]) * dice.between(85.0, 180.0)
    return fault


def _one(dice: Dice, scenario: Content, names: list[str], kind: str) -> None:
    when = window(dice, scenario["duration_s"])
    scenario["faults"] = [sensor_fault(dice, dice.one_of(names), kind, when)]


def _each(dice: Dice, scenario: Content, names: list[str], kinds: list[str]) -> None:
    """A kind for each of some sensors, mostly at the same time."""
    duration_s = scenario["duration_s"]
    when, at_once = window(dice, duration_s), dice.happens(0.6)
    scenario["faults"] = [
        sensor_fault(dice, name, kind, when if at_once else window(dice, duration_s))
        for name, kind in zip(dice.some_of(names, len(kinds)), kinds, strict=True)
    ]


def _two(dice: Dice, scenario: Content, names: list[str], turn: str) -> None:
    """Two sensors with faults that do not give one common wrong height."""
    kinds = [dice.one_of(SENSOR_KINDS), dice.one_of(SENSOR_KINDS)]
    while ALIKE.get(kinds[0], kinds[0]) == ALIKE.get(kinds[1]):
        kinds[1] = dice.one_of(SENSOR_KINDS)
    _each(dice, scenario, names, kinds)


def _two_common(dice: Dice, scenario: Content, names: list[str], turn: str) -> None:
    """The same fault on two sensors at the same time."""
    fault = sensor_fault(dice, "", turn, window(dice, scenario["duration_s"]))
    scenario["faults"] = [fault | {"sensor": name} for name in dice.some_of(names, 2)]


def _three_or_four(dice: Dice, scenario: Content, names: list[str], turn: str) -> None:
    """The same kind on all of them or one each; now and then a locked-up bus, which takes all away."""
    count = dice.one_of([3, 4])
    kinds = [dice.one_of([*SENSOR_KINDS, "locked_up"]) for _ in range(count)]
    if dice.happens(0.6):
        kinds = kinds[:1] * count
    _each(dice, scenario, names, ["locked_up"] if "locked_up" in kinds else kinds)


def _all_at_255(dice: Dice, scenario: Content, names: list[str], turn: str) -> None:
    when = window(dice, scenario["duration_s"])
    scenario["faults"] = [{"sensor": name, "kind": "saturated", **when} for name in names]


def _thermometer(dice: Dice, scenario: Content, names: list[str], turn: str) -> None:
    scenario["thermometer"]["faults"] = [thermometer_fault(dice, window(dice, scenario["duration_s"]))]


def _attitude(dice: Dice, scenario: Content, names: list[str], turn: str) -> None:
    scenario["autopilot"]["attitude_faults"] = [attitude_fault(dice, turn, window(dice, scenario["duration_s"]))]


def _reboot(dice: Dice, scenario: Content, names: list[str], turn: str) -> None:
    scenario["autopilot"]["reboots_at_s"] = [dice.between(5.0, scenario["duration_s"] - 15.0)]


def _airframe(dice: Dice, scenario: Content, names: list[str], turn: str) -> None:
    """Every second flight of another airframe has a fault on one sensor."""
    if dice.happens(0.5):
        _one(dice, scenario, names, dice.one_of(SENSOR_KINDS))


ADD: dict[str, Callable[[Dice, Content, list[str], str], None]] = {
    "one": _one,
    "two": _two,
    "two, common height": _two_common,
    "three or four": _three_or_four,
    "all at 255": _all_at_255,
    "thermometer": _thermometer,
    "attitude": _attitude,
    "reboot": _reboot,
    "airframe": _airframe,
}
"""Group -> function of (dice, scenario, names of the sensors, whose turn it is of the group's kinds)."""
