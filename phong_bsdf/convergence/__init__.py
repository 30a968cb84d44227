"""Error against time: `planning`, `measuring`, a `study` of the passes, what time buys (`tradeoff`), `conclusions`.

Imports `scene` and what is above it, `stability` and `comparison`.
"""
