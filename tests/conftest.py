"""What is shared (tests/shared.py) is loaded by whoever runs tests, not by the process that hands them out, which would be waited for."""

import pytest


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--kills", type=int, default=20, help="how often a training is killed (`make kills`: 100)")


def pytest_configure(config: pytest.Config) -> None:
    if getattr(config.option, "dist", "no") == "no":  # in a worker of xdist as well
        config.pluginmanager.import_plugin("shared")
