"""Effect: in one session everything was measured from another zero."""

from msp_sim.effects.base import Effect, Parameter, everywhere

SESSION_OFFSET = Effect(
    name="session_offset",
    sentence="On one day everything reads too far or too near by the same amount: something was arranged differently.",
    finding="everything in {of} reads {offset_cm:too far|too near}",
    physics="a constant added to every range of one run",
    source="geometry; the reference's zero is set again for each session",
    parameters=(Parameter("offset_cm", "cm", "how much too far this session reads", -50.0, 50.0),),
    requires=("true_range_cm",),
    channels=("bias",),
    experiment="repeat the session with the reference arranged again",
    apply=everywhere("bias_cm", "offset_cm"),
    per="run",
    equivalent_causes=("the reference's zero in that session",),
)
