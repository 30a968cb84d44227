"""How fast the package is: one benchmark a file, each with `records(plan)`; `python -m benchmarks` runs them."""
