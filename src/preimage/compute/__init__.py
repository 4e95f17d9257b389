"""Where the arithmetic is done, and by how many processes."""
