"""The lecture's formulas and what follows from them: no scene, no file. Imports no folder but `host`."""
