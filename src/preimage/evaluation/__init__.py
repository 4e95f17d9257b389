"""What comes of it, counted: trials, held-out recordings, the paper's tables, speed."""
