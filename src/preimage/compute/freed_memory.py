"""What happens to memory that is no longer used."""

import ctypes
import sys

M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3
"""Names of glibc's settings (mallopt(3))."""
MOST_BYTES = 2**31 - 1


def keep_freed_memory() -> bool:
    """Let the C library keep what is freed for the next update, which needs the same again.

    glibc gives large blocks back to the system at once, and every page that is asked for anew is first cleared: about a twelfth of an
    update at the paper's size. Elsewhere nothing happens.

    Returns:
        whether the C library takes the setting.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None) if sys.platform == "linux" else None
    return mallopt is not None and all(mallopt(name, MOST_BYTES) for name in (M_TRIM_THRESHOLD, M_MMAP_THRESHOLD))
