"""Reading and writing pictures, and the metrics that compare them."""
