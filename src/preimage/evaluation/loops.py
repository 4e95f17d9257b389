"""What the network senses while a plan is carried out."""

from typing import Literal

Loop = Literal["closed", "open", "recorded"]
"""closed: the plan is executed blind; open: the next joints are predicted from what the robot senses; recorded: from what was recorded
when the demonstrator showed the way to the same goal (the other reading of the paper's one-step prediction)."""
