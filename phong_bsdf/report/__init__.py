"""Records -> CSV, JSON, tables, plots, pages. Renders nothing, measures nothing. Imports what makes the records."""
