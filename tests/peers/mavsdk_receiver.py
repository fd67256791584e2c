"""MAVSDK as a ground station: ``mavsdk_receiver.py PORT`` prints one line of JSON for each message that it takes.

When it knows the autopilot it prints ``{"autopilot": SYSTEM}``. For each line "COMPONENT MESSAGE_ID" on standard input
it requests that message of that component and prints the command's acknowledgement; the end of the input ends it.
"""

import json
import sys
from typing import Any

COMMAND_REQUEST_MESSAGE = 512


def show(content: Any) -> None:
    """One line, whole: MAVSDK calls back from threads of its own."""
    sys.stdout.write(json.dumps(content) + "\n")
    sys.stdout.flush()


def taken(message: Any, _: object = None) -> dict[str, Any]:
    """A message with its sender."""
    fields = json.loads(message.fields_json)
    return {"source": [message.system_id, message.component_id], "name": message.message_name, "fields": fields}


def main(port: str) -> None:
    """Receive until standard input ends."""
    from mavsdk import ComponentType, Configuration, Mavsdk
    from mavsdk.plugins.mavlink_direct import MavlinkDirect, MavlinkMessage

    with Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION)) as mavsdk:
        mavsdk.add_any_connection(f"udpin://127.0.0.1:{port}")
        system = mavsdk.first_autopilot(60.0)
        if system is None:
            sys.exit("no autopilot within 60 s")
        direct = MavlinkDirect(system)
        direct.subscribe_message("", lambda message, _: show(taken(message)))
        show({"autopilot": system.get_system_id()})
        for line in sys.stdin:
            component, message_id = map(int, line.split())
            fields = {
                "target_system": system.get_system_id(),
                "target_component": component,
                "command": COMMAND_REQUEST_MESSAGE,
                "confirmation": 0,
                "param1": message_id,
                **{f"param{number}": 0 for number in range(2, 8)},
            }
            request = MavlinkMessage("COMMAND_LONG", 0, 0, system.get_system_id(), component, json.dumps(fields))
            show({"acknowledgement": taken(direct.send_command(request))})


if __name__ == "__main__":
    main(sys.argv[1])
