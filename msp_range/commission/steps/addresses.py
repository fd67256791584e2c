"""Which sensor answers at which address: a person covers one after the other with a hand.

The covered sensor's readings change, those of the others do not.
"""

import numpy as np

from msp_range.arrays import Flags
from msp_range.commission.edit import Address, Edit
from msp_range.commission.outcome import StepOutcome
from msp_range.commission.samples import Samples, SensorReadings, samples_of
from msp_range.commission.session import Session
from msp_range.config import Airframe
from msp_range.doctor.finding import wrong

NEAR_M = 0.35
"""A covered sensor reads less than this [m]: with a hand on it, it reports its minimum, 0.20 m for an MB1242."""
FREE_M = 0.60
"""Without a hand each sensor needs this much room [m], or the ground itself would look like a hand."""
COVERED_SHARE, FREE_SHARE = 0.6, 0.3
"""While a sensor is covered, at least the first share of its readings are near, and at most the second share of every
other sensor's. A hand that comes late costs a third of the readings; a sensor that sees the arm has some. In any other
case no sensor is named."""
FREE_S, LEAD_S, COVERED_S = 4.0, 3.0, 3.0
"""Time without a hand, time to get to a sensor, and time on it [s]: seven readings of each of four sensors."""
TEXT = """\
Addresses: which sensor is which. Propellers off. Put the vehicle where every sensor has 0.6 m of free space in front
of it (upside down, or across two chairs). You will be asked to cover each sensor with a flat hand for 3 s; go by the
names that you have written on them or on their wires, and keep the other hand and the arm away from the others."""


def _within(readings: SensorReadings, distance_m: float) -> Flags:
    return np.isin(readings.status, "at_minimum") | (readings.range_m < distance_m)


def blocked(free: Samples) -> list[str]:
    """Sensors that have something in front of them although nobody covers them, or no answer at all."""
    names = []
    for name, readings in free.readings.items():
        answers = np.isin(readings.status, ("ok", "at_minimum", "no_echo", "suspect"))
        if not answers.any() or _within(readings, FREE_M)[answers].mean() > FREE_SHARE:
            names.append(name)
    return names


def covered(during: Samples) -> str | None:
    """Name of the sensor that answers as covered; None where that is not clear.

    Parameters
    ----------
    during
        What was received while a hand covered one sensor.
    """
    shares = {name: float(_within(readings, NEAR_M).mean()) for name, readings in during.readings.items()}
    first = max(shares, key=lambda name: shares[name], default=None)
    others = [share for name, share in shares.items() if name != first]
    clear = first is not None and shares[first] >= COVERED_SHARE and max(others, default=0.0) <= FREE_SHARE
    return first if clear else None


def run(session: Session) -> StepOutcome:
    """Cover every sensor once, and those again that were not clear."""
    airframe = session.airframe()
    names = [sensor.name for sensor in airframe.sensors]
    session.operator.begin(TEXT)
    found: dict[str, str | None] = {}
    with session.live() as live:
        session.operator.instruct("Hands off all sensors.")
        live.record(LEAD_S)
        closed = blocked(samples_of(live.record(FREE_S)))
        if closed:
            text = f"without a hand there is something in front of {', '.join(closed)}"
            remedy = "give every sensor 0.6 m of free space, then again; 'msp-range doctor' if one does not answer"
            return StepOutcome([wrong("cover", text, remedy)])
        for name in [*names, *names]:
            if found.get(name) is not None:
                continue
            session.operator.instruct(f"Cover {name}.")
            live.record(LEAD_S)
            found[name] = covered(samples_of(live.record(COVERED_S)))
        session.operator.instruct("Hands off.")
    return compare(airframe, found)


def compare(airframe: Airframe, answered: dict[str, str | None]) -> StepOutcome:
    """What the answers mean for the airframe file.

    Parameters
    ----------
    answered
        Name of the sensor that was covered -> name under which it answered by ``airframe``; None where it is not clear.
    """
    outcome = StepOutcome()
    known = {name: other for name, other in answered.items() if other is not None}
    for name in (name for name in answered if name not in known):
        text = "while it was covered no sensor, or more than one, had something in front of it"
        remedy = "cover it with a flat hand, right on the sensor; is it the one that you mean?"
        outcome.wrong(f"cover {name}", text, remedy)
    if len(set(known.values())) < len(known):
        text = "two covered sensors answered as the same one"
        outcome.wrong("cover", text, "cover one at a time, in the order that is asked for")
        return outcome
    for name in known:
        if known[name] == name:
            outcome.right(f"cover {name}", "it is the one that answered")
    others = {name: other for name, other in known.items() if other != name}
    if not others:
        return outcome
    address = {sensor.name: sensor.address for sensor in airframe.sensors}
    shown = {sensor.name: sensor.shown_address for sensor in airframe.sensors}
    index = {sensor.name: i for i, sensor in enumerate(airframe.sensors)}
    for name, other in others.items():
        text = f"the sensor at {shown[other]} answered, which the file calls {other}"
        outcome.unknown(f"cover {name}", text, "the change below gives each its own address")
    if set(others) != set(others.values()):
        text = "the addresses cannot be put right until every sensor is clear"
        outcome.wrong("cover", text, "cover them all once more")
        return outcome
    listed = ", ".join(f"{name} {shown[name]} -> {shown[other]}" for name, other in others.items())
    models = {airframe.sensors[index[name]].model for name in others}
    if len(models) > 1:
        text = f"sensors of different models are exchanged ({listed})"
        outcome.wrong("cover", text, "correct address and model of each by hand")
        return outcome
    given = {name: Address(each) if isinstance(each, int) else each for name, each in address.items()}
    edits = [Edit(("sensors", index[name], "address"), given[other]) for name, other in others.items()]
    outcome.propose(f"addresses are exchanged: {listed}", *edits)

    def again(changed: Airframe) -> StepOutcome:
        name_at = {sensor.address: sensor.name for sensor in changed.sensors}
        return compare(changed, {name: other and name_at[address[other]] for name, other in answered.items()})

    outcome.again = again
    return outcome
