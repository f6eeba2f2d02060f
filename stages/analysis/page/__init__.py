"""The report's page: what the owner and the public see, tables, charts, the graph of stages, pictures."""
