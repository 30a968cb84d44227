"""The variants that tests go through."""

import mitsuba as mi

CPU_VARIANTS = [name for name in mi.variants() if name.startswith(("scalar", "llvm"))]
