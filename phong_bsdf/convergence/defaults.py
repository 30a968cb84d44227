"""What the command needs to know before anything slow is imported."""

# Samples per pixel to measure at, and passes for each.
LEVELS = (1, 4, 16, 64)
REPEATS = 5
