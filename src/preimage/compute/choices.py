"""What may be asked of the machine, by name; nothing that computes has to be loaded to read it."""

from typing import Literal

Device = Literal["auto", "cpu", "cuda"]
"""auto: a GPU where there is one."""
