"""Recordings as they lie on disk, and as the network takes them."""
