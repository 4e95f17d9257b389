"""Names of what may lie beside a run's weights; without torch, so that the command line can name them at once."""

MEMORY = "memory.safetensors"
"""Of the demonstrations; a run that was trained by the paper alone has none."""
CALIBRATION = "calibration.json"
"""What trust in its plans is calibrated by; a run that nobody calibrated has none."""
