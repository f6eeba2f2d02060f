"""From the workflow file to the graph of its stages, with every reference resolved."""
