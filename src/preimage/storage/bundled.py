"""Which trained models come with the program."""

BUNDLED = ("reach", "two-points", "move-object")
"""Names that stand for them wherever a run is asked for."""
