"""Results, counted and compared: trials, held-out recordings, the paper's tables, speed."""
