"""Runs, plans and results on disk, written whole or not at all."""
