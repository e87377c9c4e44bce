"""Paths outside the tests' own folder."""

import os
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
"""The repository."""
SHARED_DATA = Path(os.environ.get("HIL_SHARED_DATA", ROOT.parent / "shared" / "data"))
"""Measured data beside the repository; a clone alone does not have it, and tests that need it skip with that reason."""
