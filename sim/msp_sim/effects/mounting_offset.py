"""Effect: a sensor is not mounted where the airframe file says."""

from msp_sim.effects.base import Effect, Parameter, everywhere

MOUNTING_OFFSET = Effect(
    name="mounting_offset",
    sentence="One sensor is mounted a little higher or lower than stated, so all its readings are off by that.",
    finding="{of} reads {offset_cm:too far|too near}",
    physics="a constant added to every range of one sensor; the same for all sensors would be calibration",
    source="geometry",
    parameters=(Parameter("offset_cm", "cm", "how much too far this sensor reads", -50.0, 50.0),),
    requires=("true_range_cm",),
    channels=("bias",),
    experiment="all sensors in front of one wall, then two of them swapped: the offset stays with the position",
    apply=everywhere("bias_cm", "offset_cm"),
    per="sensor",
    equivalent_causes=("the reference's offset for this sensor",),
)
