"""What several tests use. `tests/` is on the path, so it is `from helpers import ...` in all of them."""

from pathlib import Path

ROOT = Path(__file__).parent.parent.parent
SCENES = ROOT / "scenes"
