"""The setting is taken where there is something to set."""

import platform

from preimage.compute.freed_memory import keep_freed_memory


def test_glibc_keeps_what_is_freed_and_others_are_left_alone() -> None:
    assert keep_freed_memory() == (platform.libc_ver()[0] == "glibc")
