"""A whole visit of the studio in a browser: the screenshots and the film of README.

Run in the repository, with the extras `studio` and `test` installed and a Chromium at hand; it takes some minutes:

    python docs/media/visit.py --out docs/media
"""
