"""Measures the worst errors in float32, for the table and the plot of docs/stability.md: `make stability`."""

import phong_bsdf  # noqa: F401

import mitsuba as mi  # isort: skip

mi.set_variant("llvm_ad_rgb")

import pages  # noqa: E402

from phong_bsdf import stability  # noqa: E402
from phong_bsdf.report import stability as report  # noqa: E402


def main():
    """The plot shows every exponent, the table some."""
    records = list(stability.sweep())
    report.plot(pages.IMAGES / "stability-value.svg", records, "value")
    chosen = [row for row in records if row.quantity in ("value", "pdf") and row.p in (1, 100, 1e4, 1e6, 1e8)]
    pages.insert("stability", report.table(chosen), "stability.md")


if __name__ == "__main__":
    main()
