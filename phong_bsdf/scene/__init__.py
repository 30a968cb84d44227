"""A scene file: loaded, rendered, packed, changed; its errors in words. Imports `importers` and what is above it."""
