"""One plugin, one file: the only modules with variant types at module scope. Imports what `tracing` may, and that."""
