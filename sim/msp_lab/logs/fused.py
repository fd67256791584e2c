"""Whether the range is fused into an autopilot's height, by its parameters: such a height is no reference for it.

EKF3 decides by EK3_SRCn_POSZ = 2 and EK3_RNG_USE_HGT > 0 (AP_NavEKF3_PosVelFusion.cpp, selectHeightForFusion), EKF2 of
PX4 by EKF2_HGT_REF = 2 and EKF2_RNG_CTRL > 0 (range_height_control.cpp), before 1.14 by EKF2_HGT_MODE = 2 and
EKF2_RNG_AID = 1. Each function ``by_`` returns the reason, or nothing.
"""

from collections.abc import Mapping

_RANGE_FINDER = 2
"""AP_NavEKF_Source::SourceZ::RANGEFINDER, and PX4's EKF2_HGT_REF and EKF2_HGT_MODE."""
_ESTIMATES = (
    *("XKF1.", "NKF1.", "CTUN.Alt", "POS.", "AHR2.", "PSCD.", "QTUN.Alt"),  # ArduPilot's messages
    *("vehicle_local_position.", "vehicle_global_position.", "vehicle_odometry.", "estimator_"),  # PX4's topics
    *("GLOBAL_POSITION_INT.", "LOCAL_POSITION_NED.", "VFR_HUD.alt", "ALTITUDE.", "ODOMETRY."),  # MAVLink's messages
)
"""Beginnings of the names of fields in which an autopilot's estimate of its height is logged."""
_RANGES = (
    *("RFND.", "CTUN.SAlt", "CTUN.DSAlt", "CTUN.TAlt", "XKF5.HAGL", "XKF5.rng", "NKF5.HAGL", "NKF5.rng"),
    *("distance_sensor", "vehicle_local_position.dist_bottom", "estimator_aid_src_rng_hgt"),
    *("DISTANCE_SENSOR.", "RANGEFINDER.", "ALTITUDE.bottom_clearance", "ALTITUDE.altitude_terrain"),
)
"""Beginnings of the names of fields with a range finder's readings, or with a height above ground that is computed from
them."""


def is_estimate(field: str) -> bool:
    """True for a field, as ``--truth column:`` names it, with an autopilot's height: the range may be fused into it."""
    return field.startswith(_ESTIMATES)


def is_range(field: str) -> bool:
    """True for a field with what a range finder of the vehicle reads.

    Examples
    --------
    >>> is_range("RFND.Dist"), is_range("CTUN.BAlt")
    (True, False)
    """
    return field.startswith(_RANGES)


def by_ekf3(parameters: Mapping[str, float]) -> str:
    """ArduPilot's EKF3.

    Examples
    --------
    >>> by_ekf3({"EK3_SRC1_POSZ": 1, "EK3_SRC2_POSZ": 2})
    'EK3_SRC2_POSZ is 2, so the range is fused into it'
    """
    if "EK3_SRC1_POSZ" not in parameters:
        return "the log does not have EK3_SRC1_POSZ, so the range may be fused into it"
    for name in ("EK3_SRC1_POSZ", "EK3_SRC2_POSZ", "EK3_SRC3_POSZ"):
        if parameters.get(name) == _RANGE_FINDER:
            return f"{name} is 2, so the range is fused into it"
    if parameters.get("EK3_RNG_USE_HGT", -1.0) > 0.0:
        return f"EK3_RNG_USE_HGT is {parameters['EK3_RNG_USE_HGT']:g}, so the range is fused into it near the ground"
    return ""


def by_ekf2_of_ardupilot(parameters: Mapping[str, float]) -> str:
    """ArduPilot's EKF2, before 4.0."""
    if "EK2_ALT_SOURCE" not in parameters:
        return "the log does not have EK2_ALT_SOURCE, so the range may be fused into it"
    if parameters["EK2_ALT_SOURCE"] == 1.0 or parameters.get("EK2_RNG_USE_HGT", -1.0) > 0.0:
        return "by EK2_ALT_SOURCE or EK2_RNG_USE_HGT the range is fused into it"
    return ""


def by_px4(parameters: Mapping[str, float]) -> str:
    """EKF2 of PX4, where its flags are not in the log.

    Examples
    --------
    >>> by_px4({"EKF2_HGT_MODE": 0, "EKF2_RNG_AID": 1})
    'EKF2_RNG_AID is 1, so the range may be fused into it'
    """
    for name in ("EKF2_HGT_REF", "EKF2_HGT_MODE"):
        if parameters.get(name) == _RANGE_FINDER:
            return f"{name} is 2, so the range is its reference"
    use = next((name for name in ("EKF2_RNG_CTRL", "EKF2_RNG_AID") if name in parameters), None)
    if use is None:
        return "the log has neither cs_rng_hgt nor EKF2_RNG_CTRL or EKF2_RNG_AID, so the range may be fused into it"
    if parameters[use] != 0:
        return f"{use} is {parameters[use]:g}, so the range may be fused into it"
    return ""


def by_any(parameters: Mapping[str, float]) -> str:
    """Reason for an autopilot that is recognised by its parameters only, as in a telemetry log."""
    is_px4 = not {"EKF2_HGT_REF", "EKF2_HGT_MODE"}.isdisjoint(parameters)
    return by_px4(parameters) if is_px4 else by_ekf3(parameters)
