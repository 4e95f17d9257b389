"""The studio under load: tabs that plan at the same time are all served, and memory does not grow with them."""

import sys

import pytest

pytest.importorskip("fastapi", reason="the extra studio is not installed: pip install -e '.[studio]'")

from load import put_under_load
from serving import serving

pytestmark = [pytest.mark.slow, pytest.mark.skipif(not sys.platform.startswith("linux"), reason="memory is looked at as Linux tells it")]
MOST_MB = 30
"""Growth of memory that is allowed, of two hundred plans as of these."""


def test_eight_tabs_are_served_and_memory_stays(run_folder, tmp_path):
    with serving(run_folder, "--work", tmp_path) as (address, pid):
        load = put_under_load(address, pid, plans=24, tabs=8, warm_up=8)
    assert load.failed == []
    assert load.found == 32
    assert load.grown_mb < MOST_MB
