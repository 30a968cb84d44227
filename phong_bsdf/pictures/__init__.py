"""Pictures as arrays and as files, their errors, passes on disk. Imports `tracing` and what is above it."""
