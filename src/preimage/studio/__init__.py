"""The studio: a local page on which error regression can be watched, and the server behind it."""
