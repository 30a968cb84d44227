"""Numerical stability of the lobes: worst errors at each exponent (`measuring`) over `inputs`, against `exact` values,
beside `naive` formulas. Imports `reflection`."""

from .measuring import BARS, CASES, EXPONENTS, QUICK_CASES, Row, sweep

__all__ = ["BARS", "CASES", "EXPONENTS", "QUICK_CASES", "Row", "sweep"]
