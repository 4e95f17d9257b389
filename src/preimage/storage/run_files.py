"""Names of what may lie beside a run's weights; without torch, so that the command line can name them at once."""

MEMORY = "memory.safetensors"
"""Of the demonstrations; a run that was trained by the paper alone has none."""
HELD_OUT = "held_out.jsonl"
"""Errors of held-out episodes, one line a checkpoint; a run that held out none has none."""
CALIBRATION = "calibration.json"
"""What trust in its plans is calibrated by; a run that nobody calibrated has none."""
