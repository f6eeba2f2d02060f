"""The report's page: what is shown to whom, tables, charts, the graph of stages, pictures."""
