"""Each kind of result: its facts, tables with units, plot, files and page, and how it is opened again."""
