"""Records -> CSV, JSON, tables, plots. Renders nothing, measures nothing."""
