"""Error against time: `planning`, `measuring`, a `study` of the passes, what time buys (`tradeoff`), `conclusions`."""
