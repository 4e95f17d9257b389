"""What the network senses while a plan is carried out, and what goes wrong meanwhile."""

from typing import Literal

Loop = Literal["closed", "open", "replan", "recorded"]
"""closed: the plan is executed blind; open: the next joints are predicted from what the robot senses; replan: the rest of the way is
planned anew at every step; recorded: open, from what was recorded when the demonstrator showed the way to the same goal (the other reading
of the paper's one-step prediction)."""
Disturbed = Literal["push", "bias", "goal", "object", "camera", "late"]
"""As `robot.disturbances` says what they are."""
