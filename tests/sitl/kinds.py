"""The autopilots that are named in the environment, for tests that skip without them."""

import pytest

from tests.sitl.arducopter import ARDUCOPTER, ArduCopter
from tests.sitl.px4 import PX4, Px4

needs_arducopter = pytest.mark.skipif(not ARDUCOPTER, reason="set MSP_RANGE_ARDUCOPTER to an arducopter SITL binary")
needs_px4 = pytest.mark.skipif(not PX4, reason="set MSP_RANGE_PX4 to a PX4 SITL build folder")
both = pytest.mark.parametrize(
    "kind", [pytest.param(ArduCopter, marks=needs_arducopter), pytest.param(Px4, marks=needs_px4)]
)
