"""Memory of this process."""

import os
from pathlib import Path

ALL_ADDRESSES, RESIDENT = 0, 1
"""Fields of /proc/self/statm."""


def memory_mb(field: int = RESIDENT) -> float:
    """Memory of this process, resident unless another field is named [MB]."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[field])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6
