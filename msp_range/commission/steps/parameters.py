"""The autopilot's parameters, as `msp-range params` has them, with the latency that was measured."""

from contextlib import closing

from msp_range.commission.outcome import StepOutcome
from msp_range.commission.session import Session
from msp_range.config import Airframe
from msp_range.doctor.autopilot import DELAY, DELAY_MS, Tap, silence
from msp_range.doctor.finding import wrong
from msp_range.params.client import ParameterClient
from msp_range.params.commands import CONNECT_S, Difference, described, differences, undo_path, wanted, write
from msp_range.params.settings import Setting
from msp_range.yaml_file import ConfigError

SYNCHRONISED_S = 2.0
"""Time for the autopilot to answer TIMESYNC [s]: the bridge asks each second."""


def run(session: Session) -> StepOutcome:
    """Compare the autopilot's parameters, and set each that differs and that the person agrees to."""
    airframe = session.airframe()
    session.operator.begin(
        "Parameters: those of the autopilot. Propellers off; each change is asked for and read back."
    )
    with closing(Tap(session.make_transport(airframe.link.url, session.clock))) as transport:
        client = ParameterClient(transport, session.clock, airframe.link)
        if not client.connect(CONNECT_S):
            return StepOutcome([silence(airframe, session.computer, transport, session.clock)])
        try:
            return _compared(session, airframe, client)
        except ConfigError as error:
            return StepOutcome([wrong("parameters", str(error), "then again; what was set stays set")])


def _compared(session: Session, airframe: Airframe, client: ParameterClient) -> StepOutcome:
    """What each parameter is, and becomes.

    Raises
    ------
    ConfigError
        It is another autopilot, or a parameter could not be set.
    """
    firmware, settings = wanted(airframe, client, session.port)
    changes = differences(client, settings) + _delay(session, client)
    outcome = StepOutcome(measured={"firmware": str(firmware)})
    undo = session.path.with_name(undo_path(session.clock).name)
    shown: list[str] = []
    done = write(client, changes, session.operator.agrees, undo, airframe.vehicle, shown.append)
    for change in changes:
        name, text = change.setting.name, described(change)
        remedy = "is --port the autopilot's port with the bridge, and the firmware the expected one?"
        outcome.add(
            name,
            (name in done, f"set to {done.get(name, 0):g} and read back"),
            (change.found is None, text, remedy),
            (True, f"left as it was: {text}", "set it, unless there is a reason not to"),
        )
    kept = len(settings) - sum(change.setting in settings for change in changes)
    outcome.right("parameters", f"{kept} of {len(settings)} of {firmware} were as they should be")
    if done:
        remedy = f"restart the autopilot now; to undo: msp-range params {session.path} --restore {undo}"
        outcome.unknown("restart", f"{len(done)} set, and some count from the next start on", remedy)
    return outcome


def _delay(session: Session, client: ParameterClient) -> list[Difference]:
    """PX4's delay of the range finder, where the bench check has measured it."""
    answer_s = session.measured.get("bench", {}).get("echo_to_answer_s")
    if client.autopilot != "px4" or not isinstance(answer_s, float):
        return []
    client.wait(lambda: client.link.autopilot_clock.round_trip_s is not None, SYNCHRONISED_S)
    total_ms = round(1e3 * (answer_s + (client.link.autopilot_clock.round_trip_s or 0.0) / 2))
    found = client.read(DELAY)
    if found is not None and abs(found - total_ms) <= DELAY_MS:
        return []
    return [
        Difference(Setting(DELAY, total_ms, "from the echo to the autopilot", "measured at the bench check"), found)
    ]
