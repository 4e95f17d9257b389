"""Processes that begin where others have loaded already what takes seconds: one is killed often, and starts in some milliseconds."""

import multiprocessing

FORKS = multiprocessing.get_context("forkserver")
FORKS.set_forkserver_preload(["test_experiments"])
