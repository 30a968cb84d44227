"""Error against time: `planning`, `measuring`, a `study` of the passes, what time buys (`tradeoff`), `conclusions`.

Here is what the command needs before it loads them.
"""

# Samples per pixel to measure at, and passes for each.
LEVELS = (1, 4, 16, 64)
REPEATS = 5
