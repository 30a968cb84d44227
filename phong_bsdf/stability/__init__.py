"""Numerical stability of the lobes: worst errors at each exponent (`measuring`) over `inputs`, against `exact` values,
beside `naive` formulas. Imports `reflection`."""

from .measuring import BARS as BARS
from .measuring import CASES as CASES
from .measuring import EXPONENTS as EXPONENTS
from .measuring import QUICK_CASES as QUICK_CASES
from .measuring import Row as Row
from .measuring import sweep as sweep
