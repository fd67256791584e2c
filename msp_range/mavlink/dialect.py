"""pymavlink's MAVLink 2 dialect ``common``: the one import of it, typed as Any because pymavlink has no types.

The dialect alone is imported, not mavutil, which costs half a second and 44 MB and chooses the protocol by an
environment variable. The v20 module always speaks MAVLink 2, without which DISTANCE_SENSOR has no field of view.
"""

from typing import Any

import pymavlink.dialects.v20.common as _common

dialect: Any = _common
