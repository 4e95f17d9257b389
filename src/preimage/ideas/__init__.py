"""What goes beyond the paper, one idea a room."""
